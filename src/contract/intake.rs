//! Checks of incoming values: the texts and numbers of an epoch become vocabulary.
//!
//! Both doors pass the values of their encoding. A refusal names the field at fault.

use std::collections::HashMap;

use crate::config::IntakeLimits;
use crate::gnss::{
    Cycles, Epoch, GpsTime, Observation, ObservationCode, Odometry, OdometryError, OdometryFrame,
    SatelliteId, Signal, Status, symmetric_of,
};
use crate::refusal::Code;
use crate::session::SEQUENCES;

use super::Refusal;
use super::texts::brief;

/// Largest pseudorange (m): radius of a geostationary orbit, and a clock error of 0.3 s.
const PSEUDORANGE_MAX_M: f64 = 1.5e8;
/// Largest Doppler (Hz): a receiver in low orbit with a bad oscillator.
const DOPPLER_MAX_HZ: f64 = 1e6;
/// Largest C/N0 (dB-Hz).
const CN0_MAX_DB_HZ: f64 = 100.0;

/// An observation as received.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RawObservation<'a> {
    /// Satellite, such as `G05`.
    pub satellite: &'a str,
    /// Band and attribute, such as `1C`.
    pub code: &'a str,
    /// Pseudorange (m).
    pub pseudorange_m: Option<f64>,
    /// Carrier phase (cycles).
    pub carrier_phase_cycles: Option<f64>,
    /// Doppler (Hz).
    pub doppler_hz: Option<f64>,
    /// C/N0 (dB-Hz).
    pub cn0_db_hz: Option<f64>,
    /// Loss-of-lock indicator.
    pub loss_of_lock: bool,
    /// Half-cycle ambiguity not resolved.
    pub half_cycle: bool,
}

/// A displacement as received.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RawOdometry<'a> {
    /// Duration of the displacement (s).
    pub interval_s: f64,
    /// Name of the frame: `ecef`, `enu` or `body`.
    pub frame: &'a str,
    /// Displacement along the axes of the frame (m).
    pub displacement_m: &'a [f64],
    /// Covariance in the order xx, yy, zz, xy, xz, yz (m²).
    pub covariance_m2: &'a [f64],
    /// Heading of a body frame (degrees).
    pub heading_deg: Option<f64>,
    /// Standard deviation of the heading (degrees).
    pub heading_sigma_deg: Option<f64>,
}

/// Reads a time from week and nanoseconds of week.
///
/// # Errors
/// [`Code::InvalidTime`].
pub(crate) fn time(week: i32, ns_of_week: i64) -> Result<GpsTime, Refusal> {
    GpsTime::from_week_ns(week, ns_of_week).ok_or_else(|| {
        Refusal::new(
            Code::InvalidTime,
            format!("week {week}, {ns_of_week} ns of week is not a time"),
        )
    })
}

/// Reads a time from a text `week:seconds of week`, such as `2051:46701.5`.
///
/// # Errors
/// [`Code::InvalidTime`].
pub(crate) fn time_text(text: &str) -> Result<GpsTime, Refusal> {
    let parse = || {
        let (week, seconds) = text.split_once(':')?;
        let (week, seconds) = (week.parse().ok()?, seconds.parse::<f64>().ok()?);
        // The conversion to an integer would turn NaN into 0.
        let ns = (!seconds.is_nan()).then(|| (seconds * 1e9).round() as i64)?;
        GpsTime::from_week_ns(week, ns)
    };
    parse().ok_or_else(|| {
        let message = format!("{:?} is not WEEK:SECONDS such as 2051:46701.5", brief(text));
        Refusal::new(Code::InvalidTime, message)
    })
}

/// Checks a sequence number.
///
/// # Errors
/// [`Code::InvalidSequence`].
pub(crate) fn sequence(seq: u64) -> Result<u64, Refusal> {
    if SEQUENCES.contains(&seq) {
        return Ok(seq);
    }
    let message = format!("{seq} is not in {} to {}", SEQUENCES.start(), SEQUENCES.end());
    Err(Refusal::new(Code::InvalidSequence, message).at("seq"))
}

/// Checks the number of epochs in a push.
///
/// # Errors
/// [`Code::NoEpochs`] and [`Code::TooManyEpochs`].
pub(crate) fn epoch_count(count: usize, limits: &IntakeLimits) -> Result<(), Refusal> {
    match count {
        0 => Err(Refusal::new(Code::NoEpochs, "no epoch").at("epochs")),
        _ if limits.epochs_per_push < count => {
            let message = format!("{count} epochs, at most {} in a push", limits.epochs_per_push);
            Err(Refusal::new(Code::TooManyEpochs, message).at("epochs"))
        }
        _ => Ok(()),
    }
}

/// The refusal of an unknown status.
pub(crate) fn unknown_status(given: &str) -> Refusal {
    let names: Vec<_> = Status::ALL.into_iter().map(Status::name).collect();
    let message = format!("{given:?} is not a status; known are {}", names.join(", "));
    Refusal::new(Code::InvalidField, message).at("status")
}

/// The refusal of an unknown choice of revisions.
pub(crate) fn unknown_revisions(given: &str) -> Refusal {
    let message = format!("{given:?} is not a choice of revisions; known are last, first, all");
    Refusal::new(Code::InvalidField, message).at("revisions")
}

/// Builds an epoch from its parts. Observations are grouped by satellite, in the order of each
/// satellite's first observation.
///
/// # Errors
/// An observation is invalid; the refusal's field is a path below the epoch.
pub(crate) fn epoch<'a>(
    time: GpsTime,
    power_failure: bool,
    observations: impl ExactSizeIterator<Item = RawObservation<'a>>,
    limits: &IntakeLimits,
) -> Result<Epoch, Refusal> {
    let count_max = limits.observations_per_epoch;
    if count_max < observations.len() {
        let message = format!("{} observations, at most {count_max} an epoch", observations.len());
        return Err(Refusal::new(Code::TooManyObservations, message).at("observations"));
    }
    let mut epoch = Epoch { power_failure, ..Epoch::new(time) };
    epoch.observations.reserve(observations.len());
    for (index, raw) in observations.enumerate() {
        let at = |refusal: Refusal| refusal.within(&format!("observations[{index}]"));
        epoch.observations.push(observation(raw).map_err(at)?);
    }
    bring_satellites_together(&mut epoch.observations);
    check_satellites(&epoch, limits)?;
    Ok(epoch)
}

/// Builds a displacement from its parts.
///
/// # Errors
/// [`Code::InvalidOdometry`]; the refusal's field is a path below the displacement.
pub(crate) fn odometry(raw: &RawOdometry<'_>) -> Result<Odometry, Refusal> {
    let refused = |message: String, field: &str| {
        Refusal::new(Code::InvalidOdometry, message).at(field.to_owned())
    };
    let heading_rad = raw.heading_deg.zip(raw.heading_sigma_deg);
    let frame = match (raw.frame, heading_rad) {
        ("ecef", _) => OdometryFrame::Ecef,
        ("enu", _) => OdometryFrame::Enu,
        ("body", Some((heading_deg, sigma_deg))) => OdometryFrame::Body {
            heading_rad: heading_deg.to_radians(),
            heading_sigma_rad: sigma_deg.to_radians(),
        },
        ("body", None) => return Err(refused(OdometryError::Heading.to_string(), "headingDeg")),
        (other, _) => {
            let message = format!("{:?} is not a frame; known are ecef, enu, body", brief(other));
            return Err(refused(message, "frame"));
        }
    };
    let displacement: [f64; 3] = raw.displacement_m.try_into().map_err(|_| {
        let message = format!("a displacement has 3 numbers, not {}", raw.displacement_m.len());
        refused(message, "displacementM")
    })?;
    let covariance: [f64; 6] = raw.covariance_m2.try_into().map_err(|_| {
        let message = format!("a covariance has 6 numbers, not {}", raw.covariance_m2.len());
        refused(message, "covarianceM2")
    })?;
    let odometry = Odometry {
        interval_s: raw.interval_s,
        frame,
        displacement_m: displacement.into(),
        covariance: symmetric_of(covariance),
    };
    odometry.checked().map_err(|error| {
        let field = match error {
            OdometryError::Interval { .. } => "intervalS",
            OdometryError::Displacement { .. } => "displacementM",
            OdometryError::Covariance => "covarianceM2",
            OdometryError::Heading => "headingSigmaDeg",
        };
        refused(error.to_string(), field)
    })
}

fn observation(raw: RawObservation<'_>) -> Result<Observation, Refusal> {
    let satellite: SatelliteId = raw.satellite.parse().map_err(|_| {
        let message = format!("{:?} is not a satellite", brief(raw.satellite));
        Refusal::new(Code::InvalidSatellite, message).at("satellite")
    })?;
    let code = ObservationCode::parse(raw.code)
        .filter(|code| Signal::of(satellite, *code).band().is_some())
        .ok_or_else(|| {
            let message = format!("{:?} is not a signal of {satellite}", brief(raw.code));
            Refusal::new(Code::InvalidSignal, message).at("code")
        })?;
    let name = |field: &str| format!("{satellite} {code}: {field}");
    let within = |value: Option<f64>, low: f64, high: f64, field: &str| match value {
        // No range contains NaN.
        Some(v) if !(low..=high).contains(&v) => {
            let message = format!("{} {v} is not in {low:e} to {high:e}", name(field));
            Err(Refusal::new(Code::InvalidMeasurement, message).at(field))
        }
        kept => Ok(kept),
    };
    let phase_max = Cycles::LIMIT;
    Ok(Observation {
        satellite,
        code,
        loss_of_lock: raw.loss_of_lock,
        half_cycle: raw.half_cycle,
        pseudorange_m: within(raw.pseudorange_m, 1.0, PSEUDORANGE_MAX_M, "pseudorangeM")?,
        carrier_phase: within(
            raw.carrier_phase_cycles,
            -phase_max,
            phase_max,
            "carrierPhaseCycles",
        )?
        .map(Cycles),
        doppler_hz: within(raw.doppler_hz, -DOPPLER_MAX_HZ, DOPPLER_MAX_HZ, "dopplerHz")?,
        cn0_db_hz: within(raw.cn0_db_hz, 0.0, CN0_MAX_DB_HZ, "cn0DbHz")?,
    })
}

/// Groups observations by satellite, in the order of first appearance. Most receivers already send
/// them so.
fn bring_satellites_together(observations: &mut [Observation]) {
    if are_together(observations) {
        return;
    }
    let mut first: HashMap<SatelliteId, usize> = HashMap::new();
    for (index, observation) in observations.iter().enumerate() {
        first.entry(observation.satellite).or_insert(index);
    }
    observations.sort_by_key(|observation| first[&observation.satellite]);
}

/// Whether the observations of each satellite are consecutive. Most receivers send satellites in
/// their order. Otherwise there are few satellites, so a linear search is faster than a table.
fn are_together(observations: &[Observation]) -> bool {
    if observations.is_sorted_by_key(|observation| observation.satellite) {
        return true;
    }
    let mut satellites: Vec<SatelliteId> = Vec::with_capacity(64);
    for observation in observations {
        let satellite = observation.satellite;
        if satellites.last() == Some(&satellite) {
            continue;
        }
        if satellites.contains(&satellite) {
            return false;
        }
        satellites.push(satellite);
    }
    true
}

fn check_satellites(epoch: &Epoch, limits: &IntakeLimits) -> Result<(), Refusal> {
    let mut satellites = 0;
    for (satellite, observations) in epoch.by_satellite() {
        satellites += 1;
        for (index, observation) in observations.iter().enumerate() {
            if observations[..index].iter().any(|other| other.code == observation.code) {
                let message = format!("{satellite} {} appears twice", observation.code);
                return Err(Refusal::new(Code::DuplicateSignal, message).at("observations"));
            }
        }
    }
    if limits.satellites_per_epoch < satellites {
        let most = limits.satellites_per_epoch;
        let message = format!("{satellites} satellites in an epoch, at most {most}");
        return Err(Refusal::new(Code::TooManySatellites, message).at("observations"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: IntakeLimits =
        IntakeLimits { satellites_per_epoch: 3, observations_per_epoch: 5, epochs_per_push: 2 };

    fn raw<'a>(satellite: &'a str, code: &'a str) -> RawObservation<'a> {
        RawObservation {
            satellite,
            code,
            pseudorange_m: Some(2.2e7),
            carrier_phase_cycles: None,
            doppler_hz: None,
            cn0_db_hz: None,
            loss_of_lock: false,
            half_cycle: false,
        }
    }

    fn taken(raw: &[RawObservation<'_>]) -> Result<Epoch, Refusal> {
        epoch(GpsTime::EPOCH, false, raw.iter().copied(), &LIMITS)
    }

    fn refused(raw: &[RawObservation<'_>]) -> (Code, String) {
        let refusal = taken(raw).unwrap_err();
        (refusal.code, refusal.field.unwrap_or_default())
    }

    #[test]
    fn satellites_come_together_in_order_of_appearance() {
        let epoch = taken(&[raw("G05", "1C"), raw("E11", "1C"), raw("G05", "2W")]).unwrap();
        let names: Vec<_> =
            epoch.observations.iter().map(|o| format!("{}{}", o.satellite, o.code)).collect();
        assert_eq!(names, ["G051C", "G052W", "E111C"]);
    }

    #[test]
    fn the_field_at_fault_is_named() {
        assert_eq!(
            refused(&[raw("X05", "1C")]),
            (Code::InvalidSatellite, "observations[0].satellite".into())
        );
        let no_such_band = [raw("G01", "1C"), raw("G05", "7Q")];
        assert_eq!(refused(&no_such_band), (Code::InvalidSignal, "observations[1].code".into()));
        let nan = RawObservation { pseudorange_m: Some(f64::NAN), ..raw("G05", "1C") };
        assert_eq!(
            refused(&[nan]),
            (Code::InvalidMeasurement, "observations[0].pseudorangeM".into())
        );
        let twice = [raw("G05", "1C"), raw("E11", "1C"), raw("G05", "1C")];
        assert_eq!(refused(&twice).0, Code::DuplicateSignal);
    }

    #[test]
    fn an_invalid_displacement_is_named() {
        let good = RawOdometry {
            interval_s: 1.0,
            frame: "body",
            displacement_m: &[8.0, 0.0, 0.0],
            covariance_m2: &[0.04, 0.01, 0.01, 0.0, 0.0, 0.0],
            heading_deg: Some(90.0),
            heading_sigma_deg: Some(2.0),
        };
        assert!(odometry(&good).is_ok());
        let wrong = [
            (RawOdometry { interval_s: -1.0, ..good }, "intervalS"),
            (RawOdometry { frame: "ned", ..good }, "frame"),
            (RawOdometry { displacement_m: &[8.0], ..good }, "displacementM"),
            (RawOdometry { displacement_m: &[8.0, f64::NAN, 0.0], ..good }, "displacementM"),
            (RawOdometry { covariance_m2: &[0.04; 6], ..good }, "covarianceM2"),
            (RawOdometry { covariance_m2: &[0.04; 5], ..good }, "covarianceM2"),
            (RawOdometry { heading_deg: None, ..good }, "headingDeg"),
            (RawOdometry { heading_sigma_deg: Some(-1.0), ..good }, "headingSigmaDeg"),
        ];
        for (raw, field) in wrong {
            let refusal = odometry(&raw).unwrap_err();
            assert_eq!(
                (refusal.code, refusal.field.as_deref()),
                (Code::InvalidOdometry, Some(field))
            );
        }
    }

    #[test]
    fn limits_hold() {
        let four = ["G01", "G02", "G03", "G04"].map(|name| raw(name, "1C"));
        assert_eq!(refused(&four).0, Code::TooManySatellites);
        let six = ["1C", "1W", "1L", "2W", "2L", "5Q"].map(|code| raw("G01", code));
        assert_eq!(refused(&six).0, Code::TooManyObservations);
        assert_eq!(epoch_count(3, &LIMITS).unwrap_err().code, Code::TooManyEpochs);
        assert_eq!(epoch_count(0, &LIMITS).unwrap_err().code, Code::NoEpochs);
        assert_eq!(sequence(0).unwrap_err().code, Code::InvalidSequence);
        assert_eq!(time(2051, -1).unwrap_err().code, Code::InvalidTime);
    }
}
