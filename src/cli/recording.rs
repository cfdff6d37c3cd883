//! The files that a recording consists of, as `solve` and `compare` take and read them.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

use clap::Args;

use crate::config::Mode;
use crate::formats::rinex::{ObservationReader, Skipped, read_navigation};
use crate::formats::{antex, decompress};
use crate::gnss::{Epoch, GpsTime, Navigation};
use crate::positioning::Aiding;

use super::Failure;
use super::antennas::{AntennaArguments, ReceiverAntenna, Whereabouts};
use super::base::{BaseArguments, BaseRecording};

const READ_BUFFER_BYTES: usize = 1 << 16;

/// The arguments that name a recording.
#[derive(Clone, Debug, Args)]
pub(crate) struct RecordingArguments {
    /// Observations of the rover.
    #[arg(long, value_name = "FILE")]
    pub(crate) rover: PathBuf,
    /// Navigation data; may be repeated.
    #[arg(long, value_name = "FILE", required = true, num_args = 1..)]
    nav: Vec<PathBuf>,
    #[command(flatten)]
    antennas: AntennaArguments,
    /// First epoch, GPS seconds of week.
    #[arg(long, value_name = "TOW", allow_negative_numbers = true)]
    from: Option<f64>,
    /// Last epoch, GPS seconds of week.
    #[arg(long, value_name = "TOW", allow_negative_numbers = true)]
    to: Option<f64>,
    #[command(flatten)]
    base: BaseArguments,
}

impl RecordingArguments {
    /// Refuses a mode that needs a base where none is named.
    pub(crate) fn check_base(&self, mode: Mode) -> Result<(), Failure> {
        if mode.is_relative() && self.base.file().is_none() {
            let message = format!("mode {} needs a base", mode.name());
            return Err(Failure::new("USAGE", message, "add --base FILE"));
        }
        Ok(())
    }

    fn is_outside(&self, time: GpsTime) -> bool {
        let seconds = time.seconds_of_week();
        self.from.is_some_and(|from| seconds < from) || self.to.is_some_and(|to| to < seconds)
    }
}

/// What the files of a recording held that was left out, by file.
pub(crate) type LeftOut<'a> = Vec<(&'a Path, Skipped)>;

/// A recording that is being read, epoch by epoch.
pub(crate) struct Recording<'a> {
    arguments: &'a RecordingArguments,
    navigation: Navigation,
    left_out: LeftOut<'a>,
    rover: ObservationReader<Box<dyn BufRead>>,
    base: Option<BaseRecording>,
    /// The rover's antenna, and where it is.
    antenna: Option<(ReceiverAntenna, Whereabouts)>,
}

impl<'a> Recording<'a> {
    /// Reads the navigation data and the header of the observations.
    pub(crate) fn open(arguments: &'a RecordingArguments) -> Result<Self, Failure> {
        let mut navigation = Navigation::default();
        let mut left_out = Vec::new();
        for path in &arguments.nav {
            let (read, skipped) = read_navigation(open(path)?)
                .map_err(|error| unreadable(path, &error, "name a RINEX navigation file"))?;
            navigation.merge(read);
            left_out.push((path.as_path(), skipped));
        }
        let observations = |path: &Path| {
            ObservationReader::new(open(path)?)
                .map_err(|error| unreadable(path, &error, "name a RINEX observation file"))
        };
        let rover = observations(&arguments.rover)?;
        let base = match arguments.base.file() {
            Some(path) => Some(BaseRecording::new(&arguments.base, observations(path)?)?),
            None => None,
        };
        let mut recording = Self { arguments, navigation, left_out, rover, base, antenna: None };
        recording.find_antennas()?;
        Ok(recording)
    }

    /// The broadcast navigation data.
    pub(crate) fn navigation(&self) -> &Navigation {
        &self.navigation
    }

    /// What an estimator needs for the epoch read last.
    pub(crate) fn aiding(&self) -> Aiding<'_> {
        let base = self.base.as_ref().map(BaseRecording::aiding);
        Aiding { navigation: &self.navigation, base }
    }

    /// Reads the next epoch of the span asked for into `epoch`; false at the end.
    pub(crate) fn read_epoch(&mut self, epoch: &mut Epoch) -> Result<bool, Failure> {
        let rover = &self.arguments.rover;
        loop {
            let is_read = self.rover.read_epoch(epoch).map_err(|error| {
                unreadable(rover, &error, "repair or cut the file at that line")
            })?;
            if !is_read {
                return Ok(false);
            }
            if !self.arguments.is_outside(epoch.time) {
                if let Some((antenna, whereabouts)) = &mut self.antenna {
                    let position = whereabouts.at(epoch, &self.navigation);
                    antenna.correct(epoch, position, &self.navigation);
                }
                self.follow(epoch.time)?;
                return Ok(true);
            }
        }
    }

    /// Reads the base on to the rover's time.
    fn follow(&mut self, time: GpsTime) -> Result<(), Failure> {
        let (Some(base), Some(path)) = (&mut self.base, self.arguments.base.file()) else {
            return Ok(());
        };
        base.follow(time, &self.navigation)
            .map_err(|error| unreadable(path, &error, "repair or cut the file at that line"))
    }

    /// Looks up the antennas that the headers name.
    fn find_antennas(&mut self) -> Result<(), Failure> {
        let Some(path) = &self.arguments.antennas.antex else { return Ok(()) };
        let catalogue = antex::read(open(path)?).map_err(|error| {
            unreadable(path, &error, "name an ANTEX file of absolute calibrations")
        })?;
        let header = self.rover.header();
        let antenna = ReceiverAntenna::new("rover", &header.antenna, &catalogue);
        self.antenna = Some((antenna, Whereabouts::new(header.approximate_position)));
        if let Some(base) = &mut self.base {
            base.find_antenna(&catalogue);
        }
        Ok(())
    }

    /// What to know of the positions: what they are of, and what was done about antennas.
    pub(crate) fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if let Some(base) = &self.base {
            notes.push("positions are of the rover's antenna reference point".to_owned());
            notes.extend(base.notes());
        }
        if let Some((antenna, _)) = &self.antenna {
            notes.extend(antenna.notes());
        }
        notes
    }

    /// What was left out of the files, the rover's first.
    pub(crate) fn into_left_out(self) -> LeftOut<'a> {
        let mut left_out = self.left_out;
        if let (Some(base), Some(path)) = (&self.base, self.arguments.base.file()) {
            left_out.insert(0, (path, base.skipped()));
        }
        left_out.insert(0, (&self.arguments.rover, self.rover.skipped().clone()));
        left_out
    }

    /// The refusal of a recording without an epoch in the span.
    pub(crate) fn no_epochs(arguments: &RecordingArguments) -> Failure {
        let message = format!("{} has no epoch in the span", arguments.rover.display());
        Failure::new("NO_EPOCHS", message, "check --from and --to")
    }
}

fn open(path: &Path) -> Result<Box<dyn BufRead>, Failure> {
    let file = File::open(path).map_err(|error| {
        let message = format!("cannot open {}: {error}", path.display());
        Failure::new("FILE_NOT_READABLE", message, "check the path and its rights")
    })?;
    Ok(Box::new(decompress(BufReader::with_capacity(READ_BUFFER_BYTES, file))))
}

fn unreadable(path: &Path, error: &dyn std::fmt::Display, remedy: &str) -> Failure {
    Failure::new("FILE_NOT_UNDERSTOOD", format!("{}: {error}", path.display()), remedy)
}
