//! Carrier phases of the last epoch, and their differences to the next.
//!
//! The ionosphere advances a phase φ₁ by I, and one on a second frequency, φ₂, by γI. The change of
//! I between two epochs is measured as Δ(φ₁ − φ₂)/(γ − 1), with three times the noise of a phase.
//! It is also predicted by the model, whose error changes slowly. Both are weighted by their
//! variances. So from second to second the model has most of the weight. From minute to minute,
//! when the model's error would appear as a drift of the position, the second phase has most of it.

use crate::config::REFERENCE_CN0_DB_HZ;
use crate::gnss::{EphemerisIssue, ObservationCode, SatelliteId};
use crate::snapshot::{snapshot_fields, state_fields};

use super::Measurement;
use super::clock_jump::whole_milliseconds_m;
use super::factors::{Line, PhaseDifferenceFactor, Sight, State, position};
use super::ranging::above_mask;
use crate::graph::median;

/// Thermal noise of a phase difference at the reference C/N0 (m).
const THERMAL_M: f64 = 0.004;
/// Phase multipath and noise on the frequencies whose difference shows the ionosphere (m).
const PHASE_M: f64 = 0.003;
/// Correlation time of the ionosphere model's error (s): satellites cross the sky in hours, and the
/// ionosphere follows the sun.
const MODEL_LASTS_S: f64 = 1_800.0;
/// A change of the ionosphere this many standard deviations from the model is a cycle slip.
const IONOSPHERE_SIGMAS: f64 = 5.0;
/// If the median difference is further than this from whole milliseconds, the phases have another
/// clock (m): 0.1 ms.
const CLOCK_DIFFERS_M: f64 = 3e4;

/// A carrier phase of the last epoch.
#[derive(Clone, Copy, Debug)]
struct Kept {
    satellite: SatelliteId,
    code: ObservationCode,
    ephemeris: EphemerisIssue,
    /// Index of its satellite among the epoch's sights.
    sight: u16,
    /// Free of satellite clock, troposphere and ionosphere (m).
    corrected_m: f64,
    half_cycle: bool,
    /// The modelled ionospheric delay (m).
    ionosphere_m: f64,
    second: Option<SecondPhase>,
}

/// The phase on a second frequency.
#[derive(Clone, Copy, Debug)]
struct SecondPhase {
    code: ObservationCode,
    /// φ₁ − φ₂ (m): (γ − 1)·I and ambiguities.
    difference_m: f64,
    half_cycle: bool,
}

impl Kept {
    fn of((sight, measurement): (u16, &Measurement)) -> Option<Self> {
        let phase = measurement.phase?;
        let second = measurement.second.as_ref().and_then(|second| {
            second.phase.map(|other| SecondPhase {
                code: second.code,
                difference_m: phase.range_m - other.range_m,
                half_cycle: other.half_cycle,
            })
        });
        Some(Self {
            satellite: measurement.satellite,
            code: measurement.code,
            ephemeris: measurement.ephemeris,
            sight,
            corrected_m: phase.range_m - measurement.troposphere_m + measurement.ionosphere_m,
            half_cycle: phase.half_cycle,
            ionosphere_m: measurement.ionosphere_m,
            second,
        })
    }

    /// Change of the ionospheric delay since `before` that its model does not contain (m). It
    /// follows from the second frequency of `measurement`, the measurement of this phase.
    fn unmodelled_m(&self, before: &Self, measurement: &Measurement, interval_s: f64) -> f64 {
        let (Some(old), Some(new)) = (&before.second, &self.second) else { return 0.0 };
        let Some(second) = measurement.second.as_ref() else { return 0.0 };
        let lost = second.phase.is_none_or(|phase| phase.loss_of_lock);
        if lost || old.code != new.code || old.half_cycle != new.half_cycle {
            return 0.0;
        }
        let amplified = (second.gamma - 1.0).recip();
        let noise_m2 = 2.0 * amplified * amplified * {
            let thermal = |cn0| thermal_m(cn0).powi(2);
            2.0 * PHASE_M * PHASE_M + thermal(measurement.cn0_db_hz) + thermal(second.cn0_db_hz)
        };
        let model_m2 = measurement.ionosphere_m2 * (interval_s / MODEL_LASTS_S).powi(2);
        let seen_m = (new.difference_m - old.difference_m) * amplified;
        let missed_m = seen_m - (self.ionosphere_m - before.ionosphere_m);
        if IONOSPHERE_SIGMAS.powi(2) * (model_m2 + noise_m2) < missed_m * missed_m {
            return 0.0;
        }
        // In this form an infinite variance means that there is no model.
        missed_m / (1.0 + noise_m2 / model_m2)
    }
}

/// Thermal noise of the difference of two phases (m).
fn thermal_m(cn0_db_hz: Option<f64>) -> f64 {
    let decades = (REFERENCE_CN0_DB_HZ - cn0_db_hz.unwrap_or(REFERENCE_CN0_DB_HZ)) / 20.0;
    THERMAL_M * (std::f64::consts::LN_10 * decades).exp()
}

/// The phases of the last epoch.
#[derive(Debug, Default)]
pub(super) struct Phases {
    kept: Vec<Kept>,
    /// Satellites of that epoch.
    sights: Vec<Sight>,
}

snapshot_fields!(Kept {
    satellite,
    code,
    ephemeris,
    sight,
    corrected_m,
    half_cycle,
    ionosphere_m,
    second,
});
snapshot_fields!(SecondPhase { code, difference_m, half_cycle });
state_fields!(Phases { kept, sights });

/// Scratch for [`Phases::follow_clock`].
#[derive(Debug, Default)]
pub(super) struct ClockScratch {
    /// Lines of sight from the epoch before and from this one.
    lines: [Vec<Line>; 2],
    residuals_m: Vec<f64>,
}

impl Phases {
    /// Forgets the phases.
    pub(super) fn clear(&mut self) {
        self.kept.clear();
        self.sights.clear();
    }

    /// Keeps the phases of `list`, whose satellites are `sights`, for the next epoch.
    pub(super) fn keep(&mut self, sights: &[Sight], list: &[Measurement]) {
        self.kept.clear();
        self.kept.extend(above_mask(list).filter_map(Kept::of));
        self.sights.clear();
        self.sights.extend_from_slice(sights);
    }

    /// Whether they refer only to their own satellites, `sights` in number.
    pub(super) fn is_within(&self, sights: usize) -> bool {
        let is_known = |kept: &Kept| usize::from(kept.sight) < sights;
        self.kept.is_empty() || self.sights.len() == sights && self.kept.iter().all(is_known)
    }

    /// Ephemeris of a satellite's kept phase.
    pub(super) fn ephemeris(&self, satellite: SatelliteId) -> Option<EphemerisIssue> {
        let kept = self.kept.iter().find(|kept| kept.satellite == satellite);
        kept.map(|kept| kept.ephemeris)
    }

    /// Satellites of the epoch whose phases are kept.
    pub(super) fn sights(&self) -> &[Sight] {
        &self.sights
    }

    /// Differences from the kept phases to those of `list`, `interval_s` later.
    ///
    /// A satellite is left out after a loss of lock, and if only one of the two phases may be off
    /// by half a cycle. If both may, the half cycle is most likely the same, and the kernel
    /// decides.
    pub(super) fn differences(
        &self,
        list: &[Measurement],
        sigma_m: f64,
        interval_s: f64,
        factors: &mut Vec<PhaseDifferenceFactor>,
    ) {
        factors.clear();
        for (sight, measurement) in above_mask(list) {
            let Some(after) = Kept::of((sight, measurement)) else { continue };
            let Some(phase) = measurement.phase.filter(|phase| !phase.loss_of_lock) else {
                continue;
            };
            let before = self.kept.iter().find(|before| {
                before.satellite == after.satellite
                    && before.code == after.code
                    && before.half_cycle == after.half_cycle
            });
            let Some(before) = before else { continue };
            let unmodelled_m = after.unmodelled_m(before, measurement, interval_s);
            factors.push(PhaseDifferenceFactor {
                before: before.sight,
                after: after.sight,
                change_m: after.corrected_m - before.corrected_m
                    + unmodelled_m
                    + phase.ephemeris_step_m,
                inverse_sigma: sigma_m.hypot(thermal_m(measurement.cn0_db_hz)).recip(),
            });
        }
    }

    /// Corrects the differences of a receiver whose clock jumps in the pseudoranges only.
    ///
    /// The median residual of the differences between the `states` before and now is rounded to
    /// whole milliseconds, which are added to every difference. If the median is not near whole
    /// milliseconds, the phases have another clock, and the differences are dropped.
    pub(super) fn follow_clock(
        &self,
        sights: &[Sight],
        states: [&State; 2],
        factors: &mut Vec<PhaseDifferenceFactor>,
        scratch: &mut ClockScratch,
    ) {
        let ClockScratch { lines, residuals_m } = scratch;
        for ((lines, sights), from) in lines.iter_mut().zip([&*self.sights, sights]).zip(states) {
            lines.clear();
            lines.extend(sights.iter().map(|sight| sight.range(&position(from))));
        }
        let [state, next] = states;
        residuals_m.clear();
        residuals_m.extend(factors.iter().map(|factor| {
            let [from, to] =
                [&lines[0][usize::from(factor.before)], &lines[1][usize::from(factor.after)]];
            let link = factor.linearize((from, state), (to, next));
            link.residual / factor.inverse_sigma
        }));
        let Some(median_m) = median(residuals_m) else { return };
        let whole_m = whole_milliseconds_m(median_m);
        if CLOCK_DIFFERS_M < (median_m - whole_m).abs() {
            factors.clear();
            return;
        }
        factors.iter_mut().for_each(|factor| factor.change_m += whole_m);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gnss::{Ecef, EphemerisIssue, GpsTime, LocalFrame};
    use crate::models::{LookAngles, SatelliteState};
    use crate::positioning::measurements::{CarrierPhase, SecondFrequency};
    use crate::positioning::ranging::look;

    /// (f₁/f₂)² of L1 and L2 of GPS: (154/120)².
    const GAMMA: f64 = 1.646_944_444_444_444_4;
    /// Change of the ionosphere that the model does not contain (m).
    const CHANGE_M: f64 = 0.04;

    /// A satellite at the zenith, with phases advanced by the ionosphere and cycle slips on the
    /// second frequency.
    fn measurement(ionosphere_m: f64, model_m2: f64, slipped_m: f64) -> Measurement {
        let satellite = "G01".parse().unwrap();
        let code = |text| ObservationCode::parse(text).unwrap();
        let phase = |range_m| CarrierPhase {
            range_m,
            loss_of_lock: false,
            half_cycle: false,
            ephemeris_step_m: 0.0,
        };
        Measurement {
            satellite,
            code: code("1C"),
            frequency_hz: 1_575.42e6,
            ephemeris: EphemerisIssue { satellite, toe: GpsTime::EPOCH, issue: 1 },
            state: SatelliteState {
                position: Ecef::new(26_378_137.0, 0.0, 0.0),
                velocity_m_s: nalgebra::Vector3::zeros(),
                clock_m: 0.0,
                clock_drift_m_s: 0.0,
                variance_m2: 0.0,
            },
            pseudorange_m: 2e7,
            second: Some(SecondFrequency {
                code: code("2W"),
                pseudorange_m: 2e7,
                gamma: GAMMA,
                cn0_db_hz: None,
                noise_m2: 1.0,
                phase: Some(phase(2e7 - GAMMA * ionosphere_m + slipped_m)),
            }),
            range_rate_m_s: None,
            phase: Some(phase(2e7 - ionosphere_m)),
            cn0_db_hz: None,
            look: LookAngles { azimuth_rad: 0.0, elevation_rad: 1.0 },
            noise_m2: 1.0,
            ionosphere_m: 0.0,
            ionosphere_m2: model_m2,
            troposphere_m: 0.0,
            corrected_range_m: 2e7,
            variance_m2: 1.0,
            group_delay_m2: 0.0,
            ionosphere_sigma_m: 0.0,
            troposphere_sigma_m: 0.0,
            is_above_mask: true,
            is_excluded: false,
        }
    }

    fn factors(model_m2: f64, interval_s: f64, slipped_m: f64) -> Vec<PhaseDifferenceFactor> {
        let mut phases = Phases::default();
        let (first, mut sights) = ([measurement(0.0, model_m2, 0.0)], Vec::new());
        look(&LocalFrame::at(Ecef::new(6_378_137.0, 0.0, 0.0)), &first, &mut sights);
        phases.keep(&sights, &first);
        let (mut factors, later) = (Vec::new(), measurement(CHANGE_M, model_m2, slipped_m));
        phases.differences(&[later], 0.01, interval_s, &mut factors);
        factors
    }

    fn change_m(model_m2: f64, interval_s: f64, slipped_m: f64) -> f64 {
        factors(model_m2, interval_s, slipped_m)[0].change_m
    }

    /// Nothing moved. With a model of 5 m that lasts 1800 s, 30 s leave (5·30/1800)² = 0.083² m²;
    /// two phases twice have 2·(2·3² + 2·4²) mm² /0.647² = (15.5 mm)²: 96.7 % of the change is
    /// taken off. After 1 s, (2.8 mm)² to (15.5 mm)²: 3 %. Without a model, all of it.
    #[test]
    fn a_second_phase_tells_what_the_ionosphere_did() {
        assert!((change_m(25.0, 30.0, 0.0) + 0.033 * CHANGE_M).abs() < 1e-4);
        assert!((change_m(25.0, 1.0, 0.0) + 0.969 * CHANGE_M).abs() < 1e-4);
        assert!(change_m(f64::INFINITY, 1.0, 0.0).abs() < 1e-8);
        // With an exact model there is no correction.
        assert!((change_m(0.0, 30.0, 0.0) + CHANGE_M).abs() < 1e-8);
    }

    /// One cycle of L2 looks like 0.244/0.647 = 0.38 m of ionosphere, three like 1.13 m: beyond
    /// what 1 s (5·16 mm) and 30 s (5·85 mm) allow.
    #[test]
    fn a_slip_of_the_second_phase_is_not_the_ionosphere() {
        let slipped_m = change_m(25.0, 30.0, -3.0 * 0.244);
        assert!((slipped_m + CHANGE_M).abs() < 1e-8, "{slipped_m}");
        assert!((change_m(25.0, 1.0, -0.244) + CHANGE_M).abs() < 1e-8);
    }

    /// 10 mm of multipath and 4 mm of noise at 42 dB-Hz.
    #[test]
    fn the_deviation_is_multipath_and_noise() {
        let sigma_m = factors(25.0, 1.0, 0.0)[0].inverse_sigma.recip();
        assert!((sigma_m - 0.01_f64.hypot(0.004)).abs() < 1e-12, "{sigma_m}");
    }
}
