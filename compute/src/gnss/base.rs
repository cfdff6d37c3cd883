//! Base stations: receivers at known positions.
//!
//! The position stated for a base is that of its *marker*. The observations of its receiver, and
//! every position relative to it, refer to its *antenna reference point*.

use std::sync::Arc;

use nalgebra::Vector3;

use super::{AntennaCalibration, Ecef, Enu, LocalFrame};

/// A receiver at a known position, which rovers are positioned against.
#[derive(Clone, Debug, PartialEq)]
pub struct BaseStation {
    /// The base's name, for messages.
    pub name: String,
    /// Antenna reference point, ECEF (m): the marker plus the antenna's offset.
    pub antenna_reference_point: Ecef,
}

/// The source of a base position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PositionSource {
    /// Coordinates given by the owner of the base.
    Given,
    /// The header of its observation file.
    Header,
    /// Messages 1005 and 1006 of RTCM 3.
    Message,
    /// The mean of the base's own single-point positions, if no other source gives any.
    SinglePoints,
}

impl PositionSource {
    /// All sources of a base position.
    pub(crate) const ALL: [Self; 4] =
        [Self::Given, Self::Header, Self::Message, Self::SinglePoints];

    /// The name in the API.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Given => "given",
            Self::Header => "header",
            Self::Message => "message",
            Self::SinglePoints => "single-points",
        }
    }

    /// The source with this name in the API, or `None`.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|source| source.name() == name)
    }
}

/// The position of a base: its marker and its antenna above it.
#[derive(Clone, Debug, PartialEq)]
pub struct BaseSite {
    /// Position of the marker, ECEF (m).
    pub marker: Ecef,
    /// Antenna reference point above, east and north of the marker (m).
    pub antenna_delta_hen_m: [f64; 3],
    /// Antenna type and radome; empty if unknown.
    pub antenna: String,
    /// Phase centres of that antenna, where they are known.
    pub calibration: Option<Arc<AntennaCalibration>>,
    /// Source of the marker's position.
    pub source: PositionSource,
}

impl BaseSite {
    /// The antenna reference point, ECEF (m).
    pub fn antenna_reference_point(&self) -> Ecef {
        antenna_reference_point(self.marker, self.antenna_delta_hen_m)
    }

    /// The base station at this position, with the name given.
    pub fn station(&self, name: String) -> BaseStation {
        BaseStation { name, antenna_reference_point: self.antenna_reference_point() }
    }
}

/// The antenna reference point at these heights above, and distances east and north of a marker
/// (m), ECEF (m).
pub(crate) fn antenna_reference_point(marker: Ecef, [height, east, north]: [f64; 3]) -> Ecef {
    LocalFrame::at(marker).to_ecef(Enu(Vector3::new(east, north, height)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// On the equator at longitude zero, up, east and north are x, y and z.
    #[test]
    fn the_antenna_stands_above_its_marker() {
        let site = BaseSite {
            marker: Ecef::new(6_378_137.0, 0.0, 0.0),
            antenna_delta_hen_m: [1.5, 0.2, -0.3],
            antenna: String::new(),
            calibration: None,
            source: PositionSource::Given,
        };
        let base = site.station("HERT".to_owned());
        let expected = Ecef::new(6_378_138.5, 0.2, -0.3);
        assert!(base.antenna_reference_point.distance_m(expected) < 1e-9);
    }
}
