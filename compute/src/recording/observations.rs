//! Files of observations and the station data in them.

use nalgebra::Vector3;

use crate::formats::observations::{FileFormat, Observations, station};
use crate::gnss::{Ecef, Enu, LocalFrame, Navigation, PositionSource};

use super::input::Reader;
use super::navigation::Dating;
use super::{Input, RecordingError};

/// A file of observations that is being read.
pub(super) type ObservationFile = Observations<Reader>;

/// Opens a file of observations.
///
/// # Errors
/// The file has no readable observations, or its week or day is unknown.
pub(super) fn observations(
    input: &Input,
    dating: &Dating,
    navigation: &Navigation,
) -> Result<ObservationFile, RecordingError> {
    let mut reference = None;
    if input.format()? == FileFormat::Receiver {
        reference = dating.of(input)?;
        if reference.is_none() {
            return Err(RecordingError::NoReferenceTime { name: input.name().to_owned() });
        }
    }
    input.observations(reference, navigation)
}

/// Station data in a file.
pub(super) struct ReportedSite {
    pub(super) name: String,
    /// Type and radome; empty if unknown.
    pub(super) antenna: String,
    pub(super) marker: Option<Ecef>,
    /// The marker's position, if it is known.
    pub(super) source: PositionSource,
    /// Antenna reference point above, east and north of the marker (m).
    pub(super) antenna_delta_hen_m: [f64; 3],
}

impl ReportedSite {
    /// From the RINEX header of an open file, or from messages 1005 to 1008 and 1033 of receiver
    /// data. A GnssLogger log reports nothing.
    ///
    /// # Errors
    /// Receiver data cannot be read.
    pub(super) fn of(input: &Input, file: &ObservationFile) -> Result<Self, RecordingError> {
        if let Some(header) = file.header() {
            return Ok(Self {
                name: header.marker.clone(),
                antenna: header.antenna.clone(),
                marker: header.approximate_position,
                source: PositionSource::Header,
                antenna_delta_hen_m: header.antenna_delta_hen_m,
            });
        }
        if file.format() == FileFormat::GnssLogger {
            return Ok(Self {
                name: input.name().to_owned(),
                antenna: String::new(),
                marker: None,
                source: PositionSource::Header,
                antenna_delta_hen_m: [0.0; 3],
            });
        }
        let station = station(input.recognised()?)
            .map_err(|error| input.damaged(&error))?
            .unwrap_or_default();
        // Messages contain the antenna reference point and its height above the marker.
        let height_m = station.antenna_height_m.unwrap_or(0.0);
        let below = Enu(Vector3::new(0.0, 0.0, -height_m));
        let point = station.antenna_reference_point;
        Ok(Self {
            name: station.id.to_string(),
            antenna: station.antenna,
            marker: point.map(|point| LocalFrame::at(point).to_ecef(below)),
            source: PositionSource::Message,
            antenna_delta_hen_m: [height_m, 0.0, 0.0],
        })
    }
}
