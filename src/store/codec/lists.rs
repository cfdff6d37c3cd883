//! Lists of satellites and of ephemerides, in bits.
//!
//! A satellite that follows another of its constellation is written as the step to its number. The
//! ephemerides of a solution usually are those of the satellites that it used, and most have the
//! reference time of the one before.

use crate::gnss::constants::NS_PER_SECOND;
use crate::gnss::{Constellation, EphemerisIssue, GpsTime, SatelliteId};

use super::CodecError;
use super::bits::{BitReader, BitWriter};
use super::bytes::{Decoder, Encoder, constellation_number, unzigzag, zigzag};

/// Steps from 1 to 16 are written as 0 to 15.
const STEP_BITS: u32 = 4;
const CONSTELLATION_BITS: u32 = 3;
const NUMBER_BITS: u32 = 7;

pub(super) fn encode_satellites(out: &mut Encoder, satellites: &[SatelliteId]) {
    out.count(satellites.len());
    let mut bits = BitWriter::new(out);
    let mut previous = None;
    for satellite in satellites {
        encode_satellite(&mut bits, *satellite, previous);
        previous = Some(*satellite);
    }
    bits.finish();
}

pub(super) fn decode_satellites(input: &mut Decoder<'_>) -> Result<Vec<SatelliteId>, CodecError> {
    let count = input.count_of_bits("number of satellites")?;
    let mut bits = BitReader::new(input);
    let mut satellites: Vec<SatelliteId> = Vec::new();
    for _ in 0..count {
        satellites.push(decode_satellite(&mut bits, satellites.last().copied())?);
    }
    bits.finish()?;
    Ok(satellites)
}

fn encode_satellite(
    bits: &mut BitWriter<'_>,
    satellite: SatelliteId,
    previous: Option<SatelliteId>,
) {
    let step = previous
        .filter(|previous| previous.constellation == satellite.constellation)
        .and_then(|previous| satellite.number.checked_sub(previous.number)?.checked_sub(1))
        .filter(|step| *step < 1 << STEP_BITS);
    bits.bit(step.is_some());
    match step {
        Some(step) => bits.bits(step.into(), STEP_BITS),
        None => {
            bits.bits(constellation_number(satellite.constellation).into(), CONSTELLATION_BITS);
            bits.bits(satellite.number.into(), NUMBER_BITS);
        }
    }
}

fn decode_satellite(
    bits: &mut BitReader<'_, '_>,
    previous: Option<SatelliteId>,
) -> Result<SatelliteId, CodecError> {
    let satellite = if bits.bit()? {
        let step = bits.bits(STEP_BITS)? as u8 + 1;
        previous.and_then(|previous| {
            SatelliteId::new(previous.constellation, previous.number.checked_add(step)?)
        })
    } else {
        let number = bits.bits(CONSTELLATION_BITS)? as u8;
        let mut all = Constellation::ALL.into_iter();
        let constellation = all.find(|c| constellation_number(*c) == number);
        let number = bits.bits(NUMBER_BITS)? as u8;
        constellation.and_then(|constellation| SatelliteId::new(constellation, number))
    };
    satellite.ok_or_else(|| bits.invalid("satellite"))
}

/// Ephemerides of a solution at `time` that used `satellites`.
pub(super) fn encode_issues(
    out: &mut Encoder,
    issues: &[EphemerisIssue],
    satellites: &[SatelliteId],
    time: GpsTime,
) {
    let is_same = issues.iter().map(|issue| issue.satellite).eq(satellites.iter().copied());
    out.u8(u8::from(is_same));
    if !is_same {
        let own: Vec<SatelliteId> = issues.iter().map(|issue| issue.satellite).collect();
        encode_satellites(out, &own);
    }
    let mut bits = BitWriter::new(out);
    let (mut toe, mut number) = (time, 0);
    for issue in issues {
        bits.bit(issue.toe == toe);
        if issue.toe != toe {
            encode_step(&mut bits, issue.toe.as_ns().wrapping_sub(toe.as_ns()));
        }
        bits.bit(issue.issue == number);
        if issue.issue != number {
            bits.sized(issue.issue.into());
        }
        (toe, number) = (issue.toe, issue.issue);
    }
    bits.finish();
}

pub(super) fn decode_issues(
    input: &mut Decoder<'_>,
    satellites: &[SatelliteId],
    time: GpsTime,
) -> Result<Vec<EphemerisIssue>, CodecError> {
    let own = match input.flag("satellites of ephemerides")? {
        true => satellites.to_vec(),
        false => decode_satellites(input)?,
    };
    let mut bits = BitReader::new(input);
    let (mut toe, mut number) = (time, 0);
    let mut issues = Vec::with_capacity(own.len());
    for satellite in own {
        if !bits.bit()? {
            toe = GpsTime::from_ns(toe.as_ns().wrapping_add(decode_step(&mut bits)?));
        }
        if !bits.bit()? {
            number = u32::try_from(bits.sized()?).map_err(|_| bits.invalid("issue"))?;
        }
        issues.push(EphemerisIssue { satellite, toe, issue: number });
    }
    bits.finish()?;
    Ok(issues)
}

/// A step of time: few bits for whole seconds, more for any other.
fn encode_step(bits: &mut BitWriter<'_>, ns: i64) {
    let is_whole = ns % NS_PER_SECOND == 0;
    bits.bit(is_whole);
    if is_whole {
        bits.sized(zigzag(ns / NS_PER_SECOND));
    } else {
        bits.bits(ns as u64, u64::BITS);
    }
}

fn decode_step(bits: &mut BitReader<'_, '_>) -> Result<i64, CodecError> {
    match bits.bit()? {
        true => Ok(unzigzag(bits.sized()?).wrapping_mul(NS_PER_SECOND)),
        false => Ok(bits.bits(u64::BITS)? as i64),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 28 satellites of four constellations: 5 bits a satellite, 15 an ephemeris.
    #[test]
    fn satellites_and_their_ephemerides_take_few_bytes() {
        let satellites: Vec<SatelliteId> = ["G", "R", "E", "C"]
            .into_iter()
            .flat_map(|letter| (1..=7).map(move |number| format!("{letter}{:02}", 4 * number)))
            .map(|name| name.parse().unwrap())
            .collect();
        let time = GpsTime::from_week_seconds(2300, 1_234.5);
        let toe = GpsTime::from_week_seconds(2300, 0.0);
        let issue = |(number, satellite): (u32, &SatelliteId)| EphemerisIssue {
            satellite: *satellite,
            toe,
            issue: 60 + number,
        };
        let issues: Vec<_> = (0..).zip(&satellites).map(issue).collect();
        let mut out = Encoder::new(1, 0);
        encode_satellites(&mut out, &satellites);
        encode_issues(&mut out, &issues, &satellites, time);
        let bytes = out.finish();
        assert!(bytes.len() < 90, "{} bytes", bytes.len());
        let mut input = Decoder::new(&bytes, 1).unwrap();
        assert_eq!(decode_satellites(&mut input).unwrap(), satellites);
        assert_eq!(decode_issues(&mut input, &satellites, time).unwrap(), issues);
        input.finish().unwrap();
    }
}
