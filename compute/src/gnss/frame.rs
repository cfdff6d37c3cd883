//! Reference frames, in which the coordinates of a base are stated.
//!
//! Frames differ by up to metres, and their points move by centimetres a year. So a frame is named
//! with the epoch of the coordinates, or it is unknown; it is never assumed.

use std::fmt;
use std::ops::RangeInclusive;

/// The known frames: realisations of the ITRS and of the ETRS89, WGS 84, and national ones. Where
/// it is not known which realisation of the ETRS89 a country uses, it is `ETRS89`.
const NAMES: [&str; 23] = [
    "ITRF2020",
    "ITRF2014",
    "ITRF2008",
    "ITRF2005",
    "ITRF2000",
    "IGS20",
    "IGb14",
    "IGS14",
    "IGb08",
    "IGS08",
    "ETRF2020",
    "ETRF2014",
    "ETRF2000",
    "ETRS89",
    "WGS84",
    "NAD83(2011)",
    "NAD83(CSRS)",
    "GDA2020",
    "GDA94",
    "NZGD2000",
    "JGD2011",
    "CGCS2000",
    "SIRGAS2000",
];

/// The frame of coordinates, and the epoch to which they belong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoordinateFrame {
    /// Name of the frame.
    pub name: &'static str,
    /// Epoch of the coordinates (decimal year); `None` if it is unknown.
    pub epoch_year: Option<f64>,
}

impl CoordinateFrame {
    /// The names of all known frames.
    pub const NAMES: &[&str] = &NAMES;
    /// Epochs that coordinates can have (decimal years).
    pub const EPOCH_YEARS: RangeInclusive<f64> = 1980.0..=2100.0;

    /// The frame of this name.
    pub fn named(name: &str, epoch_year: Option<f64>) -> Option<Self> {
        let name = NAMES.into_iter().find(|known| *known == name)?;
        Some(Self { name, epoch_year })
    }

    /// Reads a name, or a name and an epoch such as `ITRF2014@2010.0`; `None` if the name is not
    /// known or the epoch is not a year from 1980 to 2100.
    pub fn parse(text: &str) -> Option<Self> {
        let Some((name, epoch)) = text.split_once('@') else { return Self::named(text, None) };
        let epoch_year = epoch.parse().ok().filter(|year| Self::EPOCH_YEARS.contains(year))?;
        Self::named(name, Some(epoch_year))
    }
}

impl fmt::Display for CoordinateFrame {
    /// Writes the text that [`Self::parse`] reads.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)?;
        self.epoch_year.map_or(Ok(()), |year| write!(f, "@{year:?}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_is_read_as_it_is_written() {
        for text in ["ETRF2000", "ETRS89", "ITRF2014@2010.0", "NAD83(2011)@2010.25"] {
            assert_eq!(CoordinateFrame::parse(text).unwrap().to_string(), text);
        }
        for wrong in ["", "ITRF", "itrf2014", "ITRF2014@", "ITRF2014@1979", "ITRF2014@nan", "@2010"]
        {
            assert_eq!(CoordinateFrame::parse(wrong), None, "{wrong}");
        }
    }
}
