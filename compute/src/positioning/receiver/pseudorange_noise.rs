//! Noise of pseudoranges and probability of reflection by C/N0, relative to an estimated level.
//!
//! Receivers report C/N0 differently, and streets weaken direct signals differently. One parameter
//! for each constellation describes both: S₀, the C/N0 at which half of the signals are
//! reflections. With a = S − S₀ (dB):
//!
//! π = 1/(1 + e^(a/3 dB)), within 0.02 … 0.98
//! σ² = (1 m)² + ½·(0.5 m/sin E)² + (4 m·10^(−a/20))² + i²
//!
//! The S₀ are normal about a common level, with a standard deviation of 3 dB; that level has a
//! normal prior of 32 ± 6 dB-Hz. All are on one grid of 2 dB. The likelihood is that of the
//! residuals, each weighted by its independent share. The floor of 1 m is multipath of a strong
//! signal with orbit and clock errors; thermal noise grows as 10^(−S/20) (Hartinger & Brunner 1999,
//! SIGMA-ε). Slope and width of π and the 4 m come from tables of pseudorange errors by C/N0 of one
//! receiver (docs/estimation.md). i is a standard deviation of three parts. One is that of the
//! ionosphere's model beyond the smallest one of the epoch, because a common error goes into the
//! clock. Another is that of a group delay that the message does not contain. The third is zero
//! for the accuracy that messages state in normal operation: the floor covers it. Beyond that, the
//! error of orbit and clock in normal operation grows in proportion to the stated accuracy.

use std::f64::consts::LN_10;

use crate::gnss::{Constellation, SatelliteId};
use crate::models::normal_operation_m;
use crate::positioning::Measurement;
use crate::snapshot::snapshot_fields;

use super::grid::Grid;
use super::kept;
use crate::positioning::log_product::log_product;
use crate::positioning::pseudorange_error::{LOWEST_SINE, PseudorangeError, extra_path_m};

/// First value of the grid, and its step (dB-Hz).
const FIRST_DB_HZ: f64 = 20.0;
const STEP_DB: f64 = 2.0;
/// The last value is 48 dB-Hz.
const VALUES: usize = 15;
/// Mean of the levels' prior (dB-Hz).
const LEVEL_DB_HZ: f64 = 32.0;
/// Its standard deviation (dB).
const LEVEL_SIGMA_DB: f64 = 6.0;
/// Standard deviation of the constellations' levels about the common one (dB): the interface
/// specifications of GPS, GLONASS, Galileo and BeiDou guarantee powers on L1 that differ by some
/// decibels, and receivers track different modulations differently.
const SPREAD_DB: f64 = 3.0;
/// Width of the logistic function of the probability of reflection (dB).
const LOGISTIC_DB: f64 = 3.0;
/// The same where S₀ is unknown (dB).
const UNLEARNT_LOGISTIC_DB: f64 = 4.81;
/// Bounds of the probability of reflection: C/N0 alone is never certain evidence.
const REFLECTED: std::ops::RangeInclusive<f64> = 0.02..=0.98;
/// Standard deviation of a strong signal (m).
const FLOOR_M: f64 = 1.0;
/// Standard deviation that grows towards the horizon (m).
const ELEVATION_M: f64 = 0.5;
/// Standard deviation of noise at S₀ (m).
const NOISE_M: f64 = 4.0;
/// C/N0 that replaces a missing one (dB-Hz). S₀ is then relative to it.
const CN0_IF_MISSING_DB_HZ: f64 = 38.0;

/// Properties of a pseudorange that its noise depends on.
#[derive(Clone, Copy, Debug)]
pub(in crate::positioning) struct Signal {
    pub(in crate::positioning) cn0_db_hz: Option<f64>,
    pub(in crate::positioning) elevation_rad: f64,
    /// Standard deviation of ionosphere, group delay, orbit and clock beyond the parts that all
    /// satellites share and that the floor covers (m).
    pub(in crate::positioning) model_m: f64,
}

impl Signal {
    /// From a corrected measurement; `common_m` is [`common_ionosphere_m`] of its epoch.
    pub(in crate::positioning) fn of(measurement: &Measurement, common_m: f64) -> Self {
        let ionosphere_m = (measurement.ionosphere_sigma_m - common_m).max(0.0);
        let constellation = measurement.satellite.constellation;
        let orbit_m2 = unusual_m2(constellation, measurement.state.variance_m2);
        let satellite_m2 = measurement.group_delay_m2 + orbit_m2;
        Self {
            cn0_db_hz: measurement.cn0_db_hz,
            elevation_rad: measurement.look.elevation_rad,
            model_m: ionosphere_m.hypot(satellite_m2.sqrt()),
        }
    }
}

/// Variance of orbit and clock beyond the floor (m²): their error in normal operation grows in
/// proportion to the accuracy that the message states.
fn unusual_m2(constellation: Constellation, stated_m2: f64) -> f64 {
    let (usual_m, error_m) = normal_operation_m(constellation);
    let ratio_2 = stated_m2 / (usual_m * usual_m);
    error_m * error_m * (ratio_2 - 1.0).max(0.0)
}

/// Standard deviation of the ionosphere's model that all satellites share (m): this part of the
/// error goes into the clock.
pub(in crate::positioning) fn common_ionosphere_m(list: &[Measurement]) -> f64 {
    let used = list.iter().filter(|m| m.is_above_mask);
    used.map(|m| m.ionosphere_sigma_m).fold(f64::INFINITY, f64::min)
}

/// A pseudorange residual with the properties that its noise depends on.
#[derive(Clone, Copy, Debug)]
pub(in crate::positioning) struct PseudorangeExcess {
    pub(in crate::positioning) satellite: SatelliteId,
    pub(in crate::positioning) signal: Signal,
    /// Standard deviation in force (m).
    pub(in crate::positioning) sigma_m: f64,
    /// Measured − modelled (m).
    pub(in crate::positioning) excess_m: f64,
}

/// The levels S₀ of one receiver, one for each constellation.
#[derive(Clone, Debug)]
pub(super) struct PseudorangeNoise {
    /// Likelihood of each constellation's level by its own residuals.
    evidence: [Grid<VALUES>; Constellation::COUNT],
    /// Posterior means (dB-Hz).
    levels_db_hz: [f64; Constellation::COUNT],
}

snapshot_fields!(PseudorangeNoise { evidence, levels_db_hz });

impl Default for PseudorangeNoise {
    fn default() -> Self {
        Self {
            evidence: [Grid::new(no_evidence); Constellation::COUNT],
            levels_db_hz: [LEVEL_DB_HZ; Constellation::COUNT],
        }
    }
}

fn no_evidence(_index: f64) -> f64 {
    0.0
}

fn level_db_hz(index: f64) -> f64 {
    FIRST_DB_HZ + STEP_DB * index
}

/// A normal density, one at its mean.
fn normal(distance_db: f64, deviation_db: f64) -> f64 {
    (-0.5 * (distance_db / deviation_db).powi(2)).exp()
}

impl PseudorangeNoise {
    /// Error model of a pseudorange for the mean of its constellation's level.
    pub(super) fn error(&self, constellation: Constellation, signal: &Signal) -> PseudorangeError {
        error_at(self.levels_db_hz[constellation.index()], signal)
    }

    /// Updates with the residuals of an epoch, each with the weight `share` of an independent one.
    pub(super) fn learn(&mut self, interval_s: f64, share: f64, residuals: &[PseudorangeExcess]) {
        let models: Vec<_> = residuals.iter().map(|r| NoiseByLevel::of(&r.signal)).collect();
        for (constellation, evidence) in Constellation::ALL.into_iter().zip(&mut self.evidence) {
            evidence.fade(kept(interval_s), no_evidence);
            let all = residuals.iter().zip(&models);
            let own = all.filter(|(r, _)| r.satellite.constellation == constellation);
            if own.clone().next().is_some() {
                evidence.update(|index| {
                    let level = Level::of(level_db_hz(index));
                    let densities =
                        own.clone().map(|(r, model)| model.error(&level).density(r.excess_m));
                    share * log_product(densities)
                });
            }
        }
        self.levels_db_hz = means(&self.evidence.each_ref().map(Grid::relative));
    }
}

/// Posterior means of the levels (dB-Hz), given the likelihoods of each on the grid.
///
/// With L the common level, p(S₀ of c) ∝ l_c(S₀)·Σ_L N(S₀; L, 3 dB)·p(L | all but c), and p(L | all
/// but c) ∝ prior(L)·Π_{d≠c} Σ_{S₀} N(S₀; L, 3 dB)·l_d(S₀).
fn means(likelihoods: &[[f64; VALUES]; Constellation::COUNT]) -> [f64; Constellation::COUNT] {
    let kernel: [f64; VALUES] = std::array::from_fn(|n| normal(STEP_DB * n as f64, SPREAD_DB));
    let spread = |values: &[f64; VALUES]| -> [f64; VALUES] {
        std::array::from_fn(|i| {
            values.iter().enumerate().map(|(k, value)| kernel[i.abs_diff(k)] * value).sum()
        })
    };
    let messages = likelihoods.each_ref().map(spread);
    let prior: [f64; VALUES] =
        std::array::from_fn(|i| normal(level_db_hz(i as f64) - LEVEL_DB_HZ, LEVEL_SIGMA_DB));
    std::array::from_fn(|own| {
        let mut common = prior;
        for (_, message) in messages.iter().enumerate().filter(|(other, _)| *other != own) {
            common.iter_mut().zip(message).for_each(|(product, factor)| *product *= factor);
        }
        let (mut sum, mut first) = (0.0, 0.0);
        for (i, (expected, likelihood)) in spread(&common).iter().zip(&likelihoods[own]).enumerate()
        {
            sum += expected * likelihood;
            first += expected * likelihood * level_db_hz(i as f64);
        }
        first / sum
    })
}

/// Probability of reflection by the prior of S₀ alone.
///
/// The mean over S₀ = 32 ± 6 dB-Hz of the logistic function of width 3 dB is, within 0.011, one of
/// width 3·√(1 + π/8·(6/3)²) dB: both are nearly normal distribution functions, whose variances
/// add.
pub(in crate::positioning) fn reflected_before_learning(cn0_db_hz: Option<f64>) -> f64 {
    let above_db = cn0_db_hz.unwrap_or(CN0_IF_MISSING_DB_HZ) - LEVEL_DB_HZ;
    (1.0 + (above_db / UNLEARNT_LOGISTIC_DB).exp()).recip()
}

/// Error model of a pseudorange by the prior of S₀ alone.
pub(in crate::positioning) fn error_before_learning(signal: &Signal) -> PseudorangeError {
    let reflected = reflected_before_learning(signal.cn0_db_hz);
    PseudorangeError { reflected, ..error_at(LEVEL_DB_HZ, signal) }
}

/// Error model for S₀ = `level_db_hz`.
fn error_at(level_db_hz: f64, signal: &Signal) -> PseudorangeError {
    NoiseByLevel::of(signal).error(&Level::of(level_db_hz))
}

/// The factors that a level S₀ contributes to all signals.
struct Level {
    /// 10^(S₀/10).
    noise: f64,
    /// e^(−S₀/3 dB).
    odds: f64,
}

impl Level {
    fn of(level_db_hz: f64) -> Self {
        let (noise, odds) = factors(level_db_hz);
        Self { noise: noise.recip(), odds: odds.recip() }
    }
}

/// The noise of a signal as a function of the level.
struct NoiseByLevel {
    /// The part of σ² that does not depend on the level (m²).
    quiet_m2: f64,
    /// (4 m)²·10^(−S/10) (m²).
    noise_m2: f64,
    /// e^(S/3 dB).
    odds: f64,
    /// λ (m).
    extra_path_m: f64,
}

impl NoiseByLevel {
    fn of(signal: &Signal) -> Self {
        let Signal { cn0_db_hz, elevation_rad, model_m } = *signal;
        let (noise, odds) = factors(cn0_db_hz.unwrap_or(CN0_IF_MISSING_DB_HZ));
        let sine = elevation_rad.sin().max(LOWEST_SINE);
        let low_m = ELEVATION_M / sine;
        let quiet_m2 = FLOOR_M * FLOOR_M + 0.5 * low_m * low_m + model_m * model_m;
        let noise_m2 = NOISE_M * NOISE_M * noise;
        Self { quiet_m2, noise_m2, odds, extra_path_m: extra_path_m(sine) }
    }

    fn error(&self, level: &Level) -> PseudorangeError {
        let reflected = (1.0 + self.odds * level.odds).recip();
        PseudorangeError {
            sigma_m: (self.quiet_m2 + self.noise_m2 * level.noise).sqrt(),
            reflected: reflected.clamp(*REFLECTED.start(), *REFLECTED.end()),
            extra_path_m: self.extra_path_m,
        }
    }
}

/// 10^(−S/10) and e^(S/3 dB).
fn factors(cn0_db_hz: f64) -> (f64, f64) {
    ((-cn0_db_hz * (LN_10 / 10.0)).exp(), (cn0_db_hz / LOGISTIC_DB).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// GPS in normal operation states at most 4.85 m and errs by 0.6 m: at a stated 48.5 m it errs
    /// by 6 m, of which the floor covers 0.6 m. Galileo states 3.12 m and errs by 0.2 m.
    #[test]
    fn the_error_grows_with_the_stated_accuracy() {
        let unusual_m2 = |constellation, stated_m: f64| unusual_m2(constellation, stated_m.powi(2));
        for usual_m in [0.0, 2.4, 4.85] {
            assert_eq!(unusual_m2(Constellation::Gps, usual_m), 0.0);
        }
        assert!((unusual_m2(Constellation::Gps, 48.5) - (36.0 - 0.36)).abs() < 1e-9);
        assert!((unusual_m2(Constellation::Galileo, 31.2) - (4.0 - 0.04)).abs() < 1e-9);
    }

    /// At S₀ and the zenith half of the signals are reflections, σ² = 1 + ½·0.25 + 16. At 20 dB
    /// above S₀ the noise is 0.4 m.
    #[test]
    fn the_model_worked_by_hand() {
        let error = |cn0_db_hz| {
            let elevation_rad = std::f64::consts::FRAC_PI_2;
            error_at(32.0, &Signal { cn0_db_hz: Some(cn0_db_hz), elevation_rad, model_m: 0.0 })
        };
        let at = error(32.0);
        assert!((at.reflected - 0.5).abs() < 1e-12);
        assert!((at.sigma_m - 17.125_f64.sqrt()).abs() < 1e-12);
        let strong = error(52.0);
        assert!((strong.sigma_m - 1.285_f64.sqrt()).abs() < 1e-12);
        assert_eq!(strong.reflected, 0.02);
    }

    fn learnt(satellite: &str, excess_m: f64) -> [f64; Constellation::COUNT] {
        let mut noise = PseudorangeNoise::default();
        let residual = PseudorangeExcess {
            satellite: satellite.parse().unwrap(),
            signal: Signal { cn0_db_hz: Some(30.0), elevation_rad: 1.0, model_m: 0.0 },
            sigma_m: 4.0,
            excess_m,
        };
        (0..60).for_each(|_| noise.learn(1.0, 0.1, &[residual; 8]));
        noise.levels_db_hz
    }

    /// Residuals of half a metre at 30 dB-Hz lower the level; residuals 30 m late raise it.
    #[test]
    fn the_level_follows_the_residuals() {
        let level = |excess_m| learnt("E01", excess_m)[Constellation::Galileo.index()];
        assert!(level(0.5) < 26.0 && 36.0 < level(30.0), "{} {}", level(0.5), level(30.0));
    }

    /// Galileo's residuals give 36 ± 3 dB-Hz. The prior of each level is 32 ± √(6² + 3²) dB-Hz,
    /// with a correlation of 6²/(6² + 3²) = 0.8. Galileo moves by 4·45/(45 + 9) = 3.33 dB, the
    /// others by 0.8 of that.
    #[test]
    fn a_constellation_without_residuals_follows_the_others() {
        let mut likelihoods = [[1.0; VALUES]; Constellation::COUNT];
        likelihoods[Constellation::Galileo.index()] =
            std::array::from_fn(|i| normal(level_db_hz(i as f64) - 36.0, 3.0));
        for (constellation, level) in Constellation::ALL.into_iter().zip(means(&likelihoods)) {
            let moved_db = if constellation == Constellation::Galileo { 3.33 } else { 2.67 };
            assert!((level - LEVEL_DB_HZ - moved_db).abs() < 0.2, "{constellation:?} {level}");
        }
    }

    /// Without residuals all levels are near the prior's mean. The grid's lower end is nearer than
    /// the upper one and cuts off more.
    #[test]
    fn no_evidence_leaves_the_prior() {
        let uniform = [[1.0; VALUES]; Constellation::COUNT];
        assert!(means(&uniform).iter().all(|level| (level - LEVEL_DB_HZ).abs() < 1.0));
    }
}
