//! What the files of a recording say by themselves: for whoever chooses the ephemerides and the
//! base that they lack.

use crate::config::{Mode, PositioningOptions, Profile};
use crate::formats::observations::FileFormat;
use crate::formats::receiver::TimeReference;
use crate::gnss::{Ecef, Epoch, GpsTime, Navigation};
use crate::models::select_ephemeris;
use crate::positioning::{Aiding, Estimator};

use super::navigation::{Dating, NavigationFiles};
use super::observations::{ObservationFile, ReportedSite, observations};
use super::order::EpochOrder;
use super::{Input, RecordingError};

/// Epochs in which a single-point position is looked for.
const POSITION_EPOCHS: usize = 600;

/// Distance of the times at which ephemerides are looked for (s): that of GPS messages.
const STEP_S: f64 = 7200.0;
/// Ephemerides are in force if as many satellites have one: the unknowns of a position.
const SATELLITES: usize = 4;

/// Whether ephemerides are in force from one time until another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InForce {
    /// At none of these times.
    Never,
    /// At some of them.
    Sometimes,
    /// At all of them.
    Always,
}

impl InForce {
    /// Of these ephemerides, from one time until another, every two hours.
    pub fn of(navigation: &Navigation, (from, until): (GpsTime, GpsTime)) -> Self {
        let satellites: Vec<_> = navigation.satellites().map(|(satellite, _)| satellite).collect();
        let is_in_force = |time: GpsTime| {
            let has_one = |satellite| select_ephemeris(navigation, satellite, time).is_some();
            SATELLITES <= satellites.iter().filter(|satellite| has_one(**satellite)).count()
        };
        let steps = ((until - from) / STEP_S).ceil().max(0.0) as usize;
        let inner = (0..steps).map(|step| from + STEP_S * step as f64);
        let (mut always, mut sometimes) = (true, false);
        for time in inner.chain([until]) {
            let is = is_in_force(time);
            (always, sometimes) = (always && is, sometimes || is);
        }
        match (always, sometimes) {
            (true, _) => Self::Always,
            (false, true) => Self::Sometimes,
            (false, false) => Self::Never,
        }
    }
}

/// The files of a recording as they are read for their time, place and ephemerides.
pub struct Survey<'a> {
    rover: &'a Input,
    reader: ObservationFile,
    order: EpochOrder<()>,
    dating: Dating,
    /// Of the files of navigation data, else what the receivers have decoded.
    navigation: Navigation,
    epoch: Epoch,
    span: Option<(GpsTime, GpsTime)>,
}

impl<'a> Survey<'a> {
    /// Opens the observations of a rover and, if there are files, of its base and of navigation
    /// data. `reference` dates receiver data that do not give their date.
    ///
    /// # Errors
    /// A file cannot be read or dated.
    pub fn open(
        rover: &'a Input,
        base: Option<&'a Input>,
        navigation: &[Input],
        reference: Option<TimeReference>,
    ) -> Result<Self, RecordingError> {
        let observed: Vec<&Input> = std::iter::once(rover).chain(base).collect();
        let formats: Result<Vec<_>, _> = observed.iter().map(|input| input.format()).collect();
        let has_navigation = !navigation.is_empty() || formats?.contains(&FileFormat::Receiver);
        let (navigation, dating) = match has_navigation {
            true => {
                let files = NavigationFiles::read(navigation, &observed, reference)?;
                (files.navigation, files.dating)
            }
            false => (Navigation::default(), Dating::new(reference)),
        };
        let reader = observations(rover, &dating, &navigation)?;
        let (order, epoch) = (EpochOrder::default(), Epoch::new(GpsTime::EPOCH));
        Ok(Self { rover, reader, order, dating, navigation, epoch, span: None })
    }

    /// Reads the next epoch of the rover. Returns false at the end.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn step(&mut self) -> Result<bool, RecordingError> {
        let damaged = |error| self.rover.damaged(&error);
        let read =
            |epoch: &mut Epoch| Ok(self.reader.read_epoch(epoch).map_err(damaged)?.then_some(()));
        if self.order.next(&mut self.epoch, read)?.is_none() {
            return Ok(false);
        }
        let time = self.epoch.time;
        let (first, last) = self.span.unwrap_or((time, time));
        self.span = Some((first.min(time), last.max(time)));
        Ok(true)
    }

    /// The times of the first and the last epoch read; `None` before the first one.
    pub const fn span(&self) -> Option<(GpsTime, GpsTime)> {
        self.span
    }

    /// The ephemerides of the files of navigation data; without any, those that the receivers have
    /// decoded.
    pub const fn navigation(&self) -> &Navigation {
        &self.navigation
    }

    /// Where the rover is: its first single-point position by these ephemerides, else the position
    /// that its file states (m).
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn position(&self, navigation: &Navigation) -> Result<Option<Ecef>, RecordingError> {
        let mut file = observations(self.rover, &self.dating, navigation)?;
        let stated = ReportedSite::of(self.rover, &file)?.marker;
        let options = PositioningOptions::new(Mode::Spp, Profile::General);
        let mut single_point = Estimator::new(options);
        let mut epoch = Epoch::new(GpsTime::EPOCH);
        for _ in 0..POSITION_EPOCHS {
            if !file.read_epoch(&mut epoch).map_err(|error| self.rover.damaged(&error))? {
                break;
            }
            let solution = single_point.advance(&epoch, &Aiding::alone(navigation));
            if let Some(estimate) = solution.estimate {
                return Ok(Some(estimate.position));
            }
        }
        Ok(stated)
    }
}
