//! The base station of a recording, read in step with the rover.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::Args;

use nalgebra::Vector3;

use crate::config::{Mode, PositioningOptions, Profile};
use crate::formats::observations::{FileError, LeftOut};
use crate::gnss::{
    AntennaCatalogue, BaseSite, BaseStation, Ecef, Enu, Epoch, GpsTime, LocalFrame, Navigation,
    PositionSource,
};
use crate::positioning::{Aiding, BASE_LATER_S, BaseAiding, Estimator};

use super::Failure;
use super::antennas::ReceiverAntenna;
use super::files::{self, Dating, ObservationFile};

/// A base that messages place further away has moved (m): they tell tenths of millimetres.
const MOVED_M: f64 = 1e-3;

/// The arguments that name a base.
#[derive(Clone, Debug, Args)]
pub(crate) struct BaseArguments {
    /// Observations of the base, for modes relative to one.
    #[arg(long, value_name = "FILE")]
    base: Option<PathBuf>,
    /// Position of the base's marker, ECEF (m); its header's antenna offset is added. Of UBX and
    /// RTCM 3 data the position in messages 1005 and 1006 takes the header's place. Not given: from
    /// these, and where they tell none, the mean of the base's own single-point positions.
    #[arg(long, value_name = "X,Y,Z|from-header", allow_hyphen_values = true, requires = "base")]
    base_position: Option<BasePosition>,
}

/// Where a base's position must come from.
#[derive(Clone, Copy, Debug, PartialEq)]
enum BasePosition {
    FromHeader,
    Marker(Ecef),
}

impl FromStr for BasePosition {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "from-header" {
            return Ok(Self::FromHeader);
        }
        let numbers: Result<Vec<f64>, _> = text.split(',').map(|n| n.trim().parse()).collect();
        match numbers.as_deref() {
            Ok([x, y, z]) if [x, y, z].iter().all(|n| n.is_finite()) => {
                Ok(Self::Marker(Ecef::new(*x, *y, *z)))
            }
            _ => Err("expected X,Y,Z in metres, or from-header".to_owned()),
        }
    }
}

impl BaseArguments {
    /// The base's file, if one is named.
    pub(crate) fn file(&self) -> Option<&Path> {
        self.base.as_deref()
    }
}

/// A base's observations that are being read.
pub(crate) struct BaseRecording {
    station: BaseStation,
    site: BaseSite,
    /// Single-point positions of which the base's position is the mean.
    averaged: u64,
    antenna: Option<ReceiverAntenna>,
    reader: ObservationFile,
    /// Times that messages moved it, as virtual bases are.
    moves: u64,
    /// Read with where the antenna then was, and later than the rover's epoch.
    ahead: Option<(Epoch, Ecef)>,
    /// New since the rover's epoch before; the first `count` of them.
    epochs: Vec<Epoch>,
    count: usize,
}

impl BaseRecording {
    /// Opens a base's file and finds out where the base stands: as asked for, else as the file
    /// tells, else by what it observes.
    ///
    /// # Errors
    /// The file cannot be read, or nothing tells the position.
    pub(crate) fn open(
        arguments: &BaseArguments,
        path: &Path,
        dating: &Dating,
        navigation: &Navigation,
    ) -> Result<Self, Failure> {
        let reader = files::observations(path, dating, navigation)?;
        let told = files::site(path, &reader)?;
        let (antenna_delta_hen_m, antenna) = (told.antenna_hen_m, told.antenna);
        let mut averaged = 0;
        let (marker, source) = match (arguments.base_position, told.marker) {
            (Some(BasePosition::Marker(marker)), _) => (marker, PositionSource::Given),
            (_, Some(marker)) => (marker, told.source),
            (Some(BasePosition::FromHeader), None) => {
                let message = "neither header nor messages 1005 and 1006 tell the base's position";
                return Err(position_missing(message));
            }
            (None, None) => {
                let observed = files::observations(path, dating, navigation)?;
                let mean = mean_position(observed, navigation);
                let (point, count) = mean.map_err(|error| files::broken(path, &error))?;
                averaged = count;
                let point = point.ok_or_else(|| {
                    position_missing("nothing tells the base's position, nor do its pseudoranges")
                })?;
                let [height, east, north] = antenna_delta_hen_m;
                let below = Enu(Vector3::new(-east, -north, -height));
                (LocalFrame::at(point).to_ecef(below), PositionSource::SinglePoints)
            }
        };
        let site = BaseSite { marker, antenna_delta_hen_m, antenna, source };
        Ok(Self {
            station: site.station(told.name),
            site,
            averaged,
            antenna: None,
            reader,
            moves: 0,
            ahead: None,
            epochs: Vec::new(),
            count: 0,
        })
    }

    /// Reads on to the rover's time; what is new stands ready afterwards.
    pub(crate) fn follow(
        &mut self,
        rover: GpsTime,
        navigation: &Navigation,
    ) -> Result<(), FileError> {
        self.count = 0;
        loop {
            let (mut epoch, place) = match self.ahead.take() {
                Some(ahead) => ahead,
                None => {
                    let mut epoch = self.epochs.get_mut(self.count).map_or_else(
                        || Epoch::new(rover),
                        |spare| std::mem::replace(spare, Epoch::new(rover)),
                    );
                    if !self.reader.read_epoch(&mut epoch)? {
                        return Ok(());
                    }
                    let place = self.place();
                    if let Some(antenna) = &mut self.antenna {
                        antenna.correct(&mut epoch, Some(place), navigation);
                    }
                    (epoch, place)
                }
            };
            if BASE_LATER_S < epoch.time - rover {
                self.ahead = Some((epoch, place));
                return Ok(());
            }
            if MOVED_M < self.station.antenna_reference_point.distance_m(place) {
                self.station.antenna_reference_point = place;
                self.moves += 1;
            }
            match self.epochs.get_mut(self.count) {
                Some(spare) => std::mem::swap(spare, &mut epoch),
                None => self.epochs.push(epoch),
            }
            self.count += 1;
        }
    }

    /// Where the antenna was at the epoch read last: messages may move it.
    fn place(&self) -> Ecef {
        let told = match self.site.source {
            PositionSource::Message => self.reader.station(),
            _ => None,
        };
        let told = told.and_then(|station| station.antenna_reference_point);
        told.unwrap_or(self.station.antenna_reference_point)
    }

    /// What an estimator needs for the rover's epoch.
    pub(crate) fn aiding(&self) -> BaseAiding<'_> {
        BaseAiding { station: &self.station, epochs: &self.epochs[..self.count] }
    }

    /// Looks up the antenna that the header names.
    pub(crate) fn find_antenna(&mut self, catalogue: &AntennaCatalogue) {
        let antenna = ReceiverAntenna::new("base", &self.site.antenna, catalogue);
        self.antenna = Some(antenna);
    }

    /// Where the base was taken to be, and what was done about its antenna.
    pub(crate) fn notes(&self) -> Vec<String> {
        let Ecef(marker) = self.site.marker;
        let [height_m, east_m, north_m] = self.site.antenna_delta_hen_m;
        let source = match self.site.source {
            PositionSource::Given => "as given",
            PositionSource::Header => "from its header",
            PositionSource::Message => "from its messages 1005 and 1006",
            PositionSource::SinglePoints => "from its own single-point positions",
        };
        let mut notes = vec![format!(
            "base: marker at {:.4},{:.4},{:.4} (ECEF, m) {source}, antenna reference point \
             {height_m:.4} m above, {east_m:.4} m east, {north_m:.4} m north of it",
            marker.x, marker.y, marker.z
        )];
        if self.site.source == PositionSource::SinglePoints {
            notes.push(format!(
                "warning: base: nothing tells its position; the mean of {} single-point positions \
                 may be metres off, and all positions relative to it by as much",
                self.averaged
            ));
        }
        if 0 < self.moves {
            notes.push(format!(
                "base: messages moved it {} times; each epoch counts where it then was",
                self.moves
            ));
        }
        notes.extend(self.antenna.iter().flat_map(ReceiverAntenna::notes));
        notes
    }

    /// What was left out of the file.
    pub(crate) fn left_out(&self) -> LeftOut {
        self.reader.left_out()
    }
}

fn position_missing(message: &str) -> Failure {
    Failure::new("BASE_POSITION_MISSING", message, "give --base-position X,Y,Z")
}

/// The mean of a receiver's single-point positions, ECEF (m), and of how many it is.
fn mean_position(
    mut observed: ObservationFile,
    navigation: &Navigation,
) -> Result<(Option<Ecef>, u64), FileError> {
    let options = PositioningOptions::new(Mode::Spp, Profile::General);
    let mut single_point = Estimator::new(options);
    let mut epoch = Epoch::new(GpsTime::EPOCH);
    let (mut sum_m, mut count) = (Vector3::zeros(), 0_u64);
    while observed.read_epoch(&mut epoch)? {
        let solution = single_point.advance(&epoch, &Aiding::alone(navigation));
        if let Some(estimate) = solution.estimate {
            sum_m += estimate.position.0;
            count += 1;
        }
    }
    Ok(((0 < count).then(|| Ecef(sum_m / count as f64)), count))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_position_is_three_numbers_or_the_headers() {
        let marker = Ecef::new(4033460.75, 23538.0, -4924318.5);
        assert_eq!("4033460.75, 23538,-4924318.5".parse(), Ok(BasePosition::Marker(marker)));
        assert_eq!("from-header".parse(), Ok(BasePosition::FromHeader));
        for wrong in ["", "1,2", "1,2,3,4", "1,2,x", "nan,1,2"] {
            assert!(wrong.parse::<BasePosition>().is_err(), "{wrong}");
        }
    }
}
