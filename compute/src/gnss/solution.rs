//! The answer to an epoch: a position, its quality, and the reasons that limit it.

use std::fmt;

use nalgebra::{Matrix3, Vector3};

use super::{Constellation, Ecef, GpsTime, LocalFrame, SatelliteId};

/// The method that gave the position, from none to best.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Status {
    /// No position; the reasons give the cause.
    None,
    /// Single-point position from one epoch.
    Single,
    /// Extended Kalman filter over all epochs so far.
    Ekf,
    /// Factor graph over a window of epochs.
    Fgo,
    /// Relative to a base, with real-valued ambiguities.
    Float,
    /// Relative to a base, with integer ambiguities.
    Fixed,
}

impl Status {
    /// Every status, from none to best.
    pub const ALL: [Self; 6] =
        [Self::None, Self::Single, Self::Ekf, Self::Fgo, Self::Float, Self::Fixed];

    /// The name in the API.
    pub const fn name(self) -> &'static str {
        match self {
            Self::None => "NONE",
            Self::Single => "SINGLE",
            Self::Ekf => "EKF",
            Self::Fgo => "FGO",
            Self::Float => "FLOAT",
            Self::Fixed => "FIXED",
        }
    }
}

/// Dilutions of precision of the satellites used, with one unknown clock a constellation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dops {
    /// Geometric: position and first clock.
    pub gdop: f64,
    /// Position, three-dimensional.
    pub pdop: f64,
    /// Horizontal position.
    pub hdop: f64,
    /// Vertical position.
    pub vdop: f64,
    /// Time: first clock.
    pub tdop: f64,
}

/// The receiver's velocity and clock drift.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Velocity {
    /// ECEF velocity (m/s).
    pub velocity_m_s: Vector3<f64>,
    /// Covariance of the velocity, ECEF, 3×3 (m²/s²).
    pub covariance: Matrix3<f64>,
    /// Receiver clock drift c·δṫ (m/s).
    pub clock_drift_m_s: f64,
}

/// A position with its quality.
#[derive(Clone, Debug, PartialEq)]
pub struct SolutionEstimate {
    /// Antenna position at the estimated time of reception, ECEF (m).
    pub position: Ecef,
    /// Covariance of the position, ECEF, 3×3 (m²).
    pub covariance: Matrix3<f64>,
    /// The velocity, where it is observable.
    pub velocity: Option<Velocity>,
    /// Receiver clock error against GPS time, or against the first constellation present (m).
    pub clock_m: f64,
    /// Clock of each further constellation minus `clock_m` (m).
    pub inter_system_biases_m: Vec<(Constellation, f64)>,
    /// True time of reception: the receiver's time tag minus its clock error.
    pub reception_time: GpsTime,
    /// Dilutions of precision of the satellites used.
    pub dops: Dops,
    /// Satellites whose measurements determine the position, sorted.
    pub satellites_used: Vec<SatelliteId>,
    /// Values of a position relative to a base; `None` without a base.
    pub relative: Option<RelativeEstimate>,
}

impl SolutionEstimate {
    /// Standard deviations of the position (m): along the worst horizontal direction, and vertical.
    ///
    /// The former is the square root of the greater eigenvalue of the covariance of east and north:
    /// λ = (σ_e² + σ_n²)/2 + √((σ_e² − σ_n²)²/4 + σ_en²).
    pub fn sigmas_m(&self) -> (f64, f64) {
        let enu = LocalFrame::at(self.position).covariance_to_enu(&self.covariance);
        let half_difference = (enu[(0, 0)] - enu[(1, 1)]) / 2.0;
        let mean = (enu[(0, 0)] + enu[(1, 1)]) / 2.0;
        let greatest = mean + half_difference.hypot(enu[(0, 1)]);
        (greatest.max(0.0).sqrt(), enu[(2, 2)].max(0.0).sqrt())
    }
}

/// Values of a position relative to a base.
#[derive(Clone, Debug, PartialEq)]
pub struct RelativeEstimate {
    /// Vector from the base's antenna reference point to the rover's, ECEF (m).
    pub baseline_m: Vector3<f64>,
    /// The rover's time tag minus that of the base epoch (s).
    pub age_s: f64,
    /// Number of estimated ambiguities.
    pub ambiguities: usize,
    /// Number of them fixed to integers; zero unless the status is [`Status::Fixed`].
    pub fixed_ambiguities: usize,
    /// Ratio of second-best to best squared norm of the integers, by their last search. Held
    /// integers are not searched again and keep it.
    pub ratio: Option<f64>,
    /// Bootstrapped success rate of the integers, 0 to 1.
    pub success_rate: Option<f64>,
    /// Estimated probability that the fix is right, 0 to 1: its integers, and 10 cm horizontally.
    pub fix_probability: Option<f64>,
}

/// What limits the status or quality of a solution, with the values one needs to act.
#[derive(Clone, Debug, PartialEq)]
pub enum Reason {
    /// Observed satellites lack a valid healthy ephemeris.
    EphemerisMissing {
        /// The satellites without ephemeris.
        satellites: Vec<SatelliteId>,
    },
    /// There are fewer usable satellites than unknowns.
    TooFewSatellites {
        /// Number of usable satellites.
        used: usize,
        /// Number of satellites needed; one more for each further constellation.
        needed: usize,
    },
    /// The satellite geometry is too weak for a position.
    GeometryTooWeak {
        /// Geometric dilution of precision (GDOP).
        gdop: f64,
    },
    /// There are exactly as many satellites as unknowns, so errors cannot be detected.
    NoRedundancy,
    /// The residuals contradict the modelled variances; the covariance is widened to match.
    ResidualsTooLarge {
        /// Sum of squared whitened residuals, divided by its limit.
        ratio: f64,
    },
    /// Satellites were excluded because they contradict the others.
    SatellitesExcluded {
        /// The excluded satellites.
        satellites: Vec<SatelliteId>,
    },
    /// The iteration did not converge.
    NotConverged,
    /// Broadcast coefficients of the chosen ionosphere model are missing; another model was used.
    IonosphereFallback {
        /// The model that was used.
        used: &'static str,
    },
    /// The mode needs a base epoch, and no base has one.
    BaseMissing,
    /// The newest base epoch is too old.
    BaseStale {
        /// The rover's time tag minus the base epoch's (s).
        age_s: f64,
    },
    /// The base's stated position contradicts its own observations.
    BasePositionDoubtful {
        /// Distance from the stated position to the single-point position (m).
        distance_m: f64,
    },
    /// The base position changed since the previous epoch; all ambiguities restarted.
    BaseMoved {
        /// Distance from the previous base position to the present one (m).
        distance_m: f64,
    },
    /// The base is another one than at the previous epoch; all values relative to the previous base
    /// restarted.
    BaseChanged {
        /// Distance from the previous base to this one (m).
        distance_m: f64,
    },
    /// The base is too far away: differences do not cancel the atmosphere.
    BaselineTooLong {
        /// Length of the baseline (m).
        length_m: f64,
    },
    /// Rover and base have fewer satellites in common than there are unknowns.
    TooFewCommonSatellites {
        /// Number of usable common satellites.
        used: usize,
        /// Number of satellites needed; one more for each further constellation.
        needed: usize,
    },
    /// Integers were found, but the second-best ones fit nearly as well.
    RatioBelowThreshold {
        /// Ratio of second-best to best squared norm.
        ratio: f64,
        /// Smallest accepted value of the ratio.
        threshold: f64,
    },
    /// The float ambiguities are too imprecise for a search.
    SuccessRateTooLow {
        /// Bootstrapped success rate, 0 to 1.
        success_rate: f64,
    },
    /// Integers were found, but they contradict the measurements.
    FixRejected,
    /// Integers are fixed, but too few for a position within centimetres.
    FixImprecise {
        /// Standard deviation of the position with these integers that is too large (m): the
        /// greatest horizontal one, or the vertical one.
        sigma_m: f64,
    },
    /// Phases with a possible half-cycle error keep real-valued ambiguities.
    HalfCycleUnresolved {
        /// The satellites of these phases.
        satellites: Vec<SatelliteId>,
    },
    /// Cycle slips were detected; the ambiguities of these phases restarted.
    CycleSlips {
        /// The satellites of these phases.
        satellites: Vec<SatelliteId>,
    },
    /// The window is young, and all its pseudoranges may be reflections: the start may be wrong.
    StartUnproven {
        /// Time since the window began (s).
        age_s: f64,
    },
    /// The epoch's time is not after the previous one's; the previous answer is repeated.
    EpochRepeated {
        /// How far the epoch's time is before the previous one's (s); zero for the same time.
        behind_s: f64,
    },
    /// A protection level exceeds its limit, or nothing bounds the error.
    ProtectionLimitExceeded {
        /// The level (m); absent where nothing bounds the error.
        level_m: Option<f64>,
        /// The limit (m).
        limit_m: f64,
    },
    /// The epoch's odometry does not start at the previous epoch, so it was not used.
    OdometryUnused {
        /// Duration of its displacement (s).
        interval_s: f64,
    },
    /// The estimator failed on this epoch, and started again after it.
    EstimatorFailed,
}

impl Reason {
    /// Whether too few satellites, or too weak a geometry, gave no position.
    pub(crate) const fn is_geometry(&self) -> bool {
        matches!(self, Self::TooFewSatellites { .. } | Self::GeometryTooWeak { .. })
    }

    /// Stable code, upper snake case.
    pub const fn code(&self) -> &'static str {
        match self {
            Self::EphemerisMissing { .. } => "EPHEMERIS_MISSING",
            Self::TooFewSatellites { .. } => "TOO_FEW_SATELLITES",
            Self::GeometryTooWeak { .. } => "GEOMETRY_TOO_WEAK",
            Self::NoRedundancy => "NO_REDUNDANCY",
            Self::ResidualsTooLarge { .. } => "RESIDUALS_TOO_LARGE",
            Self::SatellitesExcluded { .. } => "SATELLITES_EXCLUDED",
            Self::NotConverged => "NOT_CONVERGED",
            Self::IonosphereFallback { .. } => "IONOSPHERE_FALLBACK",
            Self::BaseMissing => "BASE_MISSING",
            Self::BaseStale { .. } => "BASE_STALE",
            Self::BasePositionDoubtful { .. } => "BASE_POSITION_DOUBTFUL",
            Self::BaseMoved { .. } => "BASE_MOVED",
            Self::BaseChanged { .. } => "BASE_CHANGED",
            Self::BaselineTooLong { .. } => "BASELINE_TOO_LONG",
            Self::TooFewCommonSatellites { .. } => "TOO_FEW_COMMON_SATELLITES",
            Self::RatioBelowThreshold { .. } => "RATIO_BELOW_THRESHOLD",
            Self::SuccessRateTooLow { .. } => "SUCCESS_RATE_TOO_LOW",
            Self::FixRejected => "FIX_REJECTED",
            Self::FixImprecise { .. } => "FIX_IMPRECISE",
            Self::HalfCycleUnresolved { .. } => "HALF_CYCLE_UNRESOLVED",
            Self::CycleSlips { .. } => "CYCLE_SLIPS",
            Self::StartUnproven { .. } => "START_UNPROVEN",
            Self::OdometryUnused { .. } => "ODOMETRY_UNUSED",
            Self::EpochRepeated { .. } => "EPOCH_REPEATED",
            Self::ProtectionLimitExceeded { .. } => "PROTECTION_LIMIT_EXCEEDED",
            Self::EstimatorFailed => "ESTIMATOR_FAILED",
        }
    }

    /// What the user can do about it.
    pub const fn remedy(&self) -> &'static str {
        match self {
            Self::EphemerisMissing { .. } => {
                "give navigation data of this time for these satellites"
            }
            Self::TooFewSatellites { .. } => {
                "allow more constellations or a lower elevation mask, or choose a more open place"
            }
            Self::GeometryTooWeak { .. } => {
                "allow more constellations, or choose a more open place"
            }
            Self::NoRedundancy => "allow more constellations so that errors can be detected",
            Self::ResidualsTooLarge { .. } => {
                "expect reflections; trust the covariance, which has been widened"
            }
            Self::SatellitesExcluded { .. } => "none needed: the others determine the position",
            Self::NotConverged => "check the observations; they contradict one another",
            Self::IonosphereFallback { .. } => {
                "give navigation data that has the ionosphere coefficients"
            }
            Self::BaseMissing => "name a base that has epochs of this time",
            Self::BaseStale { .. } => "check the base's connection, or allow a greater base age",
            Self::BasePositionDoubtful { .. } => "check the coordinates stated for the base",
            Self::BaseMoved { .. } | Self::BaseChanged { .. } => {
                "none needed: a fix comes back as after cycle slips"
            }
            Self::BaselineTooLong { .. } => "choose a nearer base",
            Self::TooFewCommonSatellites { .. } => {
                "choose a base that receives the rover's constellations and bands"
            }
            Self::RatioBelowThreshold { .. }
            | Self::SuccessRateTooLow { .. }
            | Self::FixImprecise { .. } => {
                "wait for more epochs, a clearer sky, or receive a second frequency"
            }
            Self::FixRejected => "none needed: it is tried again at the next epoch",
            Self::HalfCycleUnresolved { .. } => "none needed: the receiver resolves them in time",
            Self::CycleSlips { .. } => "expect less precision until the new ambiguities settle",
            Self::StartUnproven { .. } => {
                "do not rely on the position until the reason is gone: drive on, or see more sky"
            }
            Self::EpochRepeated { .. } => "write each epoch once, in the order of time",
            Self::ProtectionLimitExceeded { .. } => {
                "do not rely on the position, or allow a greater limit or risk (`integrity.*`)"
            }
            Self::OdometryUnused { .. } => {
                "send each displacement with the epoch where it ends, since the epoch before"
            }
            Self::EstimatorFailed => "send the next epochs, and report the failure with this epoch",
        }
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.code())?;
        match self {
            Self::EphemerisMissing { satellites }
            | Self::SatellitesExcluded { satellites }
            | Self::HalfCycleUnresolved { satellites }
            | Self::CycleSlips { satellites } => write!(f, "{satellites:?}"),
            Self::TooFewSatellites { used, needed }
            | Self::TooFewCommonSatellites { used, needed } => {
                write!(f, "{{used {used} of {needed}}}")
            }
            Self::GeometryTooWeak { gdop } => write!(f, "{{gdop {gdop:.1}}}"),
            Self::ResidualsTooLarge { ratio } => write!(f, "{{ratio {ratio:.2}}}"),
            Self::IonosphereFallback { used } => write!(f, "{{used {used}}}"),
            Self::BaseStale { age_s } | Self::StartUnproven { age_s } => {
                write!(f, "{{age {age_s:.1} s}}")
            }
            Self::OdometryUnused { interval_s } => write!(f, "{{interval {interval_s:.3} s}}"),
            Self::EpochRepeated { behind_s } => write!(f, "{{behind {behind_s:.3} s}}"),
            Self::ProtectionLimitExceeded { level_m: Some(level_m), limit_m } => {
                write!(f, "{{level {level_m:.1} of {limit_m:.1} m}}")
            }
            Self::ProtectionLimitExceeded { level_m: None, limit_m } => {
                write!(f, "{{unbounded, of {limit_m:.1} m}}")
            }
            Self::FixImprecise { sigma_m } => write!(f, "{{sigma {sigma_m:.2} m}}"),
            Self::BaseMoved { distance_m } => write!(f, "{{distance {distance_m:.3} m}}"),
            Self::BaseChanged { distance_m } => write!(f, "{{distance {distance_m:.0} m}}"),
            Self::BasePositionDoubtful { distance_m } => {
                write!(f, "{{distance {distance_m:.0} m}}")
            }
            Self::BaselineTooLong { length_m } => write!(f, "{{length {length_m:.0} m}}"),
            Self::RatioBelowThreshold { ratio, threshold } => {
                write!(f, "{{ratio {ratio:.2} of {threshold:.2}}}")
            }
            Self::SuccessRateTooLow { success_rate } => {
                write!(f, "{{success rate {success_rate:.4}}}")
            }
            Self::NoRedundancy
            | Self::NotConverged
            | Self::BaseMissing
            | Self::FixRejected
            | Self::EstimatorFailed => Ok(()),
        }
    }
}

/// An ephemeris that a solution used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EphemerisIssue {
    /// The satellite of the ephemeris.
    pub satellite: SatelliteId,
    /// Time of ephemeris (toe).
    pub toe: GpsTime,
    /// Issue of data (IODE, IODnav, AODE; of GLONASS the age E_n).
    pub issue: u32,
}

/// The base epoch that a solution was differenced against.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BaseEpochIssue {
    /// The base's name.
    pub base: String,
    /// The base's time tag of the epoch.
    pub time: GpsTime,
}

/// The inputs of a solution that identify how to compute it again.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Provenance {
    /// The ephemeris of each satellite used.
    pub ephemerides: Vec<EphemerisIssue>,
    /// The base epoch, if the position is relative to a base.
    pub base: Option<BaseEpochIssue>,
}

/// Distances that the position's error exceeds with at most the probability `integrity.risk` each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Protection {
    /// Horizontal protection level (m).
    pub horizontal_m: f64,
    /// Vertical protection level (m).
    pub vertical_m: f64,
}

/// The answer to one epoch.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// The receiver's time tag as received; it identifies the epoch.
    pub time: GpsTime,
    /// The method that gave the position.
    pub status: Status,
    /// The position; present unless the status is [`Status::None`].
    pub estimate: Option<SolutionEstimate>,
    /// Protection levels of the position; absent where nothing bounds its error.
    pub protection: Option<Protection>,
    /// What limits the status or quality.
    pub reasons: Vec<Reason>,
    /// The ephemerides and the base epoch that were used.
    pub provenance: Provenance,
}

impl Solution {
    /// The answer without a position, with its reasons.
    pub fn none(time: GpsTime, reasons: Vec<Reason>) -> Self {
        let provenance = Provenance::default();
        Self { time, status: Status::None, estimate: None, protection: None, reasons, provenance }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// σ_e = σ_n = 1 m with a correlation of 0.5: the worst direction is 45° with √1.5 m.
    #[test]
    fn the_worst_horizontal_direction() {
        let position = Ecef::new(6_378_137.0, 0.0, 0.0); // Up is x, east y, north z.
        let covariance = Matrix3::new(4.0, 0.0, 0.0, 0.0, 1.0, 0.5, 0.0, 0.5, 1.0);
        let estimate = SolutionEstimate {
            position,
            covariance,
            velocity: None,
            clock_m: 0.0,
            inter_system_biases_m: Vec::new(),
            reception_time: GpsTime::EPOCH,
            dops: Dops { gdop: 1.0, pdop: 1.0, hdop: 1.0, vdop: 1.0, tdop: 1.0 },
            satellites_used: Vec::new(),
            relative: None,
        };
        let (horizontal_m, vertical_m) = estimate.sigmas_m();
        assert!((horizontal_m - 1.5_f64.sqrt()).abs() < 1e-12, "{horizontal_m}");
        assert!((vertical_m - 2.0).abs() < 1e-12, "{vertical_m}");
    }
}
