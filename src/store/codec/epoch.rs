//! Epochs as bytes.
//!
//! Header: version, time, power failure, number of observations. Each observation: satellite, code,
//! one byte of flags, one byte of four 2-bit tags, then the present values. Version 2 adds the
//! odometry at the end: frame, interval, displacement, covariance, and the heading of a body frame.

use crate::gnss::{Cycles, Epoch, Observation, ObservationCode, Odometry, OdometryFrame};

use super::CodecError;
use super::bytes::{Decoder, Encoder};

/// Version of an epoch without odometry, so that its bytes stay the same as in older databases.
const PLAIN: u8 = 1;
/// Version of an epoch with odometry.
const WITH_ODOMETRY: u8 = 2;
const LOSS_OF_LOCK: u8 = 1;
const HALF_CYCLE: u8 = 2;

/// Encodes an epoch.
pub(in crate::store) fn encode_epoch(epoch: &Epoch) -> Vec<u8> {
    let version = if epoch.odometry.is_some() { WITH_ODOMETRY } else { PLAIN };
    let mut out = Encoder::new(version, 16 + 26 * epoch.observations.len());
    out.time(epoch.time);
    out.u8(u8::from(epoch.power_failure));
    out.count(epoch.observations.len());
    for observation in &epoch.observations {
        encode_observation(&mut out, observation);
    }
    if let Some(odometry) = &epoch.odometry {
        encode_odometry(&mut out, odometry);
    }
    out.finish()
}

fn encode_odometry(out: &mut Encoder, odometry: &Odometry) {
    out.u8(match odometry.frame {
        OdometryFrame::Ecef => 1,
        OdometryFrame::Enu => 2,
        OdometryFrame::Body { .. } => 3,
    });
    out.f64(odometry.interval_s);
    out.vector(&odometry.displacement_m);
    out.covariance(&odometry.covariance);
    if let OdometryFrame::Body { heading_rad, heading_sigma_rad } = odometry.frame {
        out.f64(heading_rad);
        out.f64(heading_sigma_rad);
    }
}

fn encode_observation(out: &mut Encoder, observation: &Observation) {
    out.satellite(observation.satellite);
    out.u8(observation.code.band_digit() + b'0');
    out.u8(observation.code.attribute());
    let lost = if observation.loss_of_lock { LOSS_OF_LOCK } else { 0 };
    out.u8(lost | if observation.half_cycle { HALF_CYCLE } else { 0 });
    let tags_at = out.position();
    out.u8(0);
    let values = [
        observation.pseudorange_m,
        observation.carrier_phase.map(|phase| phase.0),
        observation.doppler_hz,
        observation.cn0_db_hz,
    ];
    let mut tags = 0;
    for (index, value) in values.into_iter().enumerate() {
        tags |= out.measured(value) << (2 * index);
    }
    out.set(tags_at, tags);
}

/// Decodes an epoch.
pub(in crate::store) fn decode_epoch(bytes: &[u8]) -> Result<Epoch, CodecError> {
    let (mut input, layout) = Decoder::of_versions(bytes, WITH_ODOMETRY)?;
    let mut epoch = Epoch::new(input.time()?);
    epoch.power_failure = input.flag("power failure")?;
    let count = input.count("number of observations")?;
    epoch.observations =
        (0..count).map(|_| decode_observation(&mut input)).collect::<Result<_, _>>()?;
    if layout == WITH_ODOMETRY {
        epoch.odometry = Some(decode_odometry(&mut input)?);
    }
    input.finish()?;
    Ok(epoch)
}

fn decode_odometry(input: &mut Decoder<'_>) -> Result<Odometry, CodecError> {
    let kind = input.u8()?;
    let (interval_s, displacement_m) = (input.f64()?, input.vector()?);
    let covariance = input.covariance()?;
    let frame = match kind {
        1 => OdometryFrame::Ecef,
        2 => OdometryFrame::Enu,
        3 => OdometryFrame::Body { heading_rad: input.f64()?, heading_sigma_rad: input.f64()? },
        _ => return Err(input.invalid("odometry")),
    };
    Ok(Odometry { interval_s, frame, displacement_m, covariance })
}

fn decode_observation(input: &mut Decoder<'_>) -> Result<Observation, CodecError> {
    let satellite = input.satellite()?;
    let (band, attribute) = (input.u8()?, input.u8()?);
    let code = ObservationCode::new(band, attribute).ok_or_else(|| input.invalid("code"))?;
    let flags = input.u8()?;
    if LOSS_OF_LOCK | HALF_CYCLE < flags {
        return Err(input.invalid("flags"));
    }
    let tags = input.u8()?;
    Ok(Observation {
        satellite,
        code,
        loss_of_lock: flags & LOSS_OF_LOCK != 0,
        half_cycle: flags & HALF_CYCLE != 0,
        pseudorange_m: input.measured(tags)?,
        carrier_phase: input.measured(tags >> 2)?.map(Cycles),
        doppler_hz: input.measured(tags >> 4)?,
        cn0_db_hz: input.measured(tags >> 6)?,
    })
}
