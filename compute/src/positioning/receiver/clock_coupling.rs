//! Estimates how closely pseudorange, phase and Doppler of a receiver follow one clock.
//!
//! Geodetic receivers derive all three from one oscillator and one time tag. Phones steer and round
//! the time tag by up to hundreds of metres each second. The pseudorange follows the time tag;
//! Doppler, and on some chips phase, follows the free oscillator. The change of the pseudorange
//! minus that of phase, or minus the integral of Doppler, is free of geometry. Its median over the
//! satellites is the step of one clock against the other, with the noise of a median, 1.2533·σ/√n.
//!
//! Steps are modelled as a steady drift plus Student's t of three degrees of freedom. The scale of
//! t has a flat prior on a grid of octaves from 0.1 m/√s to 205 m/√s. The estimate is conservative:
//! two standard deviations of the posterior above its mean. So clocks are tied only if the data
//! confirm it, and without data they are free.

use crate::gnss::{ObservationCode, SatelliteId};
use crate::graph::median;
use crate::positioning::Measurement;
use crate::positioning::clock_jump::whole_milliseconds_m;
use crate::positioning::factors::ClockStepPrior;
use crate::snapshot::{snapshot_fields, state_fields};

use super::grid::Grid;
use super::kept;

/// First scale of the grid (m/√s), and number of octaves.
const FIRST_M: f64 = 0.1;
const VALUES: usize = 12;
/// Standard deviations by which the estimate exceeds the posterior mean.
const PLAUSIBLE: f64 = 2.0;
/// Minimum number of satellites for the step of an epoch.
const SATELLITES_MIN: usize = 4;
/// Epochs further apart than this are not compared (s).
const INTERVAL_MAX_S: f64 = 5.0;
/// Number of epochs after which the drift is robust against single steps.
const DRIFT_EPOCHS: f64 = 10.0;
/// Variance of the median because values are reported with few digits (m²).
const READING_M2: f64 = 0.01;

/// The drift of one clock against another, and the scale of its steps.
#[derive(Clone, Debug)]
struct Steps {
    octave: Grid<VALUES>,
    drift_m_s: f64,
    epochs: f64,
}

snapshot_fields!(Steps { octave, drift_m_s, epochs });

impl Default for Steps {
    fn default() -> Self {
        Self { octave: Grid::new(flat), drift_m_s: 0.0, epochs: 0.0 }
    }
}

fn flat(_: f64) -> f64 {
    0.0
}

impl Steps {
    fn step_prior(&self, interval_s: f64) -> ClockStepPrior {
        let (mean, deviation) = self.octave.moments();
        let scale_m = FIRST_M * (mean + PLAUSIBLE * deviation).exp2();
        ClockStepPrior {
            mean_m: self.drift_m_s * interval_s,
            scale_m2: scale_m * scale_m * interval_s,
        }
    }

    /// Updates with the changes of one observable minus another, one for each satellite (m).
    fn learn(&mut self, interval_s: f64, changes_m: &mut [f64]) {
        let keep = kept(interval_s);
        self.octave.fade(keep, flat);
        self.epochs *= keep;
        let count = changes_m.len();
        let Some(middle_m) = median(changes_m).filter(|_| SATELLITES_MIN <= count) else { return };
        changes_m.iter_mut().for_each(|change| *change = (*change - middle_m).abs());
        let sigma_m = 1.4826 * median(changes_m).unwrap_or(0.0);
        let noise_m2 = (1.2533 * sigma_m).powi(2) / count as f64 + READING_M2;
        let step_m = middle_m - whole_milliseconds_m(middle_m);
        let off_m = step_m - self.drift_m_s * interval_s;
        let scale_m = FIRST_M * self.octave.moments().0.exp2();
        let bound_m = match self.epochs < DRIFT_EPOCHS {
            true => f64::INFINITY,
            false => 3.0 * (scale_m * scale_m * interval_s + noise_m2).sqrt(),
        };
        self.epochs += 1.0;
        let correction_m_s = off_m.clamp(-bound_m, bound_m) / interval_s;
        self.drift_m_s += correction_m_s / self.epochs;
        let square_m2 = off_m * off_m / interval_s;
        self.octave.update(|index| {
            let variance_m2 = (FIRST_M * index.exp2()).powi(2) + noise_m2 / interval_s;
            -0.5 * variance_m2.ln() - 2.0 * (square_m2 / (3.0 * variance_m2)).ln_1p()
        });
    }
}

/// One signal at the last epoch.
#[derive(Clone, Copy, Debug)]
struct Kept {
    satellite: SatelliteId,
    code: ObservationCode,
    range_m: f64,
    phase_m: Option<f64>,
    rate_m_s: Option<f64>,
}

snapshot_fields!(Kept { satellite, code, range_m, phase_m, rate_m_s });

impl Kept {
    fn of(m: &Measurement) -> Self {
        Self {
            satellite: m.satellite,
            code: m.code,
            range_m: m.pseudorange_m,
            phase_m: m.phase.map(|phase| phase.range_m),
            rate_m_s: m.range_rate_m_s,
        }
    }
}

/// Estimates of the clocks, and the last epoch's observations.
#[derive(Debug, Default)]
pub(super) struct ClockCoupling {
    last: Vec<Kept>,
    pseudorange_minus_phase: Steps,
    pseudorange_minus_doppler: Steps,
}

state_fields!(ClockCoupling { last, pseudorange_minus_phase, pseudorange_minus_doppler });

impl ClockCoupling {
    /// Compares an epoch with the one before, `interval_s` earlier.
    pub(super) fn observe(&mut self, list: &[Measurement], interval_s: Option<f64>) {
        if let Some(interval_s) = interval_s.filter(|interval_s| *interval_s <= INTERVAL_MAX_S) {
            let (mut phase_m, mut doppler_m) = (Vec::new(), Vec::new());
            for m in list {
                let same = |k: &&Kept| k.satellite == m.satellite && k.code == m.code;
                let Some(before) = self.last.iter().find(same) else { continue };
                let change_m = m.pseudorange_m - before.range_m;
                let unbroken = m.phase.filter(|phase| !phase.loss_of_lock);
                if let (Some(now), Some(then)) = (unbroken, before.phase_m) {
                    phase_m.push(change_m - (now.range_m - then));
                }
                if let (Some(now), Some(then)) = (m.range_rate_m_s, before.rate_m_s) {
                    doppler_m.push(change_m - 0.5 * interval_s * (now + then));
                }
            }
            self.pseudorange_minus_phase.learn(interval_s, &mut phase_m);
            self.pseudorange_minus_doppler.learn(interval_s, &mut doppler_m);
        }
        self.last.clear();
        self.last.extend(list.iter().map(Kept::of));
    }

    /// Prior of the step of the pseudoranges' clock over `interval_s`, against the integral of the
    /// Doppler's drift.
    pub(super) fn pseudorange_against_doppler(&self, interval_s: f64) -> ClockStepPrior {
        self.pseudorange_minus_doppler.step_prior(interval_s)
    }

    /// Prior of the step of the phases' clock against the pseudoranges' over `interval_s`.
    pub(super) fn phase_against_pseudorange(&self, interval_s: f64) -> ClockStepPrior {
        let prior = self.pseudorange_minus_phase.step_prior(interval_s);
        ClockStepPrior { mean_m: -prior.mean_m, ..prior }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Steps of 30 m each second with a scatter of 1 m among five satellites: a drift of 30 m/s and
    /// a scale far below it.
    #[test]
    fn a_steady_step_is_a_drift() {
        let mut steps = Steps::default();
        for k in 0..120 {
            let common = 30.0 + 0.5 * f64::from(k % 3 - 1);
            steps.learn(1.0, &mut [-1.0, -0.5, 0.0, 0.5, 1.0].map(|noise| common + noise));
        }
        let prior = steps.step_prior(1.0);
        assert!((prior.mean_m - 30.0).abs() < 0.5, "{}", prior.mean_m);
        assert!(prior.scale_m2.sqrt() < 2.0, "{}", prior.scale_m2);
        assert!((steps.step_prior(2.0).scale_m2 / prior.scale_m2 - 2.0).abs() < 1e-12);
    }

    /// Without data, or with too few satellites, nothing is tied: the scale is above 100 m/√s.
    #[test]
    fn nothing_is_tied_without_evidence() {
        let mut steps = Steps::default();
        steps.learn(1.0, &mut [0.0; 3]);
        assert!(1e4 < steps.step_prior(1.0).scale_m2);
    }

    /// A jump by whole milliseconds of the pseudoranges alone is corrected elsewhere: it is not a
    /// drift.
    #[test]
    fn milliseconds_are_taken_off() {
        let mut steps = Steps::default();
        let millisecond_m = whole_milliseconds_m(3e5);
        (0..60).for_each(|_| steps.learn(1.0, &mut [millisecond_m; 5]));
        assert!(steps.step_prior(1.0).mean_m.abs() < 1e-6 && steps.step_prior(1.0).scale_m2 < 0.1);
    }
}
