//! What the service answers: a position, how good it is, and why it is no better.

use std::fmt;

use nalgebra::{Matrix3, Vector3};

use super::{Constellation, Ecef, GpsTime, SatelliteId};

/// How a position was obtained, from none to best.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Status {
    /// No position; the reasons say why.
    None,
    /// Single-point positioning from one epoch.
    Single,
    /// An extended Kalman filter over all epochs so far.
    Ekf,
    /// A factor graph over a window of epochs.
    Fgo,
    /// Relative to a base, ambiguities real-valued.
    Float,
    /// Relative to a base, ambiguities held at integers.
    Fixed,
}

impl Status {
    /// Every status, from none to best.
    pub const ALL: [Self; 6] =
        [Self::None, Self::Single, Self::Ekf, Self::Fgo, Self::Float, Self::Fixed];

    /// The name as the API writes it.
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

    /// The status of a name as the API writes it.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|status| status.name() == name)
    }
}

/// Dilutions of precision of the satellites used, each system's clock being unknown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dops {
    /// Geometric: position and the first clock.
    pub gdop: f64,
    /// Position.
    pub pdop: f64,
    /// Horizontal.
    pub hdop: f64,
    /// Vertical.
    pub vdop: f64,
    /// Time: the first clock.
    pub tdop: f64,
}

/// Velocity of the receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Velocity {
    /// ECEF velocity (m/s).
    pub velocity_m_s: Vector3<f64>,
    /// Its covariance, ECEF, 3×3 (m²/s²).
    pub covariance: Matrix3<f64>,
    /// Receiver clock drift c·δṫ (m/s).
    pub clock_drift_m_s: f64,
}

/// A position with what is known of its quality.
#[derive(Clone, Debug, PartialEq)]
pub struct SolutionEstimate {
    /// Antenna position at the estimated time of reception, ECEF (m).
    pub position: Ecef,
    /// Its covariance, ECEF, 3×3 (m²).
    pub covariance: Matrix3<f64>,
    /// The velocity, where it could be had.
    pub velocity: Option<Velocity>,
    /// Receiver clock error against GPS time (m), or against the first constellation present.
    pub clock_m: f64,
    /// Clock of each further constellation less `clock_m` (m).
    pub inter_system_biases_m: Vec<(Constellation, f64)>,
    /// True time of reception: the receiver's tag less its clock error.
    pub reception_time: GpsTime,
    /// Dilutions of precision.
    pub dops: Dops,
    /// Satellites that determined the position, sorted.
    pub satellites_used: Vec<SatelliteId>,
    /// What differencing against a base adds; `None` without one.
    pub relative: Option<RelativeEstimate>,
}

/// What is known of a position that was found relative to a base.
#[derive(Clone, Debug, PartialEq)]
pub struct RelativeEstimate {
    /// From the base's antenna reference point to the rover's, ECEF (m).
    pub baseline_m: Vector3<f64>,
    /// The rover's tag less that of the base epoch (s).
    pub age_s: f64,
    /// Ambiguities estimated.
    pub ambiguities: usize,
    /// How many of them are held at integers; zero unless the status is [`Status::Fixed`].
    pub fixed_ambiguities: usize,
    /// Second-best over best squared norm of the integers, where they were looked for.
    pub ratio: Option<f64>,
    /// Bootstrapped success rate of these integers, 0 to 1.
    pub success_rate: Option<f64>,
    /// Estimated probability that the integers held are right, 0 to 1.
    pub fix_probability: Option<f64>,
}

/// What kept a solution from a better status or quality, with the values one needs to act.
#[derive(Clone, Debug, PartialEq)]
pub enum Reason {
    /// Satellites were observed for which no valid healthy ephemeris is held.
    EphemerisMissing {
        /// Which.
        satellites: Vec<SatelliteId>,
    },
    /// Fewer usable satellites than unknowns.
    TooFewSatellites {
        /// Usable satellites.
        used: usize,
        /// Needed, one more for each further constellation.
        needed: usize,
    },
    /// The satellites' geometry is too weak to trust a position.
    GeometryTooWeak {
        /// Geometric dilution of precision.
        gdop: f64,
    },
    /// Exactly as many satellites as unknowns: errors cannot be detected.
    NoRedundancy,
    /// The residuals contradict the stated errors; the covariance was widened to match.
    ResidualsTooLarge {
        /// Sum of squared whitened residuals over its threshold.
        ratio: f64,
    },
    /// Satellites were left out because they disagreed with the others.
    SatellitesExcluded {
        /// Which.
        satellites: Vec<SatelliteId>,
    },
    /// The iteration did not settle.
    NotConverged,
    /// No broadcast coefficients for the ionosphere model asked for; the one named was used.
    IonosphereFallback {
        /// The model used instead.
        used: &'static str,
    },
    /// No base epoch is at hand for a mode that needs one.
    BaseMissing,
    /// The newest base epoch is too old.
    BaseStale {
        /// The rover's tag less the base epoch's (s).
        age_s: f64,
    },
    /// The base's stated position contradicts what the base observes.
    BasePositionDoubtful {
        /// From the stated position to its single-point solution (m).
        distance_m: f64,
    },
    /// The base stands elsewhere than at the epoch before, so that all ambiguities began anew.
    BaseMoved {
        /// From the place before to the place now (m).
        distance_m: f64,
    },
    /// The position is relative to another base than the one before, so that all that was known
    /// relative to that one began anew.
    BaseChanged {
        /// From the base before to this one (m).
        distance_m: f64,
    },
    /// The base is too far away for differences to cancel the atmosphere.
    BaselineTooLong {
        /// Length of the baseline (m).
        length_m: f64,
    },
    /// Fewer satellites common to rover and base than unknowns.
    TooFewCommonSatellites {
        /// Common satellites that can be used.
        used: usize,
        /// Needed, one more for each further constellation.
        needed: usize,
    },
    /// Integers were found, but others explain the ambiguities nearly as well.
    RatioBelowThreshold {
        /// Second-best over best squared norm.
        ratio: f64,
        /// What it had to reach.
        threshold: f64,
    },
    /// The ambiguities are not precise enough to look for integers.
    SuccessRateTooLow {
        /// Bootstrapped success rate, 0 to 1.
        success_rate: f64,
    },
    /// Integers were found and contradict the measurements.
    FixRejected,
    /// Integers are held, but too few to place the rover within centimetres.
    FixImprecise {
        /// Greatest horizontal standard deviation of the position they give (m).
        sigma_m: f64,
    },
    /// Phases that may be off by half a cycle were left out of the integers.
    HalfCycleUnresolved {
        /// Of which satellites.
        satellites: Vec<SatelliteId>,
    },
    /// Phases slipped, so that their ambiguities began anew.
    CycleSlips {
        /// Of which satellites.
        satellites: Vec<SatelliteId>,
    },
    /// The window is young, and what it saw so far may be reflections: expect a wrong start.
    StartUnproven {
        /// Since the window began (s).
        age_s: f64,
    },
    /// The epoch's odometry does not lead from the epoch before to this one.
    OdometryUnused {
        /// How long its displacement took (s).
        interval_s: f64,
    },
}

impl Reason {
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
        }
    }

    /// What the user can do about it.
    pub const fn remedy(&self) -> &'static str {
        match self {
            Self::EphemerisMissing { .. } => "push current navigation data for these satellites",
            Self::TooFewSatellites { .. } => {
                "wait for a clearer sky, or allow more constellations or a lower elevation mask"
            }
            Self::GeometryTooWeak { .. } => "allow more constellations or wait for a clearer sky",
            Self::NoRedundancy => "allow more constellations so that errors can be detected",
            Self::ResidualsTooLarge { .. } => {
                "expect reflections; trust the covariance, which has been widened"
            }
            Self::SatellitesExcluded { .. } => "none needed: the others determine the position",
            Self::NotConverged => "check the observations; they contradict one another",
            Self::IonosphereFallback { .. } => {
                "push navigation data that carries the ionosphere coefficients"
            }
            Self::BaseMissing => "name a base and push its epochs",
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
            Self::OdometryUnused { .. } => {
                "send each displacement with the epoch where it ends, since the epoch before"
            }
        }
    }
}

/// A value of a [`Reason`].
#[derive(Clone, Debug, PartialEq)]
pub enum ReasonValue {
    /// A count or measure.
    Number(f64),
    /// A name.
    Text(&'static str),
    /// Satellites.
    Satellites(Vec<SatelliteId>),
}

impl Reason {
    /// The values of the case by name, lower camel case as the API writes them.
    pub fn values(&self) -> Vec<(&'static str, ReasonValue)> {
        use ReasonValue as V;
        match self {
            Self::EphemerisMissing { satellites } | Self::SatellitesExcluded { satellites } => {
                vec![("satellites", V::Satellites(satellites.clone()))]
            }
            Self::TooFewSatellites { used, needed } => {
                vec![("used", V::Number(*used as f64)), ("needed", V::Number(*needed as f64))]
            }
            Self::GeometryTooWeak { gdop } => vec![("gdop", V::Number(*gdop))],
            Self::ResidualsTooLarge { ratio } => vec![("ratio", V::Number(*ratio))],
            Self::IonosphereFallback { used } => vec![("used", V::Text(used))],
            Self::HalfCycleUnresolved { satellites } | Self::CycleSlips { satellites } => {
                vec![("satellites", V::Satellites(satellites.clone()))]
            }
            Self::TooFewCommonSatellites { used, needed } => {
                vec![("used", V::Number(*used as f64)), ("needed", V::Number(*needed as f64))]
            }
            Self::BaseStale { age_s } | Self::StartUnproven { age_s } => {
                vec![("ageS", V::Number(*age_s))]
            }
            Self::OdometryUnused { interval_s } => vec![("intervalS", V::Number(*interval_s))],
            Self::FixImprecise { sigma_m } => vec![("sigmaM", V::Number(*sigma_m))],
            Self::BasePositionDoubtful { distance_m }
            | Self::BaseMoved { distance_m }
            | Self::BaseChanged { distance_m } => {
                vec![("distanceM", V::Number(*distance_m))]
            }
            Self::BaselineTooLong { length_m } => vec![("lengthM", V::Number(*length_m))],
            Self::RatioBelowThreshold { ratio, threshold } => {
                vec![("ratio", V::Number(*ratio)), ("threshold", V::Number(*threshold))]
            }
            Self::SuccessRateTooLow { success_rate } => {
                vec![("successRate", V::Number(*success_rate))]
            }
            Self::NoRedundancy | Self::NotConverged | Self::BaseMissing | Self::FixRejected => {
                Vec::new()
            }
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
            Self::NoRedundancy | Self::NotConverged | Self::BaseMissing | Self::FixRejected => {
                Ok(())
            }
        }
    }
}

/// An ephemeris that a solution used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EphemerisIssue {
    /// The satellite.
    pub satellite: SatelliteId,
    /// Its time of ephemeris.
    pub toe: GpsTime,
    /// Its issue of data.
    pub issue: u32,
}

/// The epoch of a base that a solution was differenced against.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BaseEpochIssue {
    /// The base's name.
    pub base: String,
    /// The base's tag of the epoch.
    pub time: GpsTime,
}

/// Where a solution came from: enough to compute it again.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Provenance {
    /// Ephemerides used, one for each satellite used.
    pub ephemerides: Vec<EphemerisIssue>,
    /// The base epoch used, of a position relative to one.
    pub base: Option<BaseEpochIssue>,
}

/// The answer to one epoch.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// The receiver's tag, as received: it names the epoch.
    pub time: GpsTime,
    /// How the position was obtained.
    pub status: Status,
    /// The position; present unless the status is [`Status::None`].
    pub estimate: Option<SolutionEstimate>,
    /// What kept it from being better.
    pub reasons: Vec<Reason>,
    /// What it came from.
    pub provenance: Provenance,
}

impl Solution {
    /// The answer that there is no position, and why.
    pub fn none(time: GpsTime, reasons: Vec<Reason>) -> Self {
        let provenance = Provenance::default();
        Self { time, status: Status::None, estimate: None, reasons, provenance }
    }
}
