//! Reference frames, in which the coordinates of a base are stated.
//!
//! Frames differ by up to metres, and their points move by centimetres a year. So a frame is named
//! with the epoch of the coordinates, or it is unknown; it is never assumed.

/// The known frames: realisations of the ITRS and of the ETRS89, WGS 84, and national ones.
const NAMES: [&str; 22] = [
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

    /// The frame of this name.
    pub fn named(name: &str, epoch_year: Option<f64>) -> Option<Self> {
        let name = NAMES.into_iter().find(|known| *known == name)?;
        Some(Self { name, epoch_year })
    }
}
