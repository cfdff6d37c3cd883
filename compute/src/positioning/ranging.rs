//! The satellites of an epoch, and its pseudorange factors with the probability that a signal is
//! direct.

use crate::gnss::{Constellation, Ecef, EphemerisIssue, GpsTime, LocalFrame, SatelliteId};
use crate::graph::{Kernel, Law, Row};
use crate::snapshot::snapshot_fields;

use super::Measurement;
use super::factors::{DopplerFactor, Line, PseudorangeFactor, Sight, State};
use super::log_product::LogProduct;
use super::pseudorange_error::{Likelihood, LikelihoodAt, PseudorangeError};
use super::velocity::{CN0_IF_MISSING_DB_HZ, variance_m2_s2};
use crate::graph::median;

/// The measurements above the mask, each with the index of its satellite among the epoch's sights.
pub(super) fn above_mask(list: &[Measurement]) -> impl Iterator<Item = (u16, &Measurement)> {
    (0..).zip(list.iter().filter(|measurement| measurement.is_above_mask))
}

/// Replaces `sights` by one for each measurement above the mask, in their order.
pub(super) fn look(frame: &LocalFrame, list: &[Measurement], sights: &mut Vec<Sight>) {
    sights.clear();
    sights.extend(above_mask(list).map(|(_, m)| Sight::new(frame, m.state.position)));
}

/// Doppler rows, in the frame, of the measurements that are not excluded, for a receiver near
/// `receiver`; `sigma_m_s` is their standard deviation at the reference C/N0.
pub(super) fn rates<'a>(
    above_mask: impl Iterator<Item = (u16, &'a Measurement)>,
    frame: &LocalFrame,
    receiver: Ecef,
    sigma_m_s: f64,
) -> impl Iterator<Item = DopplerFactor> {
    above_mask.filter(|(_, m)| !m.is_excluded).filter_map(move |(sight, measurement)| {
        let cn0_db_hz = measurement.cn0_db_hz.unwrap_or(CN0_IF_MISSING_DB_HZ);
        let sigma_m_s = variance_m2_s2(sigma_m_s, cn0_db_hz).sqrt();
        let rate_m_s = measurement.range_rate_m_s?;
        let state = &measurement.state;
        let factor = DopplerFactor::new(frame, receiver, state, rate_m_s, sigma_m_s);
        Some(factor.of_sight(sight))
    })
}

/// Smallest weight, or probability to be direct, of a pseudorange that counts as used: the weight
/// of a Geman–McClure kernel at its width.
pub(super) const USED_WEIGHT: f64 = 0.25;

/// A pseudorange factor with its satellite and ephemeris.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ranging {
    pub(super) factor: PseudorangeFactor,
    /// Index of its satellite among the epoch's sights.
    pub(super) sight: u16,
    pub(super) satellite: SatelliteId,
    /// Time and issue of its ephemeris.
    pub(super) toe: GpsTime,
    pub(super) issue: u32,
    /// Index of its inter-system bias; `None` for the reference constellation.
    pub(super) bias: Option<u32>,
    /// Standard deviation of the ionosphere's model in it (m).
    pub(super) ionosphere_m: f64,
    /// Standard deviation of the troposphere's model in it (m).
    pub(super) troposphere_m: f64,
    /// What is known about reflections; `None` if a robust kernel is used instead.
    pub(super) reflection: Option<Reflection>,
}

/// What is known about the reflection of a signal, before its residual is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Reflection {
    /// Probability that it is a reflection.
    pub(super) reflected_probability: f64,
    /// Its error model before anything was learnt about the receiver.
    pub(super) before_learning: PseudorangeError,
}

snapshot_fields!(Reflection { reflected_probability, before_learning });

/// A pseudorange as a row of the normal equations: the weight and the residual of a quadratic loss
/// with the same slope.
#[derive(Clone, Copy, Debug)]
pub(super) struct Judged {
    pub(super) residual: f64,
    pub(super) weight: f64,
    /// Probability that it is the direct signal.
    pub(super) direct: f64,
}

/// The losses of an epoch's pseudoranges.
#[derive(Clone, Copy, Debug)]
pub(super) struct RangeLosses {
    /// Sum over the pseudoranges with a kernel.
    kernel: f64,
    mixture: LogProduct,
}

impl RangeLosses {
    /// The losses of no pseudoranges.
    pub(super) const ZERO: Self = Self { kernel: 0.0, mixture: LogProduct::ZERO };

    /// Their sum.
    pub(super) fn value(&self) -> f64 {
        self.kernel - self.mixture.value()
    }
}

/// Contribution of a pseudorange to the estimate of the noise, at its residual.
pub(super) struct Influence {
    pub(super) constellation: Constellation,
    /// ψ of the whitened residual.
    pub(super) pull: f64,
    /// w, with which it enters the normal equations.
    pub(super) weight: f64,
    /// ψ′.
    pub(super) slope: f64,
    /// Whether it is not rejected.
    pub(super) is_accepted: bool,
}

impl Ranging {
    /// From a corrected measurement whose satellite is `sight`.
    pub(super) fn new(sight: u16, measurement: &Measurement, bias: Option<u32>) -> Self {
        let factor = PseudorangeFactor {
            corrected_range_m: measurement.corrected_range_m,
            inverse_sigma: measurement.variance_m2.sqrt().recip(),
        };
        Self {
            factor,
            sight,
            satellite: measurement.satellite,
            toe: measurement.ephemeris.toe,
            issue: measurement.ephemeris.issue,
            bias,
            ionosphere_m: measurement.ionosphere_sigma_m,
            troposphere_m: measurement.troposphere_sigma_m,
            reflection: None,
        }
    }

    /// Its ephemeris.
    pub(super) fn ephemeris(&self) -> EphemerisIssue {
        EphemerisIssue { satellite: self.satellite, toe: self.toe, issue: self.issue }
    }

    /// Its inter-system bias (m).
    pub(super) fn bias_m(&self, biases_m: &[f64]) -> f64 {
        self.bias.map_or(0.0, |variable| biases_m[variable as usize])
    }

    /// Whitened residual and its Jacobian on [p; b], of the epoch's lines of sight.
    #[inline]
    pub(super) fn linearize(&self, lines: &[Line], state: &State, biases_m: &[f64]) -> Row<4> {
        self.factor.linearize(&lines[usize::from(self.sight)], state, self.bias_m(biases_m))
    }

    /// Sets the error model, and the one before anything was learnt.
    pub(super) fn set_error_model(
        &mut self,
        error: PseudorangeError,
        before_learning: PseudorangeError,
    ) {
        self.factor.inverse_sigma = error.sigma_m.recip();
        self.reflection =
            Some(Reflection { reflected_probability: error.reflected, before_learning });
    }

    /// The error model, if one is set.
    pub(super) fn error(&self) -> Option<PseudorangeError> {
        let sigma_m = self.factor.inverse_sigma.recip();
        self.reflection.map(|reflection| PseudorangeError {
            sigma_m,
            reflected: reflection.reflected_probability,
            ..reflection.before_learning
        })
    }

    /// Weight and equivalent residual of a whitened residual (model − measured); its loss is added
    /// to `losses`. They follow from the error model, except in the convex first stage of a solve,
    /// whose kernel is Huber's.
    #[inline]
    pub(super) fn judge(&self, residual: f64, kernel: &Kernel, losses: &mut RangeLosses) -> Judged {
        match self.likelihood().filter(|_| kernel.law != Law::Huber) {
            Some(likelihood) => {
                let at = likelihood.evaluate_whitened(-residual);
                losses.mixture.add(at.density);
                Judged::of_mixture(&at)
            }
            None => {
                let (loss, weight) = kernel.loss_and_weight(residual);
                losses.kernel += loss;
                Judged { residual, weight, direct: weight }
            }
        }
    }

    /// The probability that it is the direct signal, or the weight of its kernel.
    pub(super) fn direct(&self, residual: f64, kernel: &Kernel) -> f64 {
        let mut unused = RangeLosses::ZERO;
        self.judge(residual, kernel, &mut unused).direct
    }

    /// Its error model, if one is set, ready to be evaluated.
    fn likelihood(&self) -> Option<Likelihood> {
        let Reflection { reflected_probability, before_learning } = self.reflection?;
        let per_sigma_m = self.factor.inverse_sigma;
        Some(Likelihood::new(per_sigma_m, reflected_probability, before_learning.extra_path_m))
    }

    /// Its contribution to the noise, with the error model that [`Self::judge`] uses.
    pub(super) fn influence(&self, residual: f64, kernel: &Kernel) -> Influence {
        let constellation = self.satellite.constellation;
        let Some(likelihood) = self.likelihood().filter(|_| kernel.law != Law::Huber) else {
            let (weight, slope) = (kernel.weight(residual), kernel.pull_slope(residual));
            let (pull, is_accepted) = (weight * residual, USED_WEIGHT <= weight);
            return Influence { constellation, pull, weight, slope, is_accepted };
        };
        let at = likelihood.evaluate_whitened(-residual);
        Influence {
            constellation,
            pull: -at.slope,
            weight: at.curvature,
            slope: at.information,
            is_accepted: USED_WEIGHT <= at.direct,
        }
    }

    /// Measured minus predicted pseudorange (m).
    pub(super) fn excess_m(&self, lines: &[Line], state: &State, biases_m: &[f64]) -> f64 {
        let row = self.linearize(lines, state, biases_m);
        -row.residual / self.factor.inverse_sigma
    }
}

/// How the clocks of an epoch differ from the predicted ones.
#[derive(Clone, Copy, Debug)]
pub(super) struct ClockChange {
    /// Measured minus predicted clock (m), if there is a pseudorange that determines it.
    pub(super) clock_m: Option<f64>,
    /// Where the reference constellation begins after others: its clock minus the one that has been
    /// estimated in its place (m); else zero.
    pub(super) reference_m: f64,
}

/// The pseudoranges of an epoch at a state.
#[derive(Clone, Copy)]
pub(super) struct RangesAt<'a> {
    pub(super) ranges: &'a [Ranging],
    /// Lines of sight from the state.
    pub(super) lines: &'a [Line],
    pub(super) state: &'a State,
}

impl RangesAt<'_> {
    /// Finds the clock, and the biases that begin, from the medians of the pseudoranges.
    ///
    /// The biases of constellations that begin are added to `biases_m` and `begun`, and `begins` is
    /// called with the index and value of each. Until the reference begins, the clock is that of
    /// the constellations that have begun, each with its bias. When it begins, the known biases
    /// are changed by −[`ClockChange::reference_m`].
    pub(super) fn start_clocks(
        &self,
        biases_m: &mut [f64],
        begun: &mut [bool; Constellation::COUNT],
        numbers: &mut Vec<f64>,
        mut begins: impl FnMut(usize, f64),
    ) -> ClockChange {
        let index = |range: &Ranging| range.satellite.constellation.index();
        let known = |range: &&Ranging| begun[index(range)];
        let mut clock_m = self.median_excess_m(known, biases_m, numbers);
        let mut reference_m = 0.0;
        for constellation in Constellation::ALL.into_iter().map(Constellation::index) {
            let of = |range: &&Ranging| index(range) == constellation;
            let first = self.ranges.iter().find(of).filter(|_| !begun[constellation]);
            let Some(first) = first else { continue };
            if let Some(variable) = first.bias {
                biases_m[variable as usize] = 0.0;
            }
            let own_m = self.median_excess_m(of, biases_m, numbers).unwrap_or(0.0);
            let since_m = own_m - *clock_m.get_or_insert(own_m);
            match first.bias.map(|variable| variable as usize) {
                Some(variable) => {
                    biases_m[variable] = since_m - reference_m;
                    begins(variable, biases_m[variable]);
                }
                None => {
                    reference_m = since_m;
                    let others = biases_m.iter_mut().zip(&*begun).filter(|(_, begun)| **begun);
                    others.for_each(|(bias_m, _)| *bias_m -= since_m);
                }
            }
            begun[constellation] = true;
        }
        ClockChange { clock_m, reference_m }
    }

    /// Median of measured minus predicted pseudoranges (m) for which `is_wanted` is true.
    fn median_excess_m(
        &self,
        is_wanted: impl Fn(&&Ranging) -> bool,
        biases_m: &[f64],
        numbers: &mut Vec<f64>,
    ) -> Option<f64> {
        let Self { ranges, lines, state } = *self;
        let wanted = ranges.iter().filter(is_wanted);
        numbers.clear();
        numbers.extend(wanted.map(|range| range.excess_m(lines, state, biases_m)));
        median(numbers)
    }
}

snapshot_fields!(Ranging {
    factor,
    sight,
    satellite,
    toe,
    issue,
    bias,
    ionosphere_m,
    troposphere_m,
    reflection,
});

impl Judged {
    /// Weight below which a row is ignored.
    const NEGLIGIBLE: f64 = 1e-9;

    fn of_mixture(at: &LikelihoodAt) -> Self {
        let LikelihoodAt { slope, curvature: weight, direct, .. } = *at;
        if weight < Self::NEGLIGIBLE {
            return Self { residual: 0.0, weight: 0.0, direct };
        }
        Self { residual: -slope / weight, weight, direct }
    }
}
