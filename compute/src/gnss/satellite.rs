//! Constellations and satellites.

use std::fmt::{self, Write};
use std::str::FromStr;

/// A satellite navigation system that Graphfix supports.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Constellation {
    /// United States; RINEX letter G.
    Gps,
    /// Russia; RINEX letter R.
    Glonass,
    /// European Union; RINEX letter E.
    Galileo,
    /// China; RINEX letter C.
    BeiDou,
    /// Japan; RINEX letter J.
    Qzss,
}

impl Constellation {
    /// Every constellation, in the order of RINEX tables.
    pub const ALL: [Self; 5] = [Self::Gps, Self::Glonass, Self::Galileo, Self::BeiDou, Self::Qzss];
    /// Number of constellations, for tables indexed by constellation.
    pub const COUNT: usize = Self::ALL.len();

    /// The RINEX letter of the constellation.
    pub const fn letter(self) -> char {
        match self {
            Self::Gps => 'G',
            Self::Glonass => 'R',
            Self::Galileo => 'E',
            Self::BeiDou => 'C',
            Self::Qzss => 'J',
        }
    }

    /// The constellation with this RINEX letter, or `None` if it is not supported.
    pub(crate) const fn from_letter(letter: char) -> Option<Self> {
        match letter {
            'G' => Some(Self::Gps),
            'R' => Some(Self::Glonass),
            'E' => Some(Self::Galileo),
            'C' => Some(Self::BeiDou),
            'J' => Some(Self::Qzss),
            _ => None,
        }
    }

    /// Index in a table with one entry for each constellation.
    pub const fn index(self) -> usize {
        self as usize
    }

    /// The system's name in messages and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Gps => "GPS",
            Self::Glonass => "GLONASS",
            Self::Galileo => "Galileo",
            Self::BeiDou => "BeiDou",
            Self::Qzss => "QZSS",
        }
    }
}

/// One satellite: constellation and number, as in RINEX 3 (`G05`, `J02`).
///
/// For QZSS the number is the PRN less 192, for GLONASS the slot.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SatelliteId {
    /// The satellite's constellation.
    pub constellation: Constellation,
    /// PRN or slot, 1 … 99.
    pub number: u8,
}

impl SatelliteId {
    /// The satellite, or `None` if the number is not in 1 … 99.
    pub fn new(constellation: Constellation, number: u8) -> Option<Self> {
        (1..=99).contains(&number).then_some(Self { constellation, number })
    }

    /// Whether this is a BeiDou satellite in geostationary orbit.
    ///
    /// BDS-SIS-ICD-B1I-3.0, 4.3.1 and table 4-1: PRN 1–5 and 59–63 broadcast D2 messages.
    pub const fn is_beidou_geo(self) -> bool {
        matches!(self.constellation, Constellation::BeiDou)
            && matches!(self.number, 1..=5 | 59..=63)
    }
}

impl fmt::Display for SatelliteId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // An answer has some sixty names, and the formatter's digits take longer.
        let digit = |digit: u8| char::from(b'0' + digit);
        f.write_char(self.constellation.letter())?;
        f.write_char(digit(self.number / 10))?;
        f.write_char(digit(self.number % 10))
    }
}

impl fmt::Debug for SatelliteId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// A text that is not a satellite number.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not a satellite such as G05")]
pub struct SatelliteIdError(pub String);

impl FromStr for SatelliteId {
    type Err = SatelliteIdError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let parse = || {
            let mut letters = text.chars();
            let constellation = Constellation::from_letter(letters.next()?)?;
            Self::new(constellation, letters.as_str().trim().parse().ok()?)
        };
        parse().ok_or_else(|| SatelliteIdError(text.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip() {
        for name in ["G05", "R24", "E36", "C63", "J01"] {
            assert_eq!(name.parse::<SatelliteId>().unwrap().to_string(), name);
        }
        for wrong in ["", "G", "G00", "X01", "G100", "Gé"] {
            assert!(wrong.parse::<SatelliteId>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn geostationary_beidou() {
        let geo = |name: &str| name.parse::<SatelliteId>().unwrap().is_beidou_geo();
        assert!(geo("C05") && geo("C59") && !geo("C06") && !geo("G05"));
    }
}
