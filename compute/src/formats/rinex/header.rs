//! The content of the header of an observation file.

use std::collections::BTreeMap;
use std::fmt;

use crate::gnss::{
    Constellation, Ecef, Ephemeris, Epoch, GpsTime, Navigation, ObservationCode, TimeScale,
};

/// A RINEX version, such as 3.05.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RinexVersion {
    /// Number before the point.
    pub major: u8,
    /// The two digits after the point.
    pub minor: u8,
}

impl RinexVersion {
    /// The version with these parts.
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
    /// Name of the marker; empty if not given.
    pub marker: String,
    /// Receiver type; empty if not given.
    pub receiver: String,
    /// Antenna type and radome; empty if not given.
    pub antenna: String,
    /// Approximate position of the marker, ECEF (m); `None` if absent or zero.
    pub approximate_position: Option<Ecef>,
    /// Antenna reference point above, east and north of the marker (m).
    pub antenna_delta_hen_m: [f64; 3],
    /// Interval between epochs (s), if given.
    pub interval_s: Option<f64>,
    /// Time scale of the file's epochs.
    pub time_scale: TimeScale,
    /// Time of the first observation.
    pub first_observation: Option<GpsTime>,
    /// GPS time minus UTC (s), if given.
    pub leap_seconds: Option<i64>,
    /// FDMA channel by GLONASS slot.
    pub glonass_channels: BTreeMap<u8, i8>,
    /// Observation codes by [`Constellation::index`], in order of first appearance.
    pub codes: [Vec<ObservationCode>; Constellation::COUNT],
}

impl ObservationHeader {
    /// Adds the observation codes of an epoch.
    pub fn add_codes(&mut self, epoch: &Epoch) {
        for observation in &epoch.observations {
            let codes = &mut self.codes[observation.satellite.constellation.index()];
            if !codes.contains(&observation.code) {
                codes.push(observation.code);
            }
        }
    }

    /// Adds the channels that ephemerides of GLONASS satellites state.
    pub fn add_channels(&mut self, navigation: &Navigation) {
        for (satellite, ephemerides) in navigation.satellites() {
            let channel = ephemerides.last().and_then(Ephemeris::glonass_channel);
            self.glonass_channels.extend(channel.map(|channel| (satellite.number, channel)));
        }
    }

    /// A header with nothing but its version; epochs are in GPS time.
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

    /// Observation codes of a constellation, in order of first appearance.
    pub(crate) fn codes_of(&self, constellation: Constellation) -> &[ObservationCode] {
        &self.codes[constellation.index()]
    }
}
