//! The base station of a recording, read in step with the rover.

use nalgebra::Vector3;

use crate::config::{Mode, PositioningOptions, Profile};
use crate::formats::observations::LeftOut;
use crate::formats::receiver::TimeReference;
use crate::gnss::{
    AntennaCatalogue, BaseSite, BaseStation, Ecef, Enu, Epoch, GpsTime, LocalFrame, Navigation,
    PositionSource, antenna_reference_point,
};
use crate::positioning::{Aiding, BASE_LATER_S, BASE_MOVED_M, BaseAiding, Estimator};

use super::antenna::ReceiverAntenna;
use super::navigation::Dating;
use super::observations::{ObservationFile, ReportedSite, observations};
use super::order::EpochOrder;
use super::{AntennaProvenance, BaseProvenance, Input, RecordingError};

/// Most epochs between two of the rover (a day's base may have a minute's rover). Beyond them the
/// earlier ones are left out, and all phases count as lost.
const EPOCHS_MAX: usize = 1200;

/// The required source of a base's position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BasePosition {
    /// From the header or from messages 1005 and 1006; never from the base's own pseudoranges.
    FromHeader,
    /// This position of the marker.
    Marker(Ecef),
}

/// A base's observations that are being read.
pub struct BaseRecording<'a> {
    input: &'a Input,
    station: BaseStation,
    site: BaseSite,
    /// Single-point positions of which the base's position is the mean.
    averaged: u64,
    antenna: Option<ReceiverAntenna>,
    reader: ObservationFile,
    /// Epochs with the antenna reference point at their time.
    order: EpochOrder<Ecef>,
    /// Number of times that messages or header records moved it.
    moves: u64,
    /// An epoch that is later than the rover's, with the antenna reference point at its time.
    ahead: Option<(Epoch, Ecef)>,
    /// The first `count` epochs are new since the rover's last one.
    epochs: Vec<Epoch>,
    count: usize,
}

impl<'a> BaseRecording<'a> {
    /// Opens a base's file and finds the base's position: the requested one, otherwise that of
    /// header or messages, otherwise the mean of the base's own single-point positions.
    ///
    /// # Errors
    /// The file cannot be read, or no source gives the position.
    pub(super) fn open(
        input: &'a Input,
        position: Option<BasePosition>,
        dating: &Dating,
        navigation: &Navigation,
    ) -> Result<Self, RecordingError> {
        let reader = observations(input, dating, navigation)?;
        let reported = ReportedSite::of(input, &reader)?;
        let antenna_delta_hen_m = reported.antenna_delta_hen_m;
        let mut averaged = 0;
        let (marker, source) = match (position, reported.marker) {
            (Some(BasePosition::Marker(marker)), _) => (marker, PositionSource::Given),
            (_, Some(marker)) => (marker, reported.source),
            (Some(BasePosition::FromHeader), None) => {
                let reason =
                    "neither header nor messages 1005 and 1006 contain the base's position";
                return Err(RecordingError::BasePositionMissing { reason });
            }
            (None, None) => {
                let (point, count) = mean_position(input, dating, navigation)?;
                averaged = count;
                let reason =
                    "no source gives the base's position, and its pseudoranges do not determine it";
                let point = point.ok_or(RecordingError::BasePositionMissing { reason })?;
                let [height, east, north] = antenna_delta_hen_m;
                let below = Enu(Vector3::new(-east, -north, -height));
                (LocalFrame::at(point).to_ecef(below), PositionSource::SinglePoints)
            }
        };
        let site = BaseSite {
            marker,
            antenna_delta_hen_m,
            antenna: reported.antenna,
            calibration: None,
            source,
        };
        Ok(Self {
            input,
            station: site.station(reported.name),
            site,
            averaged,
            antenna: None,
            reader,
            order: EpochOrder::default(),
            moves: 0,
            ahead: None,
            epochs: Vec::new(),
            count: 0,
        })
    }

    /// Opens the file of a base whose rover is not in a file. `reference` dates receiver data that
    /// do not give their date.
    ///
    /// # Errors
    /// The file cannot be read, or no source gives the position.
    pub fn beside(
        input: &'a Input,
        position: Option<BasePosition>,
        reference: TimeReference,
        navigation: &Navigation,
    ) -> Result<Self, RecordingError> {
        Self::open(input, position, &Dating::new(Some(reference)), navigation)
    }

    /// Reads up to the rover's time; [`Self::aiding`] then returns the new epochs.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn follow(
        &mut self,
        rover: GpsTime,
        navigation: &Navigation,
    ) -> Result<(), RecordingError> {
        self.count = 0;
        while let Some((mut epoch, point)) = self.next(rover, navigation)? {
            if BASE_LATER_S < epoch.time - rover {
                self.ahead = Some((epoch, point));
                return Ok(());
            }
            if BASE_MOVED_M < self.station.antenna_reference_point.distance_m(point) {
                self.station.antenna_reference_point = point;
                self.moves += 1;
            }
            if self.count == EPOCHS_MAX {
                self.count = 0;
                epoch.power_failure = true;
            }
            match self.epochs.get_mut(self.count) {
                Some(spare) => std::mem::swap(spare, &mut epoch),
                None => self.epochs.push(epoch),
            }
            self.count += 1;
        }
        Ok(())
    }

    /// The next epoch with the antenna reference point at its time; `None` at the end.
    fn next(
        &mut self,
        rover: GpsTime,
        navigation: &Navigation,
    ) -> Result<Option<(Epoch, Ecef)>, RecordingError> {
        if let Some(ahead) = self.ahead.take() {
            return Ok(Some(ahead));
        }
        let empty = || Epoch::new(rover);
        let spare = self.epochs.get_mut(self.count);
        let mut epoch = spare.map_or_else(empty, |spare| std::mem::replace(spare, empty()));
        let Self { reader, order, input, site, station, .. } = self;
        let read = |epoch: &mut Epoch| {
            let is_read = reader.read_epoch(epoch).map_err(|error| input.damaged(&error))?;
            let before = station.antenna_reference_point;
            Ok(is_read.then(|| point_in_file(reader, site, before)))
        };
        let Some(point) = order.next(&mut epoch, read)? else { return Ok(None) };
        if let Some(antenna) = &mut self.antenna {
            antenna.correct(&mut epoch, Some(point), navigation);
        }
        Ok(Some((epoch, point)))
    }

    /// The base data of the rover's epoch for an estimator.
    pub fn aiding(&self) -> BaseAiding<'_> {
        BaseAiding { station: &self.station, epochs: &self.epochs[..self.count] }
    }

    /// Looks up the antenna that header or messages name, to correct later epochs.
    pub(super) fn find_antenna(&mut self, catalogue: &AntennaCatalogue) {
        self.antenna = Some(ReceiverAntenna::new("base", &self.site.antenna, catalogue));
    }

    /// The source of the base's position.
    pub fn provenance(&self) -> BaseProvenance {
        let Self { site, averaged, moves, .. } = self;
        BaseProvenance { site: site.clone(), averaged: *averaged, moves: *moves }
    }

    pub(super) fn antenna_provenance(&self) -> Option<AntennaProvenance> {
        self.antenna.as_ref().map(ReceiverAntenna::provenance)
    }

    /// The file's name and its skipped content.
    pub fn left_out(&self) -> (&'a str, LeftOut) {
        (self.input.name(), self.reader.left_out())
    }
}

/// The antenna reference point at the epoch read last: messages may move it, and so may header
/// records in the file, after an event. Without either it is `before`.
fn point_in_file(reader: &ObservationFile, site: &BaseSite, before: Ecef) -> Ecef {
    let BaseSite { source, marker, .. } = *site;
    if source == PositionSource::Message {
        let reported = reader.station().and_then(|station| station.antenna_reference_point);
        return reported.unwrap_or(before);
    }
    let Some(header) = reader.header() else { return before };
    let in_header = header.approximate_position.filter(|_| source == PositionSource::Header);
    let marker = in_header.unwrap_or(marker);
    antenna_reference_point(marker, header.antenna_delta_hen_m)
}

/// The mean of a receiver's single-point positions, ECEF (m), and their number.
fn mean_position(
    input: &Input,
    dating: &Dating,
    navigation: &Navigation,
) -> Result<(Option<Ecef>, u64), RecordingError> {
    let mut file = observations(input, dating, navigation)?;
    let options = PositioningOptions::new(Mode::Spp, Profile::General);
    let mut single_point = Estimator::new(options);
    let mut epoch = Epoch::new(GpsTime::EPOCH);
    let (mut sum_m, mut count) = (Vector3::zeros(), 0_u64);
    while file.read_epoch(&mut epoch).map_err(|error| input.damaged(&error))? {
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
    use crate::formats::rinex::{ObservationHeader, ObservationWriter, RinexVersion};
    use crate::gnss::{Constellation, Observation, ObservationCode};

    /// Of a long time before the rover's first epoch only the last part is kept, after which all
    /// phases count as lost.
    #[test]
    fn the_epochs_between_two_of_the_rover_are_bounded() {
        let code = ObservationCode::parse("1C").unwrap();
        let mut header = ObservationHeader::new(RinexVersion::new(3, 5));
        header.codes[Constellation::Gps.index()] = vec![code];
        let mut writer = ObservationWriter::new(Vec::new(), &header).unwrap();
        let at = |second: usize| GpsTime::from_week_seconds(2200, second as f64);
        for second in 0..EPOCHS_MAX + 100 {
            let mut observation = Observation::empty("G05".parse().unwrap(), code);
            observation.pseudorange_m = Some(22e6);
            let observations = vec![observation];
            writer.write_epoch(&Epoch { observations, ..Epoch::new(at(second)) }).unwrap();
        }
        let input = Input::from_bytes("base".to_owned(), writer.finish().unwrap().into());
        let place = Some(BasePosition::Marker(Ecef::new(6_378_137.0, 0.0, 0.0)));
        let navigation = Navigation::default();
        let dating = Dating::new(None);
        let mut base = BaseRecording::open(&input, place, &dating, &navigation).unwrap();
        base.follow(at(EPOCHS_MAX + 99), &navigation).unwrap();
        let kept = base.aiding().epochs;
        assert_eq!((kept.len(), kept[0].time), (100, at(EPOCHS_MAX)));
        assert!(kept[0].power_failure && !kept[1].power_failure);
        assert!(base.epochs.len() <= EPOCHS_MAX);
    }
}
