//! From float ambiguities to integers, and back to the position.
//!
//! Integers once found are kept with their arcs: as labels, of which only differences within a
//! group mean anything. They are no part of the graph: at each epoch the float solution is
//! conditioned on them anew, after a test of whether it still agrees, and they are dropped when it
//! does not. What is not labelled is then looked for in what that leaves.

use nalgebra::DMatrix;

use crate::config::RtkOptions;
use crate::gnss::{Constellation, Reason};
use crate::lambda::{KnownScale, Options, Outcome, Partial, Rejection, Resolver, odds_at_scale};
use crate::snapshot::snapshot_fields;

use super::arcs::{Arc, Label};
use super::float::FloatSolution;
use super::joint::{Joint, at_odds, chosen_of, condition, doubted};
use super::noise::KnownNoise;
use super::placed::{FIXED_SIGMA_M, FixedPosition, fixed_position};

/// Ambiguities that storage is made for at first.
const CAPACITY: usize = 64;
/// Candidates that the posterior probability is made of.
const CANDIDATES: usize = 4;
/// Integers tried in all searches of one epoch together.
const NODES_MAX: usize = 20_000;
/// Subsets tried in one epoch.
const ATTEMPTS_MAX: usize = 12;
/// The same of those that join integers kept: what is not found now is looked for at every epoch.
const OTHERS_ATTEMPTS_MAX: usize = 3;
/// Highest probability that integers are kept with: a slip may have passed unseen.
const CERTAIN: f64 = 1.0 - 1e-6;
/// Squared norm of kept integers, for each of them, up to which they agree beyond question: 2σ rms.
pub(super) const DISAGREEMENT: f64 = 4.0;

/// What looking for integers came to.
#[derive(Clone, Debug)]
pub(super) struct Resolution {
    /// Double differences there were.
    pub(super) ambiguities: usize,
    /// Those of them that began beside kept ones with this epoch and have no integer yet.
    pub(super) begun: usize,
    pub(super) ratio: Option<f64>,
    pub(super) success_rate: Option<f64>,
    pub(super) outcome: Result<FixedPosition, Reason>,
}

impl Resolution {
    /// The same where integers are enough to place the rover: not where they leave it uncertain,
    /// nor where they are of less than half of the ambiguities that could have any.
    pub(super) fn if_a_place(self) -> Self {
        let expected = self.ambiguities - self.begun;
        let place = |fixed: FixedPosition| {
            let sigma_m = fixed.horizontal_sigma_m();
            if FIXED_SIGMA_M < sigma_m {
                return Err(Reason::FixImprecise { sigma_m });
            }
            if 2 * fixed.held < expected { Err(Reason::FixRejected) } else { Ok(fixed) }
        };
        Self { outcome: self.outcome.and_then(place), ..self }
    }
}

/// A double difference against the reference of its group, as places in the list of arcs.
#[derive(Clone, Copy, Debug)]
struct DoubleDifference {
    arc: usize,
    reference: usize,
    /// Its integer, where both arcs have labels.
    known: Option<i64>,
}

/// How the labels came about, to be kept with the arcs.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Trust {
    /// Epochs in a row that found the same integers, up to what is asked for.
    pub(super) agreed: u32,
    pub(super) probability: f64,
    pub(super) ratio: Option<f64>,
    pub(super) success_rate: Option<f64>,
    /// Times that all labels were dropped.
    pub(super) era: u32,
    /// The last era whose labels were found to be wrong.
    pub(super) refuted: Option<u32>,
    /// Whether they have agreed for as long as is asked for since they were found.
    pub(super) was_kept: bool,
    /// How many origins labels have had.
    pub(super) origins: u32,
}

snapshot_fields!(Trust {
    agreed,
    probability,
    ratio,
    success_rate,
    era,
    refuted,
    was_kept,
    origins,
});

/// How integers are looked for.
#[derive(Clone, Copy, Debug)]
struct Search<'a> {
    options: &'a Options,
    /// What odds are divided by.
    doubt: f64,
    /// Epochs in a row after which labels are kept.
    hold_epochs: u32,
    /// Labels were kept and no longer agree with the float solution.
    were_kept: bool,
}

/// Resolves integers; its memory is used again.
#[derive(Debug)]
pub(super) struct Integers {
    pub(super) resolver: Resolver,
    pairs: Vec<DoubleDifference>,
    /// Place of each arc among the covariances.
    places: Vec<Option<usize>>,
    order: Vec<usize>,
}

impl Default for Integers {
    fn default() -> Self {
        Self {
            resolver: Resolver::with_capacity(CAPACITY),
            pairs: Vec::new(),
            places: Vec::new(),
            order: Vec::new(),
        }
    }
}

impl Integers {
    /// Looks for the integers of the arcs that are `present`, and labels them, by what is known of
    /// the pseudoranges' noise.
    pub(super) fn resolve(
        &mut self,
        arcs: &mut [Arc],
        trust: &mut Trust,
        is_present: impl Fn(&Arc) -> bool,
        float: &FloatSolution,
        options: &RtkOptions,
        noise: &KnownNoise,
    ) -> Resolution {
        let is_eligible = |arc: &Arc| is_present(arc) && may_be_integer(arc, options);
        self.difference(arcs, is_eligible, float);
        for pair in self.pairs.iter().filter(|pair| pair.known.is_none()) {
            // What is counted from elsewhere says nothing here.
            if arcs[pair.reference].label.is_some() {
                arcs[pair.arc].label = None;
            }
        }
        if self.pairs.len() < options.fixed_min {
            let (used, needed) = (self.pairs.len(), options.fixed_min);
            return self.refused(Reason::TooFewCommonSatellites { used, needed });
        }
        let joint = self.joint(float);
        let (lambda, doubt) = (lambda_options(options, noise.scale), noise.doubt);
        let were_kept = options.hold_epochs <= trust.agreed;
        let kept = Options { probability_min: options.hold_probability_min, ..lambda };
        if were_kept && let Some(resolution) = self.resolve_held(arcs, trust, &joint, &kept) {
            return resolution;
        }
        let hold_epochs = options.hold_epochs;
        let search = Search { options: &lambda, doubt, hold_epochs, were_kept };
        let resolution = self.resolve_anew(arcs, trust, &joint, &search);
        // What no longer agrees is not wrong before other integers are found.
        if were_kept && options.hold_epochs <= trust.agreed {
            drop_labels(arcs, trust, false);
        }
        resolution
    }

    fn refused(&self, reason: Reason) -> Resolution {
        let ambiguities = self.pairs.len();
        let (ratio, success_rate) = (None, None);
        Resolution { ambiguities, begun: 0, ratio, success_rate, outcome: Err(reason) }
    }

    /// Conditions on the labels, then looks for the integers of the others. `None` where too few
    /// have labels, or these no longer agree with the float solution.
    fn resolve_held(
        &mut self,
        arcs: &mut [Arc],
        trust: &mut Trust,
        joint: &Joint,
        options: &Options,
    ) -> Option<Resolution> {
        let known = self.indices(|pair| pair.known.is_some());
        let others = self.indices(|pair| pair.known.is_none());
        if known.len() < options.fixed_min {
            return None;
        }
        let values: Vec<f64> =
            known.iter().map(|&i| self.pairs[i].known.unwrap_or(0) as f64).collect();
        let (mut rest, squared_norm) = condition(joint, &known, &values, &others)?;
        let odds = match DISAGREEMENT * (known.len() as f64) < squared_norm {
            true => self.odds_against_the_best(arcs, joint, &known, squared_norm, options)?,
            false => 1.0,
        };
        let believed = at_odds(odds, trust.probability);
        let probability = doubted(believed, &rest);
        if probability < options.probability_min {
            return None;
        }
        let mut held = known.len();
        if !others.is_empty() {
            let lambda = Options { fixed_min: 1, attempts_max: OTHERS_ATTEMPTS_MAX, ..*options };
            let places: Vec<usize> = (0..others.len()).collect();
            let outcome = self.search(arcs, &rest, &places, &others, &lambda);
            if outcome.is_some_and(|outcome| outcome.rejection.is_none())
                && let Some(left) = self.hold_found(&rest, &places)
            {
                held += self.label(arcs, trust, &others);
                rest = left;
            }
        }
        let is_new = |arc: &Arc| arc.epochs == 1 && arc.label.is_none();
        Some(Resolution {
            ambiguities: self.pairs.len(),
            begun: self.pairs.iter().filter(|pair| is_new(&arcs[pair.arc])).count(),
            ratio: trust.ratio,
            success_rate: trust.success_rate,
            outcome: Ok(fixed_position(&rest, held, probability)),
        })
    }

    /// How much likelier than the best integers those of the pairs `known` are, whose squared norm
    /// is given: at most one. `None` where no search tells.
    ///
    /// Errors that last put float ambiguities further from their integers than these are uncertain,
    /// which says nothing of the integers as long as no others fit better.
    fn odds_against_the_best(
        &mut self,
        arcs: &[Arc],
        joint: &Joint,
        known: &[usize],
        squared_norm: f64,
        options: &Options,
    ) -> Option<f64> {
        let anything = Options {
            success_rate_min: 0.0,
            ratio_min: 0.0,
            probability_min: 0.0,
            fixed_min: known.len(),
            attempts_max: 1,
            ..*options
        };
        let best = self.search(arcs, joint, known, known, &anything)?.squared_norm?;
        Some(odds_at_scale([squared_norm, best.min(squared_norm)], known.len(), options.scale?))
    }

    /// Looks for all integers; labels must be found again until they are trusted. Of integers that
    /// contradict each other the likelier are believed, and none is answered before they are found
    /// again.
    fn resolve_anew(
        &mut self,
        arcs: &mut [Arc],
        trust: &mut Trust,
        joint: &Joint,
        search: &Search<'_>,
    ) -> Resolution {
        let Search { options, doubt, hold_epochs, were_kept } = *search;
        let (mut tried, mut resolution) = (0, self.refused(Reason::FixRejected));
        for wanted in self.subsets(arcs, options.fixed_min) {
            let found = self.search(arcs, joint, &wanted, &wanted, options);
            let Some(outcome) = found else { continue };
            tried += outcome.attempts;
            resolution.ratio = outcome.ratio;
            resolution.success_rate = Some(outcome.success_rate);
            if let Some(reason) = refusal(&outcome, options) {
                resolution.outcome = Err(reason);
                continue;
            }
            resolution.outcome = Err(Reason::FixRejected);
            let stated = chosen_of(doubt * tried as f64, outcome.probability.unwrap_or(0.0));
            let Some(rest) = self.hold_found(joint, &wanted) else { continue };
            let probability = doubted(stated, &rest);
            if options.probability_min <= probability {
                let [agreeing, contradicting] = self.compare_with_labels(&wanted);
                if 0 < contradicting {
                    if probability <= trust.probability {
                        continue;
                    }
                    drop_labels(arcs, trust, true);
                    return resolution;
                }
                if were_kept {
                    drop_labels(arcs, trust, false);
                }
                let held = self.label(arcs, trust, &wanted);
                trust.agreed += 1;
                trust.was_kept |= hold_epochs <= trust.agreed;
                // What more satellites have told is not lost with them.
                let kept = if agreeing < options.fixed_min { 0.0 } else { trust.probability };
                trust.probability = probability.max(kept).min(CERTAIN);
                (trust.ratio, trust.success_rate) = (outcome.ratio, Some(outcome.success_rate));
                resolution.outcome = Ok(fixed_position(&rest, held, probability));
                return resolution;
            }
        }
        resolution
    }

    /// How many of the integers the last search found among the pairs `wanted` are those known, and
    /// how many are others.
    fn compare_with_labels(&self, wanted: &[usize]) -> [usize; 2] {
        let found = wanted.iter().zip(self.resolver.fix().entries());
        let both = found.filter_map(|(&i, entry)| self.pairs[i].known.zip(*entry));
        both.fold([0, 0], |[agreeing, contradicting], (known, found)| match known == found {
            true => [agreeing + 1, contradicting],
            false => [agreeing, contradicting + 1],
        })
    }

    /// The pairs to look for together, one set after another until one is found: those of groups
    /// with one wavelength, where there are others; all; and all but one group.
    ///
    /// Receivers of different makers may not agree on the phase of one signal.
    fn subsets(&self, arcs: &[Arc], fixed_min: usize) -> Vec<Vec<usize>> {
        let group = |pair: &DoubleDifference| arcs[pair.arc].group();
        let mut groups: Vec<_> = self.pairs.iter().map(group).collect();
        groups.sort_unstable();
        groups.dedup();
        let mut subsets: Vec<Vec<usize>> = Vec::new();
        let mut add = |wanted: Vec<usize>| {
            if fixed_min <= wanted.len() && !subsets.contains(&wanted) {
                subsets.push(wanted);
            }
        };
        add(self.indices(|pair| has_one_wavelength(&arcs[pair.arc])));
        add(self.indices(|_| true));
        groups.iter().for_each(|out| add(self.indices(|pair| group(pair) != *out)));
        subsets
    }

    /// Position and the ambiguities left real-valued, given the integers the last search found of
    /// those at `wanted`, ascending; `None` where the covariance does not allow it.
    fn hold_found(&self, joint: &Joint, wanted: &[usize]) -> Option<Joint> {
        let found = wanted.iter().zip(self.resolver.fix().entries());
        let (held, values): (Vec<usize>, Vec<f64>) =
            found.filter_map(|(&i, entry)| Some((i, (*entry)? as f64))).unzip();
        let all = 0..joint.ambiguities();
        let left: Vec<usize> = all.filter(|i| held.binary_search(i).is_err()).collect();
        condition(joint, &held, &values, &left).map(|(rest, _)| rest)
    }

    fn indices(&self, is_wanted: impl Fn(&DoubleDifference) -> bool) -> Vec<usize> {
        (0..self.pairs.len()).filter(|&i| is_wanted(&self.pairs[i])).collect()
    }

    /// Looks for the integers of the pairs `wanted`, of which `joint` holds estimate and covariance
    /// at `places`.
    fn search(
        &mut self,
        arcs: &[Arc],
        joint: &Joint,
        places: &[usize],
        wanted: &[usize],
        options: &Options,
    ) -> Option<Outcome> {
        let n = wanted.len();
        let float: Vec<f64> = places.iter().map(|i| joint.estimate[3 + i]).collect();
        let between = |i: usize, j: usize| joint.covariance[(3 + places[i], 3 + places[j])];
        let covariance = DMatrix::from_fn(n, n, between);
        let strength = |&i: &usize| {
            let arc = &arcs[self.pairs[wanted[i]].arc];
            (arc.epochs.min(2), arc.elevation_rad)
        };
        self.order.clear();
        self.order.extend(0..n);
        self.order.sort_by(|a, b| {
            let ((a_epochs, a), (b_epochs, b)) = (strength(a), strength(b));
            a_epochs.cmp(&b_epochs).then(a.total_cmp(&b))
        });
        let partial = Partial::Ordered(&self.order);
        self.resolver.resolve(&float, &covariance, partial, options).ok()
    }

    /// Labels the arcs of the pairs whose integers the last search found; returns how many.
    fn label(&self, arcs: &mut [Arc], trust: &mut Trust, wanted: &[usize]) -> usize {
        let entries = self.resolver.fix().entries();
        let mut count = 0;
        for (&i, entry) in wanted.iter().zip(entries) {
            let Some(integer) = *entry else { continue };
            let DoubleDifference { arc, reference, .. } = self.pairs[i];
            let zero = *arcs[reference].label.get_or_insert_with(|| {
                trust.origins += 1;
                Label { origin: trust.origins, integer: 0 }
            });
            arcs[arc].label = Some(Label { integer: zero.integer + integer, ..zero });
            count += 1;
        }
        count
    }

    /// Double differences of the eligible arcs, each against one of its group: the highest of those
    /// with a label, if there are any.
    fn difference(
        &mut self,
        arcs: &[Arc],
        is_eligible: impl Fn(&Arc) -> bool,
        float: &FloatSolution,
    ) {
        self.places.clear();
        self.places
            .extend(arcs.iter().map(|arc| float.place(arc.variable).filter(|_| is_eligible(arc))));
        self.pairs.clear();
        for (arc, own) in arcs.iter().enumerate() {
            if self.places[arc].is_none() {
                continue;
            }
            let rank = |arc: &Arc| (arc.label.is_some(), arc.elevation_rad);
            let mut reference = arc;
            for (other, candidate) in arcs.iter().enumerate() {
                let is_better = rank(&arcs[reference]) < rank(candidate);
                if is_better && self.places[other].is_some() && candidate.group() == own.group() {
                    reference = other;
                }
            }
            if reference != arc {
                let both = own.label.zip(arcs[reference].label);
                let known = both.and_then(|(own, zero)| own.less(zero));
                self.pairs.push(DoubleDifference { arc, reference, known });
            }
        }
    }

    /// Position and double differences with their covariance.
    fn joint(&self, float: &FloatSolution) -> Joint {
        let place = |arc: usize| self.places[arc].expect("arcs of double differences have places");
        let places: Vec<_> =
            self.pairs.iter().map(|pair| (place(pair.arc), place(pair.reference))).collect();
        Joint::of_differences(float, &places)
    }
}

/// Whether all arcs of the group have one wavelength, so that what they share is an offset.
fn has_one_wavelength(arc: &Arc) -> bool {
    arc.satellite.constellation != Constellation::Glonass
}

/// Whether the ambiguity of an arc is looked for among integers.
pub(super) fn may_be_integer(arc: &Arc, options: &RtkOptions) -> bool {
    !arc.half_cycle && options.elevation_mask_rad <= arc.elevation_rad
}

/// Forgets the integers kept, because they are wrong or because too few are left.
pub(super) fn drop_labels(arcs: &mut [Arc], trust: &mut Trust, are_wrong: bool) {
    arcs.iter_mut().for_each(|arc| arc.label = None);
    let refuted = if are_wrong { Some(trust.era) } else { trust.refuted };
    let (era, origins) = (trust.era + 1, trust.origins);
    *trust = Trust { era, refuted, origins, ..Trust::default() };
}

/// How integers are looked for where that is known of the noise's scale.
pub(super) fn lambda_options(options: &RtkOptions, scale: KnownScale) -> Options {
    Options {
        success_rate_min: options.success_rate_min,
        ratio_min: options.ratio_min,
        probability_min: options.found_probability_min(),
        scale: Some(scale),
        fixed_min: options.fixed_min,
        candidates: CANDIDATES,
        nodes_max: NODES_MAX,
        attempts_max: ATTEMPTS_MAX,
    }
}

/// Why integers were not accepted, if they were not.
fn refusal(outcome: &Outcome, options: &Options) -> Option<Reason> {
    Some(match outcome.rejection? {
        Rejection::Ratio => Reason::RatioBelowThreshold {
            ratio: outcome.ratio.unwrap_or(1.0),
            threshold: options.ratio_min,
        },
        Rejection::Probability | Rejection::SuccessRate | Rejection::SearchLimit => {
            Reason::SuccessRateTooLow { success_rate: outcome.success_rate }
        }
        Rejection::TooFew | Rejection::Magnitude => Reason::FixRejected,
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Vector3};

    use super::*;
    use crate::config::{Mode, PositioningOptions, Profile};
    use crate::gnss::{Band, GpsTime, ObservationCode, SatelliteId};
    use crate::positioning::rtk::noise::{NoiseScale, Residuals};

    const N: usize = 7;

    /// Arcs of one group, of which one stands highest.
    fn arcs(highest: usize) -> Vec<Arc> {
        let code = ObservationCode::parse("1C").unwrap();
        let arc = |k: usize| Arc {
            satellite: SatelliteId::new(Constellation::Gps, 1 + k as u8).unwrap(),
            band: Band::L1,
            codes: [code; 2],
            variable: k,
            serial: k as u64,
            frequency_hz: 1_575.42e6,
            last: GpsTime::EPOCH,
            epochs: 5,
            half_cycle: false,
            elevation_rad: if k == highest { 1.5 } else { 0.5 + 0.1 * k as f64 },
            label: None,
        };
        (0..N).map(arc).collect()
    }

    /// Ambiguities at integers k², 0.05 cycles off at the most and 25.3 off in common, a metre of
    /// the position each moves them by two cycles or less.
    fn float() -> FloatSolution {
        let wave = |k: usize| (1.7 * k as f64).sin();
        let tie = |i: usize, axis: usize| match i.checked_sub(3) {
            None => f64::from(u8::from(i == axis)),
            Some(k) => 2.0 * ((1 + axis) as f64 * k as f64).cos(),
        };
        let mut covariance = DMatrix::identity(3 + N, 3 + N) * 4e-4;
        for i in 0..3 + N {
            for j in 0..3 + N {
                // Known to 5 cm along each axis, and to a cycle in common.
                let real = (0..3).map(|axis| 0.0025 * tie(i, axis) * tie(j, axis)).sum::<f64>();
                covariance[(i, j)] += real + if i < 3 || j < 3 { 0.0 } else { 1.0 };
            }
        }
        FloatSolution {
            position: Vector3::new(5.0, -3.0, 2.0),
            variables: (0..N).collect(),
            ambiguities: (0..N).map(|k| 25.3 + (k * k) as f64 + 0.05 * wave(k)).collect(),
            covariance,
        }
    }

    /// Whichever satellite is the reference, the same integers, position and probability are found.
    #[test]
    fn the_reference_satellite_does_not_matter() {
        let options = PositioningOptions::new(Mode::RtkFgo, Profile::General);
        let found = |highest: usize| {
            let (mut arcs, mut trust) = (arcs(highest), Trust::default());
            let noise = NoiseScale::stated().known(&Residuals::NONE);
            let resolution = Integers::default().resolve(
                &mut arcs,
                &mut trust,
                |_| true,
                &float(),
                &options.rtk,
                &noise,
            );
            let fixed = resolution.outcome.unwrap();
            let first = arcs[0].label.unwrap();
            let integers = arcs.iter().map(|arc| arc.label.unwrap().less(first).unwrap());
            assert_eq!((fixed.held, arcs[highest].label.unwrap().integer), (N - 1, 0));
            (fixed, integers.collect::<Vec<_>>())
        };
        let (fixed, integers) = found(0);
        assert_eq!(integers, (0..N).map(|k| (k * k) as i64).collect::<Vec<_>>());
        for highest in 1..N {
            let (other, others) = found(highest);
            assert_eq!(others, integers, "{highest}");
            assert!((other.position - fixed.position).norm() < 1e-9, "{highest}");
            assert!((other.covariance - fixed.covariance).norm() < 1e-12, "{highest}");
            assert!((other.probability - fixed.probability).abs() < 1e-9, "{highest}");
        }
    }

    fn resolved(arcs: &mut [Arc], trust: &mut Trust) -> Resolution {
        let options = PositioningOptions::new(Mode::RtkFgo, Profile::General);
        let noise = NoiseScale::stated().known(&Residuals::NONE);
        Integers::default().resolve(arcs, trust, |_| true, &float(), &options.rtk, &noise)
    }

    fn integers(arcs: &[Arc]) -> Vec<i64> {
        arcs.iter().map(|arc| arc.label.unwrap().integer).collect()
    }

    /// Integers that contradict likelier ones are not believed; likelier than those, they are at the
    /// next epoch, and those were wrong.
    #[test]
    fn the_likelier_are_believed() {
        let others: Vec<i64> = (0..N as i64).map(|k| k * k + k % 2).collect();
        for agreed in [1, 1000] {
            let mut arcs = arcs(0);
            for (arc, &integer) in arcs.iter_mut().zip(&others) {
                arc.label = Some(Label { origin: 1, integer });
            }
            let certain = Trust { agreed, probability: CERTAIN, era: 4, ..Trust::default() };
            let (mut known, mut trust) = (arcs.clone(), certain);
            assert!(resolved(&mut known, &mut trust).outcome.is_err());
            assert_eq!(trust.refuted, None);
            match agreed {
                1 => assert_eq!(integers(&known), others),
                _ => assert!(known.iter().all(|arc| arc.label.is_none()), "kept, but out of reach"),
            }
            let mut trust = Trust { probability: 0.99, ..certain };
            assert!(resolved(&mut arcs, &mut trust).outcome.is_err());
            assert_eq!((trust.refuted, trust.era), (Some(4), 5));
            assert!(resolved(&mut arcs, &mut trust).outcome.is_ok());
            assert_eq!(integers(&arcs), (0..N as i64).map(|k| k * k).collect::<Vec<_>>());
        }
    }

    /// Kept integers that float ambiguities have wandered off by 3σ stay as long as no others fit
    /// better.
    #[test]
    fn kept_integers_stay_while_none_fit_better() {
        let options = PositioningOptions::new(Mode::RtkFgo, Profile::General);
        let noise = NoiseScale::stated().known(&Residuals::NONE);
        let mut arcs = arcs(0);
        for (k, arc) in arcs.iter_mut().enumerate() {
            arc.label = Some(Label { origin: 1, integer: (k * k) as i64 });
        }
        let kept = Trust { agreed: 1000, probability: CERTAIN, era: 4, ..Trust::default() };
        let mut off = float();
        for (k, ambiguity) in off.ambiguities.iter_mut().enumerate() {
            *ambiguity += 0.15 * (1.7 * k as f64).sin();
        }
        let mut trust = kept;
        let resolution = Integers::default().resolve(
            &mut arcs,
            &mut trust,
            |_| true,
            &off,
            &options.rtk,
            &noise,
        );
        assert_eq!(resolution.outcome.unwrap().held, N - 1);
        assert_eq!((trust.era, trust.agreed), (4, 1000));
    }

    /// Four of eight ambiguities place the rover, four of nine do not unless one has just begun, nor do
    /// eight that leave it uncertain by more than 5 cm.
    #[test]
    fn few_integers_or_rough_ones_are_no_place() {
        let outcome = |ambiguities, begun, held, sigma_m: f64| {
            let covariance = Matrix3::identity() * sigma_m.powi(2);
            let position = Vector3::zeros();
            let fixed = FixedPosition { position, covariance, held, probability: 0.999 };
            let (ratio, success_rate) = (None, None);
            let outcome = Ok(fixed);
            Resolution { ambiguities, begun, ratio, success_rate, outcome }.if_a_place().outcome
        };
        assert!(outcome(8, 0, 4, 0.04).is_ok() && outcome(9, 1, 4, 0.04).is_ok());
        assert!(matches!(outcome(9, 0, 4, 0.04), Err(Reason::FixRejected)));
        assert!(matches!(outcome(8, 0, 8, 0.06), Err(Reason::FixImprecise { .. })));
    }
}
