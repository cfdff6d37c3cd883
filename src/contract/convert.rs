//! Conversions between protobuf messages and the vocabulary.

use nalgebra::{Matrix3, Vector3};

use crate::config::IntakeLimits;
use crate::gnss::{
    Ecef, Epoch, FrameRefusal, GpsTime, LeapSeconds, LocalFrame, Odometry, OdometryFrame,
    Presented, Provenance, RelativeEstimate, SolutionEstimate, Status,
};
use crate::refusal::Code;
use crate::store::{Revisions, StoredSolution};

use super::intake::{self, RawObservation, RawOdometry};
use super::reason::reason;
use super::{Presenter, Refusal, v1};

/// The values of a stored row besides its solution.
#[derive(Clone, Copy, Debug)]
pub struct Stored<'a> {
    /// The client's number of the epoch; zero if it has none.
    pub seq: u64,
    /// Revision of the solution; zero for the real-time answer.
    pub revision: u32,
    /// Hash of the configuration that computed it.
    pub configuration_hash: &'a str,
    /// Version of Graphfix that computed it.
    pub version: &'a str,
}

impl From<GpsTime> for v1::GpsTime {
    fn from(time: GpsTime) -> Self {
        Self { week: time.week(), ns_of_week: time.ns_of_week() }
    }
}

/// Reads an optional time.
///
/// # Errors
/// The week or nanosecond is out of range.
pub fn time(message: Option<v1::GpsTime>, field: &str) -> Result<Option<GpsTime>, Refusal> {
    let read = |t: v1::GpsTime| intake::time(t.week, t.ns_of_week).map_err(|e| e.within(field));
    message.map(read).transpose()
}

/// Reads the ends of a span of time, both optional.
///
/// # Errors
/// A week or nanosecond is out of range, or the span ends before it begins.
pub fn span(
    from: Option<v1::GpsTime>,
    to: Option<v1::GpsTime>,
) -> Result<(Option<GpsTime>, Option<GpsTime>), Refusal> {
    let (from, to) = (time(from, "from")?, time(to, "to")?);
    match from.zip(to) {
        Some((from, to)) if to < from => {
            Err(Refusal::new(Code::InvalidField, "to is before from").at("to"))
        }
        _ => Ok((from, to)),
    }
}

/// Reads and checks an epoch.
///
/// # Errors
/// A value is invalid; the refusal's field is a path below the epoch.
pub fn epoch(message: &v1::Epoch, limits: &IntakeLimits) -> Result<Epoch, Refusal> {
    let given = message
        .time
        .ok_or_else(|| Refusal::new(Code::InvalidTime, "the epoch has no time").at("time"))?;
    let time = intake::time(given.week, given.ns_of_week).map_err(|e| e.within("time"))?;
    let observations = message.observations.iter().map(|o| RawObservation {
        satellite: &o.satellite,
        code: &o.code,
        pseudorange_m: o.pseudorange_m,
        carrier_phase_cycles: o.carrier_phase_cycles,
        doppler_hz: o.doppler_hz,
        cn0_db_hz: o.cn0_db_hz,
        loss_of_lock: o.loss_of_lock,
        half_cycle: o.half_cycle,
    });
    let epoch = intake::epoch(time, message.power_failure, observations, limits)?;
    let odometry = message.odometry.as_ref().map(|odometry| {
        intake::odometry(&RawOdometry {
            interval_s: odometry.interval_s,
            frame: &odometry.frame,
            displacement_m: &odometry.displacement_m,
            covariance_m2: &odometry.covariance_m2,
            heading_deg: odometry.heading_deg,
            heading_sigma_deg: odometry.heading_sigma_deg,
        })
        .map_err(|refusal| refusal.within("odometry"))
    });
    Ok(Epoch { odometry: odometry.transpose()?, ..epoch })
}

/// An epoch as a client sends it.
pub fn epoch_message(seq: u64, epoch: &Epoch) -> v1::Epoch {
    let observation = |o: &crate::gnss::Observation| v1::Observation {
        satellite: o.satellite.to_string().as_str().into(),
        code: o.code.to_string().as_str().into(),
        pseudorange_m: o.pseudorange_m,
        carrier_phase_cycles: o.carrier_phase.map(|phase| phase.0),
        doppler_hz: o.doppler_hz,
        cn0_db_hz: o.cn0_db_hz,
        loss_of_lock: o.loss_of_lock,
        half_cycle: o.half_cycle,
    };
    v1::Epoch {
        seq,
        time: Some(epoch.time.into()),
        observations: epoch.observations.iter().map(observation).collect(),
        power_failure: epoch.power_failure,
        odometry: epoch.odometry.as_ref().map(odometry_message),
    }
}

fn odometry_message(odometry: &Odometry) -> v1::Odometry {
    let heading_rad = match odometry.frame {
        OdometryFrame::Body { heading_rad, heading_sigma_rad } => {
            Some((heading_rad, heading_sigma_rad))
        }
        OdometryFrame::Ecef | OdometryFrame::Enu => None,
    };
    let entries = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
    v1::Odometry {
        interval_s: odometry.interval_s,
        frame: odometry.frame.name().to_owned(),
        displacement_m: odometry.displacement_m.iter().copied().collect(),
        covariance_m2: entries.map(|entry| odometry.covariance[entry]).into(),
        heading_deg: heading_rad.map(|(heading_rad, _)| heading_rad.to_degrees()),
        heading_sigma_deg: heading_rad.map(|(_, sigma_rad)| sigma_rad.to_degrees()),
    }
}

/// A solution as a message.
pub fn solution(presented: &Presented<'_>, stored: Stored<'_>) -> v1::Solution {
    let solution = &presented.solution;
    let estimate = solution.estimate.as_ref();
    v1::Solution {
        seq: stored.seq,
        revision: stored.revision,
        time: Some(solution.time.into()),
        time_utc: solution.time.to_rfc3339(&LeapSeconds::table()),
        status: status(solution.status).into(),
        position: estimate.map(|estimate| position(estimate, presented)),
        velocity: estimate.and_then(velocity),
        clock: estimate.map(clock),
        dops: estimate.and_then(dops),
        satellites_used: estimate
            .map(|e| e.satellites_used.iter().map(ToString::to_string).collect())
            .unwrap_or_default(),
        reasons: reasons(presented),
        provenance: Some(provenance(&solution.provenance, stored)),
        relative: estimate.and_then(|e| e.relative.as_ref()).map(relative),
        horizontal_protection_m: solution.protection.map(|levels| levels.horizontal_m),
        vertical_protection_m: solution.protection.map(|levels| levels.vertical_m),
    }
}

/// The reasons of a solution, and why its position is not in the requested frame.
fn reasons(presented: &Presented<'_>) -> Vec<v1::Reason> {
    let foreign = |refusal: FrameRefusal| v1::Reason {
        code: FrameRefusal::CODE.to_owned(),
        message: refusal.to_string(),
        remedy: refusal.remedy().to_owned(),
        values: None,
    };
    let reasons = presented.solution.reasons.iter().map(reason);
    reasons.chain(presented.refusal.map(foreign)).collect()
}

/// The dilutions of precision; absent if the satellites used do not determine a position alone.
fn dops(estimate: &SolutionEstimate) -> Option<v1::Dops> {
    let crate::gnss::Dops { gdop, pdop, hdop, vdop, tdop } = estimate.dops;
    let is_finite = [gdop, pdop, hdop, vdop, tdop].iter().all(|dop| dop.is_finite());
    is_finite.then_some(v1::Dops { gdop, pdop, hdop, vdop, tdop })
}

fn relative(relative: &RelativeEstimate) -> v1::Relative {
    let b = &relative.baseline_m;
    let count = |count: usize| u32::try_from(count).unwrap_or(u32::MAX);
    v1::Relative {
        baseline_ecef_m: Some(v1::Ecef { x_m: b.x, y_m: b.y, z_m: b.z }),
        length_m: b.norm(),
        age_s: relative.age_s,
        ambiguities: count(relative.ambiguities),
        fixed_ambiguities: count(relative.fixed_ambiguities),
        // With exact integers the ratio is infinite, and JSON has no such number.
        ratio: relative.ratio.filter(|ratio| ratio.is_finite()),
        success_rate: relative.success_rate,
        fix_probability: relative.fix_probability,
    }
}

/// A status as a message.
pub const fn status(status: Status) -> v1::Status {
    match status {
        Status::None => v1::Status::None,
        Status::Single => v1::Status::Single,
        Status::Ekf => v1::Status::Ekf,
        Status::Fgo => v1::Status::Fgo,
        Status::Float => v1::Status::Float,
        Status::Fixed => v1::Status::Fixed,
    }
}

/// Reads a filter by status; `None` for all.
///
/// # Errors
/// The schema does not have the number.
pub(crate) fn status_filter(number: i32) -> Result<Option<Status>, Refusal> {
    match v1::Status::try_from(number) {
        Ok(v1::Status::Unspecified) => Ok(None),
        Ok(v1::Status::None) => Ok(Some(Status::None)),
        Ok(v1::Status::Single) => Ok(Some(Status::Single)),
        Ok(v1::Status::Ekf) => Ok(Some(Status::Ekf)),
        Ok(v1::Status::Fgo) => Ok(Some(Status::Fgo)),
        Ok(v1::Status::Float) => Ok(Some(Status::Float)),
        Ok(v1::Status::Fixed) => Ok(Some(Status::Fixed)),
        Err(_) => Err(intake::unknown_status(&number.to_string())),
    }
}

/// Reads the choice of revisions; the last revision if it is absent.
///
/// # Errors
/// The schema does not have the number.
pub fn revisions(number: i32) -> Result<Revisions, Refusal> {
    match v1::Revisions::try_from(number) {
        Ok(v1::Revisions::Unspecified | v1::Revisions::Last) => Ok(Revisions::Last),
        Ok(v1::Revisions::First) => Ok(Revisions::First),
        Ok(v1::Revisions::All) => Ok(Revisions::All),
        Err(_) => Err(intake::unknown_revisions(&number.to_string())),
    }
}

/// A position as geodetic coordinates.
pub(crate) fn geodetic(position: Ecef) -> v1::Geodetic {
    let geodetic = position.to_geodetic();
    v1::Geodetic {
        latitude_deg: geodetic.latitude_rad.to_degrees(),
        longitude_deg: geodetic.longitude_rad.to_degrees(),
        height_m: geodetic.height_m,
    }
}

fn position(estimate: &SolutionEstimate, presented: &Presented<'_>) -> v1::Position {
    let Ecef(p) = estimate.position;
    let frame = LocalFrame::at(estimate.position);
    v1::Position {
        ecef: Some(v1::Ecef { x_m: p.x, y_m: p.y, z_m: p.z }),
        geodetic: Some(geodetic(estimate.position)),
        covariance_ecef_m2: Some(covariance(&estimate.covariance)),
        covariance_enu_m2: Some(covariance(&frame.covariance_to_enu(&estimate.covariance))),
        frame: presented.frame.to_owned(),
        frame_epoch_year: presented.epoch_year,
        orthometric_height_m: presented.orthometric_height_m(),
        base_frame: presented.base_frame_name().to_owned(),
        base_frame_epoch_year: presented.base_frame.and_then(|frame| frame.epoch_year),
    }
}

fn velocity(estimate: &SolutionEstimate) -> Option<v1::Velocity> {
    let velocity = estimate.velocity.as_ref()?;
    let v: Vector3<f64> = velocity.velocity_m_s;
    let local = LocalFrame::at(estimate.position).rotation * v;
    Some(v1::Velocity {
        x_m_s: v.x,
        y_m_s: v.y,
        z_m_s: v.z,
        east_m_s: local.x,
        north_m_s: local.y,
        up_m_s: local.z,
        covariance_ecef_m2_s2: Some(covariance(&velocity.covariance)),
    })
}

fn clock(estimate: &SolutionEstimate) -> v1::Clock {
    let bias = |(constellation, bias_m): &(crate::gnss::Constellation, f64)| v1::InterSystemBias {
        constellation: constellation.name().to_owned(),
        bias_m: *bias_m,
    };
    v1::Clock {
        bias_m: estimate.clock_m,
        drift_m_s: estimate.velocity.as_ref().map(|v| v.clock_drift_m_s),
        inter_system_biases: estimate.inter_system_biases_m.iter().map(bias).collect(),
        reception_time: Some(estimate.reception_time.into()),
    }
}

const fn covariance(matrix: &Matrix3<f64>) -> v1::Covariance {
    let [[xx, _, _], [xy, yy, _], [xz, yz, zz]] = matrix.data.0;
    v1::Covariance {
        first_first: xx,
        first_second: xy,
        first_third: xz,
        second_second: yy,
        second_third: yz,
        third_third: zz,
    }
}

fn provenance(provenance: &Provenance, stored: Stored<'_>) -> v1::Provenance {
    let issue = |e: &crate::gnss::EphemerisIssue| v1::EphemerisIssue {
        satellite: e.satellite.to_string(),
        toe: Some(e.toe.into()),
        issue: e.issue,
    };
    v1::Provenance {
        ephemerides: provenance.ephemerides.iter().map(issue).collect(),
        configuration_hash: stored.configuration_hash.to_owned(),
        version: stored.version.to_owned(),
        base: provenance
            .base
            .as_ref()
            .map(|used| v1::BaseEpoch { base: used.base.clone(), time: Some(used.time.into()) }),
    }
}

/// A stored solution as a message.
pub fn stored(row: &StoredSolution, presenter: &Presenter<'_>) -> v1::Solution {
    let stored = Stored {
        seq: row.seq,
        revision: row.revision,
        configuration_hash: &row.configuration_hash,
        version: &row.version,
    };
    solution(&presenter.present(&row.solution), stored)
}

/// The refusal of one epoch as a message.
pub fn refusal(refusal: &Refusal) -> v1::Refusal {
    v1::Refusal {
        code: refusal.code.name().to_owned(),
        message: refusal.message.clone(),
        remedy: refusal.code.remedy().to_owned(),
        field: refusal.field.clone().unwrap_or_default(),
    }
}
