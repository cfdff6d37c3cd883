//! Epochs as bytes, whole or relative to the epoch before.
//!
//! Layout 3 is a whole epoch: time, flags, observations and odometry (frame, interval,
//! displacement, covariance, and the heading of a body frame). Layout 4 is relative to an earlier
//! epoch of the session. It begins with two distances in epoch numbers, to that epoch and to the
//! whole epoch at the start of the chain, and the span of time; then it continues like layout 3.
//!
//! Layouts 1 (without odometry) and 2 (with it) are still read. They contain observations one by
//! one, each with satellite, code, flags, tags and values.

use crate::gnss::{Cycles, Epoch, GpsTime, Observation, ObservationCode, Odometry, OdometryFrame};

use super::CodecError;
use super::bytes::{Decoder, Encoder};
use super::observations::{decode_observations, encode_observations};

const FORMER_WITH_ODOMETRY: u8 = 2;
const WHOLE: u8 = 3;
const RELATIVE: u8 = 4;

const POWER_FAILURE: u8 = 1;
const ODOMETRY: u8 = 2;

/// Flags of an observation in layouts 1 and 2.
const LOSS_OF_LOCK: u8 = 1;
const HALF_CYCLE: u8 = 2;

/// Distances, in epoch numbers, to the earlier epochs on which an encoded one depends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::store) struct Distances {
    /// To the epoch that it is relative to.
    pub(in crate::store) reference: u64,
    /// To the whole epoch with which the chain begins.
    pub(in crate::store) first: u64,
}

/// Capacity for an encoded epoch (bytes). It suffices even if no value is a whole thousandth.
fn capacity(epoch: &Epoch) -> usize {
    64 + 36 * epoch.observations.len()
}

/// Encodes a whole epoch.
pub(in crate::store) fn encode_epoch(epoch: &Epoch) -> Vec<u8> {
    let mut out = Encoder::new(WHOLE, capacity(epoch));
    out.time(epoch.time);
    encode_content(&mut out, epoch, None);
    out.finish()
}

/// Encodes an epoch relative to `reference`.
pub(in crate::store) fn encode_relative_epoch(
    epoch: &Epoch,
    reference: &Epoch,
    distances: Distances,
) -> Vec<u8> {
    let mut out = Encoder::new(RELATIVE, capacity(epoch));
    out.unsigned(distances.reference);
    out.unsigned(distances.first);
    let span_ns = epoch.time.as_ns().wrapping_sub(reference.time.as_ns());
    out.span(span_ns);
    encode_content(&mut out, epoch, Some((&reference.observations, span_ns)));
    out.finish()
}

fn encode_content(out: &mut Encoder, epoch: &Epoch, earlier: Option<(&[Observation], i64)>) {
    let failed = if epoch.power_failure { POWER_FAILURE } else { 0 };
    out.u8(failed | if epoch.odometry.is_some() { ODOMETRY } else { 0 });
    encode_observations(out, &epoch.observations, earlier);
    if let Some(odometry) = &epoch.odometry {
        encode_odometry(out, odometry);
    }
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

/// Distances to the epochs that an encoded epoch is relative to; `None` if it is whole.
pub(in crate::store) fn distances(bytes: &[u8]) -> Result<Option<Distances>, CodecError> {
    let (mut input, layout) = Decoder::of_versions(bytes, RELATIVE)?;
    if layout != RELATIVE {
        return Ok(None);
    }
    Ok(Some(Distances { reference: input.unsigned()?, first: input.unsigned()? }))
}

/// Decodes a whole epoch.
pub(in crate::store) fn decode_epoch(bytes: &[u8]) -> Result<Epoch, CodecError> {
    match Decoder::of_versions(bytes, WHOLE)? {
        (mut input, WHOLE) => {
            let time = input.time()?;
            decode_content(input, time, None)
        }
        (input, layout) => decode_former_epoch(input, layout),
    }
}

/// Decodes an epoch that is relative to `reference`.
pub(in crate::store) fn decode_relative_epoch(
    bytes: &[u8],
    reference: &Epoch,
) -> Result<Epoch, CodecError> {
    let mut input = Decoder::new(bytes, RELATIVE)?;
    input.unsigned()?; // The distances, which the caller has read.
    input.unsigned()?;
    let span_ns = input.span()?;
    let time = GpsTime::from_ns(reference.time.as_ns().wrapping_add(span_ns));
    decode_content(input, time, Some((&reference.observations, span_ns)))
}

fn decode_content(
    mut input: Decoder<'_>,
    time: GpsTime,
    earlier: Option<(&[Observation], i64)>,
) -> Result<Epoch, CodecError> {
    let flags = input.u8()?;
    if POWER_FAILURE | ODOMETRY < flags {
        return Err(input.invalid("flags"));
    }
    let observations = decode_observations(&mut input, earlier)?;
    let odometry = match flags & ODOMETRY != 0 {
        true => Some(decode_odometry(&mut input)?),
        false => None,
    };
    input.finish()?;
    let power_failure = flags & POWER_FAILURE != 0;
    Ok(Epoch { time, power_failure, observations, odometry })
}

fn decode_former_epoch(mut input: Decoder<'_>, layout: u8) -> Result<Epoch, CodecError> {
    let mut epoch = Epoch::new(input.time()?);
    epoch.power_failure = input.flag("power failure")?;
    let count = input.count("number of observations")?;
    epoch.observations = (0..count).map(|_| decode_former(&mut input)).collect::<Result<_, _>>()?;
    if layout == FORMER_WITH_ODOMETRY {
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

/// An observation of layout 1 or 2.
fn decode_former(input: &mut Decoder<'_>) -> Result<Observation, CodecError> {
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

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use crate::simulation::{Scenario, Simulator};
    use crate::store::codec::bytes::thousandths;
    use crate::store::codec::sample;

    use super::*;

    /// An epoch in layout 1 or 2, as Graphfix wrote it before layout 3.
    fn encode_former(epoch: &Epoch) -> Vec<u8> {
        let layout = if epoch.odometry.is_some() { FORMER_WITH_ODOMETRY } else { 1 };
        let mut out = Encoder::new(layout, 0);
        out.time(epoch.time);
        out.u8(u8::from(epoch.power_failure));
        out.count(epoch.observations.len());
        for observation in &epoch.observations {
            let values = [
                observation.pseudorange_m,
                observation.carrier_phase.map(|phase| phase.0),
                observation.doppler_hz,
                observation.cn0_db_hz,
            ];
            let tag = |value: &Option<f64>| match (value, value.and_then(thousandths)) {
                (None, _) => 0,
                (Some(_), Some(_)) => 1,
                (Some(_), None) => 2,
            };
            out.satellite(observation.satellite);
            out.u8(observation.code.band_digit() + b'0');
            out.u8(observation.code.attribute());
            out.u8(u8::from(observation.loss_of_lock) + 2 * u8::from(observation.half_cycle));
            out.u8((0..4).map(|index| tag(&values[index]) << (2 * index)).sum());
            for value in values {
                match (value, value.and_then(thousandths)) {
                    (None, _) => {}
                    (Some(_), Some(thousandths)) => out.signed(thousandths),
                    (Some(value), None) => out.f64(value),
                }
            }
        }
        if let Some(odometry) = &epoch.odometry {
            encode_odometry(&mut out, odometry);
        }
        out.finish()
    }

    /// Epochs of a receiver that logs as RINEX does, in thousandths, and C/N0 in quarters of a dB.
    fn logged(scenario: &str, interval_s: f64) -> Vec<Epoch> {
        let scenario = Scenario { interval_s, ..Scenario::by_name(scenario).unwrap() };
        let duration_s = 32.0 * interval_s;
        let simulator = Simulator::new(Scenario { duration_s, ..scenario }, 3);
        let rounded = |value: f64| (value * 1e3).round() / 1e3;
        let logged = |mut epoch: Epoch| {
            for observation in &mut epoch.observations {
                observation.pseudorange_m = observation.pseudorange_m.map(rounded);
                observation.carrier_phase =
                    observation.carrier_phase.map(|phase| Cycles(rounded(phase.0)));
                observation.doppler_hz = observation.doppler_hz.map(rounded);
                observation.cn0_db_hz = observation.cn0_db_hz.map(|cn0| (4.0 * cn0).round() / 4.0);
            }
            epoch
        };
        simulator.map(|epoch| logged(epoch.rover)).collect()
    }

    const NEXT: Distances = Distances { reference: 1, first: 1 };

    fn assert_relative_round_trip(epoch: &Epoch, reference: &Epoch) -> Vec<u8> {
        let bytes = encode_relative_epoch(epoch, reference, NEXT);
        let read = decode_relative_epoch(&bytes, reference).unwrap();
        assert_eq!(format!("{read:?}"), format!("{epoch:?}"));
        assert_eq!(encode_relative_epoch(&read, reference, NEXT), bytes);
        assert_eq!(distances(&bytes), Ok(Some(NEXT)));
        for length in 0..bytes.len() {
            assert!(decode_relative_epoch(&bytes[..length], reference).is_err(), "{length}");
        }
        bytes
    }

    /// Per observation, layout 1 took 25 bytes.
    #[test]
    fn logged_epochs_take_few_bytes() {
        for (scenario, interval_s, whole_max, relative_max) in [
            ("open-sky", 1.0, 14.0, 6.0),
            ("open-sky", 60.0, 14.0, 8.0),
            ("urban-canyon", 1.0, 15.0, 9.0),
        ] {
            let epochs = logged(scenario, interval_s);
            let observations: usize =
                epochs[1..].iter().map(|epoch| epoch.observations.len()).sum();
            let whole: usize = epochs[1..].iter().map(|epoch| encode_epoch(epoch).len()).sum();
            let pairs = epochs.windows(2);
            let relative: usize =
                pairs.map(|pair| assert_relative_round_trip(&pair[1], &pair[0]).len()).sum();
            let per = |bytes: usize| bytes as f64 / observations as f64;
            let (whole, relative) = (per(whole), per(relative));
            println!("{scenario}, {interval_s} s: {whole:.2} and {relative:.2} bytes");
            assert!(whole < whole_max && relative < relative_max, "{whole} and {relative} bytes");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn former_layouts_are_read(epoch in sample::epoch()) {
            let bytes = encode_former(&epoch);
            let read = decode_epoch(&bytes).unwrap();
            prop_assert_eq!(format!("{read:?}"), format!("{epoch:?}"));
            prop_assert_eq!(encode_former(&read), bytes);
        }

        #[test]
        fn relative_epochs_round_trip(reference in sample::epoch(), epoch in sample::epoch()) {
            assert_relative_round_trip(&epoch, &reference);
        }

        /// The same signals with other values, as most epochs of a receiver are.
        #[test]
        fn epochs_of_the_same_signals_round_trip(
            reference in sample::epoch(),
            values in prop::collection::vec(sample::observation(), 50),
        ) {
            let mut epoch = reference.clone();
            for (observation, other) in epoch.observations.iter_mut().zip(values) {
                let (satellite, code) = (observation.satellite, observation.code);
                *observation = Observation { satellite, code, ..other };
            }
            assert_relative_round_trip(&epoch, &reference);
        }

        /// Changed bytes, or another reference, give an error or other values, but no panic.
        #[test]
        fn corrupted_relative_epochs_never_panic(
            reference in sample::epoch(),
            other in sample::epoch(),
            changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
        ) {
            let epochs = logged_pair();
            let mut bytes = encode_relative_epoch(&epochs[1], &epochs[0], NEXT);
            for reference in [&reference, &epochs[0]] {
                decode_relative_epoch(&bytes, reference).ok();
            }
            for (index, byte) in &changes {
                let index = index.index(bytes.len());
                bytes[index] = *byte;
            }
            for reference in [&reference, &other, &epochs[0]] {
                if let Ok(read) = decode_relative_epoch(&bytes, reference) {
                    let again = encode_relative_epoch(&read, reference, NEXT);
                    prop_assert!(decode_relative_epoch(&again, reference).is_ok());
                }
            }
        }
    }

    fn logged_pair() -> &'static [Epoch] {
        static PAIR: std::sync::LazyLock<Vec<Epoch>> =
            std::sync::LazyLock::new(|| logged("open-sky", 1.0));
        &PAIR[..2]
    }
}
