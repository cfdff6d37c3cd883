//! What is kept of a signal from epoch to epoch, and what the next epoch says of it.

use nalgebra::Vector3;

use super::causes::{SlipCause, SlipCauses};
use crate::gnss::{Ecef, GpsTime, ObservationCode, SatelliteId};

/// Carrier phase noise that no C/N0 tells of (m); RTKLIB manual 2.4.2, "carrier-phase error": 3 mm.
const PHASE_SIGMA_M: f64 = 0.003;
/// Thermal noise of a carrier phase at the C/N0 below (m): a loop of 15 Hz, Kaplan & Hegarty
/// (2017), *Understanding GPS/GNSS*, 8.5: λ/2π·√(15 Hz/(c/n0)) = 1.2 mm and some for dynamics.
const THERMAL_SIGMA_M: f64 = 0.002;
const REFERENCE_DB_HZ: f64 = 42.0;
/// Taken where no C/N0 is reported (dB-Hz).
const USUAL_DB_HZ: f64 = 40.0;

/// Where the antenna is, as far as known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AntennaPosition {
    /// The position.
    pub position: Ecef,
    /// Its standard deviation (m), all axes together.
    pub sigma_m: f64,
}

/// One carrier phase of one epoch.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    pub(super) satellite: SatelliteId,
    pub(super) code: ObservationCode,
    pub(super) time: GpsTime,
    pub(super) frequency_hz: f64,
    pub(super) wavelength_m: f64,
    /// λφ (m).
    pub(super) phase_m: f64,
    pub(super) pseudorange_m: Option<f64>,
    /// −λ·D (m/s).
    pub(super) range_rate_m_s: Option<f64>,
    pub(super) cn0_db_hz: Option<f64>,
    pub(super) half_cycle: bool,
    pub(super) loss_of_lock: bool,
    pub(super) sight: Option<Sight>,
}

/// Where the satellite was.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sight {
    pub(super) position: Ecef,
    /// c·δtˢ (m).
    pub(super) clock_m: f64,
    pub(super) troposphere_m: f64,
    /// The pseudorange that gave the time of transmission (m).
    pub(super) pseudorange_m: f64,
    /// Time of ephemeris and issue: states of different ephemerides do not continue one another.
    pub(super) issue: (GpsTime, GpsTime, u32),
}

impl Sample {
    /// Standard deviation of the phase (m).
    pub(super) fn phase_sigma_m(&self) -> f64 {
        let cn0_db_hz = self.cn0_db_hz.unwrap_or(USUAL_DB_HZ);
        PHASE_SIGMA_M.hypot(THERMAL_SIGMA_M * 10_f64.powf((REFERENCE_DB_HZ - cn0_db_hz) / 20.0))
    }
}

/// How fast a difference of phases drifts, learnt from its own past: a random walk of the rate.
///
/// What drifts is the ionosphere, and of the rest what is not modelled.
#[derive(Clone, Copy, Debug)]
pub(super) struct Trend {
    rate_m_s: f64,
    variance_m2_s2: f64,
    /// The rate that the last change would have meant, had it been believed.
    doubted_m_s: Option<f64>,
}

impl Trend {
    /// Before anything is learnt (m/s): a slant delay that changes by 0.025 TECU/s on L1.
    const FIRST_SIGMA_M_S: f64 = 0.004;
    /// Random walk of the rate (m/s/√s): 0.3 mm/s within half a minute.
    const WALK_M_S: f64 = 5e-5;

    pub(super) const fn new() -> Self {
        let variance_m2_s2 = Self::FIRST_SIGMA_M_S * Self::FIRST_SIGMA_M_S;
        Self { rate_m_s: 0.0, variance_m2_s2, doubted_m_s: None }
    }

    /// The change expected after `elapsed_s` (m).
    pub(super) fn expected_m(&self, elapsed_s: f64) -> f64 {
        self.rate_m_s * elapsed_s
    }

    /// Its variance (m²).
    pub(super) fn variance_m2(&self, elapsed_s: f64) -> f64 {
        self.predicted(elapsed_s) * elapsed_s * elapsed_s
    }

    /// Learns from a change with that variance (m, m²).
    pub(super) fn learn(&mut self, change_m: f64, variance_m2: f64, elapsed_s: f64) {
        let predicted = self.predicted(elapsed_s);
        let gain = predicted / (predicted + variance_m2 / (elapsed_s * elapsed_s));
        self.rate_m_s += gain * (change_m / elapsed_s - self.rate_m_s);
        self.variance_m2_s2 = (1.0 - gain) * predicted;
        self.doubted_m_s = None;
    }

    /// After a change that was not believed (m, m²): a slip happens once; where the next change is
    /// the same again, it is a drift.
    pub(super) fn doubt(&mut self, change_m: f64, variance_m2: f64, elapsed_s: f64) {
        let rate_m_s = change_m / elapsed_s;
        let variance_m2_s2 = variance_m2 / (elapsed_s * elapsed_s);
        let is_same = |doubted_m_s: f64| {
            let off_m_s = rate_m_s - doubted_m_s;
            off_m_s * off_m_s <= 16.0 * 2.0 * variance_m2_s2
        };
        let is_drift = self.doubted_m_s.is_some_and(is_same);
        *self = match is_drift {
            true => Self { rate_m_s, variance_m2_s2, doubted_m_s: None },
            false => Self { doubted_m_s: Some(rate_m_s), ..*self },
        };
    }

    fn predicted(&self, elapsed_s: f64) -> f64 {
        let grown = self.variance_m2_s2 + Self::WALK_M_S * Self::WALK_M_S * elapsed_s;
        grown.min(Self::FIRST_SIGMA_M_S * Self::FIRST_SIGMA_M_S)
    }
}

/// How far the antenna and the clock had moved when a signal was last seen.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Odometer {
    /// Changes when the sum below is interrupted.
    pub(super) run: u32,
    /// Sum of displacements, ECEF (m).
    pub(super) moved_m: Vector3<f64>,
    /// Sum of clock changes (m).
    pub(super) clock_m: f64,
}

/// Running mean and variance of the wide-lane ambiguity (cycles).
#[derive(Clone, Copy, Debug)]
pub(super) struct WideLane {
    pub(super) mean: f64,
    pub(super) variance: f64,
    pub(super) count: u16,
}

/// What ties a signal to the first signal of its satellite.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pairing {
    /// The code of that first signal.
    pub(super) with: ObservationCode,
    /// Drift of this phase against that one.
    pub(super) trend: Trend,
    pub(super) wide_lane: Option<WideLane>,
}

/// A signal's history.
#[derive(Clone, Debug)]
pub(super) struct Track {
    pub(super) last: Sample,
    pub(super) arc: u32,
    pub(super) since: GpsTime,
    /// A loss of lock was reported while there was no phase.
    pub(super) was_lost: bool,
    pub(super) odometer: Odometer,
    /// Drift of this phase against the other satellites.
    pub(super) trend: Trend,
    pub(super) pairing: Option<Pairing>,
}

/// What the other satellites say of a phase.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// Nothing: the smallest slip would not be seen.
    Untested,
    /// It went on without a slip.
    Continues,
    /// It slipped.
    Slipped,
    /// It moved, but so did the satellite's other signals.
    Shared,
}

/// A sample on its way through the detectors.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    pub(super) sample: Sample,
    /// Place of its history, where it has one.
    pub(super) track: Option<usize>,
    pub(super) causes: SlipCauses,
    pub(super) verdict: Verdict,
    /// By how much it misses what the other satellites say (m).
    pub(super) miss_m: f64,
}

impl Candidate {
    /// Its history, where nothing the receiver said ends it.
    pub(super) fn continued<'a>(&self, tracks: &'a [Track]) -> Option<&'a Track> {
        let said = [SlipCause::PowerFailure, SlipCause::LossOfLock, SlipCause::HalfCycle];
        let is_ended = said.into_iter().any(|cause| self.causes.contains(cause));
        self.track.filter(|_| !is_ended).map(|index| &tracks[index])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 3 mm/s over epochs of 1 s with 1 cm of noise: learnt, and kept after one slip; a jump seen
    /// twice is a drift.
    #[test]
    fn a_trend_learns_drifts_and_forgets_slips() {
        let mut trend = Trend::new();
        for _ in 0..60 {
            trend.learn(0.003, 1e-4, 1.0);
        }
        assert!((trend.expected_m(1.0) - 0.003).abs() < 5e-4, "{trend:?}");
        assert!(trend.variance_m2(1.0).sqrt() < 1.5e-3, "{trend:?}");
        trend.doubt(0.19, 1e-4, 1.0);
        assert!((trend.expected_m(1.0) - 0.003).abs() < 5e-4, "one slip moved it");
        trend.doubt(0.19, 1e-4, 1.0);
        assert_eq!(trend.expected_m(1.0), 0.19);
    }

    /// 3 mm and 2 mm·10^((42 − 22)/20) = 20 mm.
    #[test]
    fn weak_phases_are_noisy() {
        let satellite = "G05".parse().unwrap();
        let sample = Sample {
            satellite,
            code: ObservationCode::parse("1C").unwrap(),
            time: GpsTime::EPOCH,
            frequency_hz: 1.575_42e9,
            wavelength_m: 0.19,
            phase_m: 0.0,
            pseudorange_m: None,
            range_rate_m_s: None,
            cn0_db_hz: Some(22.0),
            half_cycle: false,
            loss_of_lock: false,
            sight: None,
        };
        assert!((sample.phase_sigma_m() - 0.003_f64.hypot(0.02)).abs() < 1e-12);
    }
}
