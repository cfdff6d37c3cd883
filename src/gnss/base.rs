//! Base stations: receivers at known places.
//!
//! A position stated for a base is that of its *marker*; what its receiver observes, and so every
//! position relative to it, is of the *antenna reference point*.

use nalgebra::Vector3;

use super::{Ecef, Enu, LocalFrame};

/// A receiver at a known place, against which others are positioned.
#[derive(Clone, Debug, PartialEq)]
pub struct BaseStation {
    /// Its name, for messages.
    pub name: String,
    /// Its antenna reference point, ECEF (m); a marker's position with the antenna's offset added.
    pub antenna_reference_point: Ecef,
}

/// How the place of a base became known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PositionSource {
    /// Its owner stated it.
    Given,
    /// The header of its observation file.
    Header,
    /// Messages 1005 and 1006 of RTCM 3.
    Message,
    /// The mean of its own single-point positions, where nothing tells it.
    SinglePoints,
}

impl PositionSource {
    /// Every source.
    pub const ALL: [Self; 4] = [Self::Given, Self::Header, Self::Message, Self::SinglePoints];

    /// The name as the API writes it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Given => "given",
            Self::Header => "header",
            Self::Message => "message",
            Self::SinglePoints => "single-points",
        }
    }

    /// The source of a name as the API writes it.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|source| source.name() == name)
    }
}

/// Where a base stands: its marker, and its antenna above it.
#[derive(Clone, Debug, PartialEq)]
pub struct BaseSite {
    /// Position of the marker, ECEF (m).
    pub marker: Ecef,
    /// Antenna reference point above, east and north of the marker (m).
    pub antenna_delta_hen_m: [f64; 3],
    /// Type and radome of the antenna; empty where not told.
    pub antenna: String,
    /// How the marker's position became known.
    pub source: PositionSource,
}

impl BaseSite {
    /// The antenna reference point, ECEF (m).
    pub fn antenna_reference_point(&self) -> Ecef {
        let [height, east, north] = self.antenna_delta_hen_m;
        LocalFrame::at(self.marker).to_ecef(Enu(Vector3::new(east, north, height)))
    }

    /// The station that stands there.
    pub fn station(&self, name: String) -> BaseStation {
        BaseStation { name, antenna_reference_point: self.antenna_reference_point() }
    }
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
            source: PositionSource::Given,
        };
        let base = site.station("HERT".to_owned());
        let expected = Ecef::new(6_378_138.5, 0.2, -0.3);
        assert!(base.antenna_reference_point.distance_m(expected) < 1e-9);
    }
}
