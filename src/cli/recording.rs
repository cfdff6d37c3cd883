//! The files that a recording consists of, as `solve` and `compare` take and read them.

use std::path::{Path, PathBuf};

use clap::Args;

use crate::config::Mode;
use crate::formats::antex;
use crate::formats::odometry;
use crate::gnss::{Epoch, GpsTime, Navigation};
use crate::positioning::Aiding;

use super::Failure;
use super::antennas::{AntennaArguments, ReceiverAntenna, Whereabouts};
use super::base::{BaseArguments, BaseRecording};
use super::files::{self, LeftOutOf, ObservationFile, TimeArguments};
use super::odometry::OdometryRows;

/// The arguments that name a recording.
#[derive(Clone, Debug, Args)]
pub(crate) struct RecordingArguments {
    /// Observations of the rover: RINEX, CRINEX, UBX or RTCM 3, told apart by their content.
    #[arg(long, value_name = "FILE")]
    pub(crate) rover: PathBuf,
    /// Navigation data: RINEX, or UBX or RTCM 3 with ephemerides; may be repeated.
    #[arg(long, value_name = "FILE", required = true, num_args = 1..)]
    nav: Vec<PathBuf>,
    #[command(flatten)]
    antennas: AntennaArguments,
    /// Displacements of another sensor, CSV as simulate writes it; each goes to the epoch within
    /// 0.05 s of its time.
    #[arg(long, value_name = "FILE")]
    odometry: Option<PathBuf>,
    /// First epoch, GPS seconds of week.
    #[arg(long, value_name = "TOW", allow_negative_numbers = true)]
    from: Option<f64>,
    /// Last epoch, GPS seconds of week.
    #[arg(long, value_name = "TOW", allow_negative_numbers = true)]
    to: Option<f64>,
    #[command(flatten)]
    times: TimeArguments,
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

/// A recording that is being read, epoch by epoch.
pub(crate) struct Recording<'a> {
    arguments: &'a RecordingArguments,
    navigation: Navigation,
    left_out: LeftOutOf<'a>,
    rover: ObservationFile,
    base: Option<BaseRecording>,
    /// The rover's antenna, and where it is.
    antenna: Option<(ReceiverAntenna, Whereabouts)>,
    odometry: Option<OdometryRows>,
}

impl<'a> Recording<'a> {
    /// Reads the navigation data and the header of the observations.
    pub(crate) fn open(arguments: &'a RecordingArguments) -> Result<Self, Failure> {
        let (rover, base) = (arguments.rover.as_path(), arguments.base.file());
        let files: Vec<&Path> = [Some(rover), base].into_iter().flatten().collect();
        let (navigation, left_out, dating) =
            files::navigation(&arguments.nav, &files, &arguments.times)?;
        let rover = files::observations(rover, &dating, &navigation)?;
        let open_base = |path| BaseRecording::open(&arguments.base, path, &dating, &navigation);
        let base = base.map(open_base).transpose()?;
        let read_rows = |path: &PathBuf| {
            odometry::read(files::open_plain(path)?)
                .map(OdometryRows::new)
                .map_err(|error| files::unreadable(path, &error, "correct the file at that line"))
        };
        let odometry = arguments.odometry.as_ref().map(read_rows).transpose()?;
        let mut recording =
            Self { arguments, navigation, left_out, rover, base, antenna: None, odometry };
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
            let is_read =
                self.rover.read_epoch(epoch).map_err(|error| files::broken(rover, &error))?;
            if !is_read {
                return Ok(false);
            }
            // Asked for every epoch, so that those outside take theirs.
            epoch.odometry = self.odometry.as_mut().and_then(|rows| rows.at(epoch.time));
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
        base.follow(time, &self.navigation).map_err(|error| files::broken(path, &error))
    }

    /// Looks up the antennas that the headers name.
    fn find_antennas(&mut self) -> Result<(), Failure> {
        let Some(path) = &self.arguments.antennas.antex else { return Ok(()) };
        let catalogue = antex::read(files::open_plain(path)?).map_err(|error| {
            files::unreadable(path, &error, "name an ANTEX file of absolute calibrations")
        })?;
        let site = files::site(&self.arguments.rover, &self.rover)?;
        let antenna = ReceiverAntenna::new("rover", &site.antenna, &catalogue);
        self.antenna = Some((antenna, Whereabouts::new(site.marker)));
        if let Some(base) = &mut self.base {
            base.find_antenna(&catalogue);
        }
        Ok(())
    }

    /// What to know of the positions: what they are of, what was done about antennas, and
    /// which rows of odometry no epoch took.
    pub(crate) fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if let Some(base) = &self.base {
            notes.push("positions are of the rover's antenna reference point".to_owned());
            notes.extend(base.notes());
        }
        if let Some((antenna, _)) = &self.antenna {
            notes.extend(antenna.notes());
        }
        if let Some(odometry) = &self.odometry {
            notes.push(format!("odometry: {} rows without an epoch", odometry.unmatched()));
        }
        notes
    }

    /// What was left out of the files, the rover's first.
    pub(crate) fn into_left_out(self) -> LeftOutOf<'a> {
        let mut left_out = self.left_out;
        left_out.retain(|(path, _)| *path != self.arguments.rover);
        if let (Some(base), Some(path)) = (&self.base, self.arguments.base.file()) {
            left_out.insert(0, (path, base.left_out()));
        }
        left_out.insert(0, (&self.arguments.rover, self.rover.left_out()));
        left_out
    }

    /// The refusal of a recording without an epoch in the span.
    pub(crate) fn no_epochs(arguments: &RecordingArguments) -> Failure {
        let message = format!("{} has no epoch in the span", arguments.rover.display());
        Failure::new("NO_EPOCHS", message, "check --from and --to")
    }
}
