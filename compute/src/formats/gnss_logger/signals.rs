//! Constellations, satellites and signals as Android numbers them.
//!
//! Sources: Android API reference, `GnssStatus.getSvid` and `CONSTELLATION_…`; Android hardware
//! interface, `GnssSignalType.aidl`: code types are the attributes of RINEX 4.00, tables 9 to 16.

use super::Cause;
use crate::gnss::{Constellation, ObservationCode, SatelliteId, Signal};

/// A stated frequency is a signal's if it is this near (Hz). A 32-bit float is wrong by 64 Hz;
/// GLONASS channels are 437.5 kHz apart.
const NEAR_HZ: f64 = 1e5;
/// PRN of QZSS J01 less one. PRN 183 to 192 and from 203 on broadcast other signals.
const QZSS_FIRST: i64 = 192;
/// `UNKNOWN`, the code type of a signal whose code is not stated.
const UNKNOWN_CODE: &[u8] = b"UNKNOWN";

/// The number of a constellation in the log.
pub(super) const fn constellation_type(constellation: Constellation) -> i64 {
    match constellation {
        Constellation::Gps => 1,
        Constellation::Glonass => 3,
        Constellation::Qzss => 4,
        Constellation::BeiDou => 5,
        Constellation::Galileo => 6,
    }
}

/// The constellation with a number; 0 is unknown, 2 SBAS, 7 NavIC.
pub(super) fn constellation(number: i64) -> Result<Constellation, Cause> {
    let known = Constellation::ALL.into_iter().find(|c| constellation_type(*c) == number);
    known.ok_or(Cause::OtherConstellation(number))
}

/// The number of a satellite in the log.
pub(super) fn svid(satellite: SatelliteId) -> i64 {
    let number = i64::from(satellite.number);
    match satellite.constellation {
        Constellation::Qzss => QZSS_FIRST + number,
        _ => number,
    }
}

/// The satellite with a number.
pub(super) fn satellite(constellation: Constellation, svid: i64) -> Result<SatelliteId, Cause> {
    use Constellation as C;
    if constellation == C::Glonass && (93..=106).contains(&svid) {
        return Err(Cause::SlotUnknown);
    }
    let (first, last) = match constellation {
        C::Gps => (1, 32),
        C::Glonass => (1, 25),
        C::Galileo => (1, 36),
        C::BeiDou => (1, 63),
        C::Qzss => (QZSS_FIRST + 1, QZSS_FIRST + 10),
    };
    let number = (first..=last).contains(&svid).then_some(svid - first + 1);
    let known = number.and_then(|number| SatelliteId::new(constellation, number as u8));
    known.ok_or(Cause::NoSuchSatellite { constellation: constellation.name(), svid })
}

/// The bands of a constellation, the one that Android means without a frequency first, each with
/// the attribute that it has without code type: the signal that phones track there.
const fn bands(constellation: Constellation) -> &'static [&'static [u8; 2]] {
    match constellation {
        Constellation::Gps => &[b"1C", b"2L", b"5Q"],
        Constellation::Glonass => &[b"1C", b"2C", b"3Q"],
        Constellation::Galileo => &[b"1C", b"5Q", b"7Q", b"8Q", b"6C"],
        Constellation::BeiDou => &[b"2I", b"1P", b"5P", b"7I", b"6I", b"8P"],
        Constellation::Qzss => &[b"1C", b"2L", b"5Q", b"6L"],
    }
}

/// A tracked signal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Tracked {
    pub(super) code: ObservationCode,
    /// Nominal carrier frequency (Hz); `None` for GLONASS without a stated one.
    pub(super) frequency_hz: Option<f64>,
}

/// The signal of a constellation by its stated frequency (Hz) and code type.
pub(super) fn tracked(
    constellation: Constellation,
    stated_hz: Option<f64>,
    code_type: Option<&[u8]>,
) -> Result<Tracked, Cause> {
    let attribute = match code_type {
        None => None,
        Some(text) if text == UNKNOWN_CODE => None,
        Some([letter]) if letter.is_ascii_uppercase() => Some(*letter),
        Some(_) => return Err(Cause::UnknownCode),
    };
    let candidates = bands(constellation).iter().map(|[band, usual]| {
        let code = ObservationCode::new(*band, attribute.unwrap_or(*usual));
        let code = code.expect("a digit and an upper-case letter");
        Tracked { code, frequency_hz: nominal_hz(Signal { constellation, code }, stated_hz) }
    });
    let Some(stated_hz) = stated_hz else {
        return candidates.take(1).next().ok_or(Cause::UnknownFrequency);
    };
    let distance = |tracked: &Tracked| tracked.frequency_hz.map(|hz| (hz - stated_hz).abs());
    let mut near = candidates.filter(|tracked| distance(tracked).is_some_and(|d| d < NEAR_HZ));
    near.next().ok_or(Cause::UnknownFrequency)
}

/// The nominal frequency (Hz) of a signal; of GLONASS, that of the channel nearest to the stated
/// frequency.
fn nominal_hz(signal: Signal, stated_hz: Option<f64>) -> Option<f64> {
    if let Some(hz) = signal.frequency_hz(None) {
        return Some(hz);
    }
    let [middle, next] = [0, 1].map(|channel| signal.frequency_hz(Some(channel)));
    let channel = ((stated_hz? - middle?) / (next? - middle?)).round();
    (-7.0..=6.0).contains(&channel).then(|| signal.frequency_hz(Some(channel as i8))).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn satellites_by_svid() {
        use Constellation as C;
        let named = |c, svid| satellite(c, svid).map(|satellite| satellite.to_string());
        assert_eq!(named(C::Gps, 32).unwrap(), "G32");
        assert_eq!(named(C::Qzss, 193).unwrap(), "J01");
        assert_eq!(named(C::BeiDou, 63).unwrap(), "C63");
        assert_eq!(named(C::Glonass, 24).unwrap(), "R24");
        assert_eq!(named(C::Glonass, 93), Err(Cause::SlotUnknown));
        assert_eq!(named(C::Glonass, 106), Err(Cause::SlotUnknown));
        for (c, svid) in
            [(C::Gps, 33), (C::Gps, 0), (C::Qzss, 183), (C::Galileo, -1), (C::Glonass, 92)]
        {
            assert!(matches!(named(c, svid), Err(Cause::NoSuchSatellite { .. })), "{c:?} {svid}");
        }
        for c in Constellation::ALL {
            let first = satellite(c, if c == C::Qzss { 193 } else { 1 }).unwrap();
            assert_eq!(satellite(c, svid(first)), Ok(first));
            assert_eq!(constellation(constellation_type(c)), Ok(c));
        }
        assert_eq!(constellation(2), Err(Cause::OtherConstellation(2)));
    }

    /// Frequencies as a 32-bit float holds them, and the codes of RINEX 4.00 tables 9 to 16.
    #[test]
    fn signals_by_frequency_and_code_type() {
        use Constellation as C;
        let code = |c, hz: f32, code_type: Option<&str>| {
            let found = tracked(c, Some(hz.into()), code_type.map(str::as_bytes));
            found.map(|tracked| (tracked.code.to_string(), tracked.frequency_hz.unwrap()))
        };
        let is = |code: &str, hz: f64| Ok((code.to_owned(), hz));
        assert_eq!(code(C::Gps, 1.575_42e9, None), is("1C", 1_575.42e6));
        assert_eq!(code(C::Gps, 1.176_45e9, Some("X")), is("5X", 1_176.45e6));
        assert_eq!(code(C::Galileo, 1.575_42e9, Some("B")), is("1B", 1_575.42e6));
        assert_eq!(code(C::BeiDou, 1.561_098e9, Some("I")), is("2I", 1_561.098e6));
        assert_eq!(code(C::BeiDou, 1.575_42e9, Some("UNKNOWN")), is("1P", 1_575.42e6));
        assert_eq!(code(C::Glonass, 1.598_062_5e9, Some("C")), is("1C", 1_598.062_5e6));
        assert_eq!(code(C::Glonass, 1.248_625e9, None), is("2C", 1_248.625e6));
        assert_eq!(code(C::Glonass, 1.606e9, None), Err(Cause::UnknownFrequency));
        assert_eq!(code(C::Gps, 1.6e9, None), Err(Cause::UnknownFrequency));
        assert_eq!(code(C::Gps, 1.575_42e9, Some("c")), Err(Cause::UnknownCode));
        let primary = |c| tracked(c, None, None).unwrap();
        assert_eq!(primary(C::BeiDou).code.to_string(), "2I");
        assert_eq!(primary(C::Glonass).frequency_hz, None);
    }
}
