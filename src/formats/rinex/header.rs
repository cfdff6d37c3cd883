//! What the header of an observation file says.

use std::collections::BTreeMap;
use std::fmt;

use crate::gnss::{Constellation, Ecef, GpsTime, ObservationCode, TimeScale};

/// A RINEX version, such as 3.05.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RinexVersion {
    /// Before the point.
    pub major: u8,
    /// The two digits behind the point.
    pub minor: u8,
}

impl RinexVersion {
    /// A version by its parts.
    pub const fn new(major: u8, minor: u8) -> Self {
        Self { major, minor }
    }
}

impl fmt::Display for RinexVersion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{:02}", self.major, self.minor)
    }
}

/// Header of an observation file.
#[derive(Clone, Debug, PartialEq)]
pub struct ObservationHeader {
    /// Version of the file.
    pub version: RinexVersion,
    /// The one constellation of the file, or `None` for a mixed one.
    pub constellation: Option<Constellation>,
    /// Name of the marker, empty where not stated.
    pub marker: String,
    /// Receiver type, empty where not stated.
    pub receiver: String,
    /// Antenna type and radome, empty where not stated.
    pub antenna: String,
    /// Position of the marker as the header has it; `None` where absent or zero.
    pub approximate_position: Option<Ecef>,
    /// Antenna reference point above, east and north of the marker (m).
    pub antenna_delta_hen_m: [f64; 3],
    /// Observation interval (s).
    pub interval_s: Option<f64>,
    /// The scale of the file's epoch tags.
    pub time_scale: TimeScale,
    /// Time of the first observation.
    pub first_observation: Option<GpsTime>,
    /// GPS time minus UTC (s), where stated.
    pub leap_seconds: Option<i64>,
    /// FDMA channel by GLONASS slot.
    pub glonass_channels: BTreeMap<u8, i8>,
    /// Observation codes by [`Constellation::index`], in order of first appearance.
    pub codes: [Vec<ObservationCode>; Constellation::COUNT],
}

impl ObservationHeader {
    /// A header that states nothing but its version; epochs are in GPS time.
    pub const fn new(version: RinexVersion) -> Self {
        Self {
            version,
            constellation: None,
            marker: String::new(),
            receiver: String::new(),
            antenna: String::new(),
            approximate_position: None,
            antenna_delta_hen_m: [0.0; 3],
            interval_s: None,
            time_scale: TimeScale::Gps,
            first_observation: None,
            leap_seconds: None,
            glonass_channels: BTreeMap::new(),
            codes: [const { Vec::new() }; Constellation::COUNT],
        }
    }

    /// Codes observed of a constellation, in order of first appearance.
    pub fn codes_of(&self, constellation: Constellation) -> &[ObservationCode] {
        &self.codes[constellation.index()]
    }
}
