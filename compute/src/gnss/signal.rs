//! Signals: observation codes, bands and carrier frequencies.
//!
//! Codes are RINEX 3's (RINEX 3.05, tables 4–10): a band digit and a tracking attribute, `1C`.

use super::constants::GPS_L1_HZ;
use std::fmt;

use super::{Constellation, SatelliteId};

/// RINEX 3 observation code without its leading letter: band digit and attribute, such as `1C`.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ObservationCode([u8; 2]);

impl ObservationCode {
    /// The code of an ASCII band digit 1 … 9 and an ASCII upper-case attribute.
    pub const fn new(band: u8, attribute: u8) -> Option<Self> {
        if matches!(band, b'1'..=b'9') && attribute.is_ascii_uppercase() {
            Some(Self([band, attribute]))
        } else {
            None
        }
    }

    /// Parses a text such as `1C`.
    pub fn parse(text: &str) -> Option<Self> {
        match text.as_bytes() {
            [band, attribute] => Self::new(*band, *attribute),
            _ => None,
        }
    }

    /// The band digit as a number, 1 … 9.
    pub const fn band_digit(self) -> u8 {
        self.0[0] - b'0'
    }

    /// The tracking attribute, an ASCII letter.
    pub const fn attribute(self) -> u8 {
        self.0[1]
    }

    /// The code as text.
    pub(crate) fn as_str(&self) -> &str {
        std::str::from_utf8(&self.0).expect("both bytes are ASCII by construction")
    }
}

impl fmt::Display for ObservationCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl fmt::Debug for ObservationCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// A frequency band across constellations, as options name it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Band {
    /// GPS and QZSS L1, Galileo E1, BeiDou B1, GLONASS G1.
    L1,
    /// GPS and QZSS L2, Galileo E5b, BeiDou B2/B2b, GLONASS G2.
    L2,
    /// GPS and QZSS L5, Galileo E5a and E5, BeiDou B2a, GLONASS G3.
    L5,
    /// Galileo E6, BeiDou B3, QZSS LEX.
    L6,
}

impl Band {
    /// Every band, in order of preference.
    pub(crate) const ALL: [Self; 4] = [Self::L1, Self::L2, Self::L5, Self::L6];

    /// The name in options.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::L1 => "L1",
            Self::L2 => "L2",
            Self::L5 => "L5",
            Self::L6 => "L6",
        }
    }
}

/// A signal: the constellation that broadcasts it, and its observation code.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Signal {
    /// The constellation that broadcasts the signal.
    pub constellation: Constellation,
    /// Band and tracking attribute.
    pub code: ObservationCode,
}

impl Signal {
    /// The signal of `satellite` with the observation code `code`.
    pub const fn of(satellite: SatelliteId, code: ObservationCode) -> Self {
        Self { constellation: satellite.constellation, code }
    }

    /// Carrier frequency (Hz), or `None` where the constellation has no such band.
    ///
    /// `glonass_channel` is the FDMA channel k (−7 … 13) of GLONASS G1 and G2, unused elsewhere;
    /// an FDMA signal without its channel has no known frequency.
    pub fn frequency_hz(self, glonass_channel: Option<i8>) -> Option<f64> {
        use Constellation as C;
        let mhz = match (self.constellation, self.code.band_digit()) {
            (C::Gps | C::Qzss | C::Galileo | C::BeiDou, 1) => return Some(GPS_L1_HZ),
            (C::Gps | C::Qzss, 2) => 1227.60,
            (C::Gps | C::Qzss | C::Galileo | C::BeiDou, 5) => 1176.45,
            (C::Galileo | C::Qzss, 6) => 1278.75,
            (C::Galileo | C::BeiDou, 7) => 1207.14,
            (C::Galileo | C::BeiDou, 8) => 1191.795,
            (C::BeiDou, 2) => 1561.098,
            (C::BeiDou, 6) => 1268.52,
            (C::Glonass, 1) => 1602.0 + f64::from(glonass_channel?) * 0.5625,
            (C::Glonass, 2) => 1246.0 + f64::from(glonass_channel?) * 0.4375,
            (C::Glonass, 3) => 1202.025,
            (C::Glonass, 4) => 1600.995,
            (C::Glonass, 6) => 1248.06,
            _ => return None,
        };
        Some(mhz * 1e6)
    }

    /// The band of the signal, or `None` where the constellation has no such band.
    pub fn band(self) -> Option<Band> {
        use Constellation as C;
        match (self.constellation, self.code.band_digit()) {
            (C::Glonass, 1 | 4) => Some(Band::L1),
            (C::Glonass, 2 | 6) => Some(Band::L2),
            (C::Glonass, 3) => Some(Band::L5),
            (C::BeiDou, 1 | 2) => Some(Band::L1),
            (C::Gps | C::Qzss | C::Galileo, 1) => Some(Band::L1),
            (C::Gps | C::Qzss, 2) => Some(Band::L2),
            (C::Galileo | C::BeiDou, 7) => Some(Band::L2),
            (C::Gps | C::Qzss | C::Galileo | C::BeiDou, 5) => Some(Band::L5),
            (C::Galileo | C::BeiDou, 8) => Some(Band::L5),
            (C::Galileo | C::BeiDou | C::Qzss, 6) => Some(Band::L6),
            _ => None,
        }
    }
}

impl fmt::Display for Signal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.constellation.letter(), self.code)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn signal(constellation: Constellation, code: &str) -> Signal {
        Signal { constellation, code: ObservationCode::parse(code).unwrap() }
    }

    #[test]
    fn frequencies_of_rinex_3_05_tables_4_to_10() {
        use Constellation as C;
        let hz = |c, code, channel| signal(c, code).frequency_hz(channel);
        assert_eq!(hz(C::Gps, "1C", None), Some(1_575_420_000.0));
        assert_eq!(hz(C::BeiDou, "2I", None), Some(1_561_098_000.0));
        assert_eq!(hz(C::Glonass, "1C", Some(-7)), Some(1_598_062_500.0));
        assert_eq!(hz(C::Glonass, "1C", None), None);
        assert_eq!(hz(C::Gps, "7Q", None), None);
    }

    #[test]
    fn bands_as_users_name_them() {
        use Constellation as C;
        assert_eq!(signal(C::BeiDou, "2I").band(), Some(Band::L1));
        assert_eq!(signal(C::Galileo, "7Q").band(), Some(Band::L2));
        assert_eq!(signal(C::Glonass, "3Q").band(), Some(Band::L5));
        assert_eq!(ObservationCode::parse("C1C"), None);
    }
}
