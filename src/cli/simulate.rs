//! `graphfix simulate`: writes files of simulated observations and their truth.

use std::fs::{File, create_dir_all};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::Failure;
use super::output::print;
use crate::formats::gnss_logger::LogWriter;
use crate::formats::odometry::{self, OdometryRow};
use crate::formats::rinex::{
    ObservationHeader, ObservationWriter, RinexVersion, RinexWriteError, write_navigation,
};
use crate::formats::truth::{self, TruthRow};
use crate::gnss::constants::{SECONDS_PER_HOUR, SECONDS_PER_WEEK};
use crate::gnss::{Constellation, Ecef, Ephemeris, Epoch, Navigation};
use crate::refusal::Code;
use crate::simulation::{RandomDrive, Scenario, Simulator};

/// The names of the files.
const FILES: [&str; 7] = [
    "rover.obs",
    "gnss_log.txt",
    "base.obs",
    "navigation.rnx",
    "odometry.csv",
    "truth.csv",
    "README.txt",
];
/// Longest simulation and shortest interval. They bound the size of the files.
const LONGEST_S: f64 = SECONDS_PER_WEEK;
const SHORTEST_INTERVAL_S: f64 = 0.01;
/// A longer baseline would put the base below the rover's horizon.
const LONGEST_BASELINE_M: f64 = 1e5;

/// Format of the rover's observations.
#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum RoverFormat {
    /// RINEX 3.05: rover.obs.
    Rinex,
    /// Android GnssLogger log: gnss_log.txt.
    GnssLogger,
}

impl RoverFormat {
    /// The name of the file, and what it is.
    const fn file(self) -> (&'static str, &'static str) {
        match self {
            Self::Rinex => ("rover.obs", "RINEX 3.05"),
            Self::GnssLogger => ("gnss_log.txt", "Android GnssLogger log"),
        }
    }
}

/// Simulates a rover and its base and writes RINEX 3.05 files and the truth.
#[derive(Debug, Args)]
pub(crate) struct SimulateArguments {
    /// Scenario: open-sky, urban-canyon, rtk-open, rtk-canyon, clean or random-drive.
    #[arg(long, value_name = "NAME")]
    scenario: String,
    /// Seed of the random numbers; the same seed gives the same files.
    #[arg(long, value_name = "N")]
    seed: u64,
    /// Folder to write to; it is created if absent.
    #[arg(long, value_name = "DIR")]
    output: PathBuf,
    /// Duration (s); default: the scenario's.
    #[arg(long, value_name = "S")]
    duration: Option<f64>,
    /// Epochs per second (Hz); default: the scenario's.
    #[arg(long, value_name = "HZ")]
    rate: Option<f64>,
    /// Distance from the origin to the base (m); default: the scenario's.
    #[arg(long, value_name = "M")]
    baseline: Option<f64>,
    /// Simulate one frequency only.
    #[arg(long)]
    single_frequency: bool,
    /// Format of the rover's observations.
    #[arg(long, value_name = "NAME", value_enum, default_value = "rinex")]
    format: RoverFormat,
    /// Overwrite existing files.
    #[arg(long)]
    force: bool,
}

/// Simulates and writes.
pub(crate) fn run(arguments: &SimulateArguments) -> Result<(), Failure> {
    let (scenario, meaning) = arguments.scenario()?;
    let folder = &arguments.output;
    if let Some(name) = FILES.iter().find(|name| !arguments.force && folder.join(name).exists()) {
        let message = format!("{} exists", folder.join(name).display());
        return Err(Failure::of(Code::FileExists, message));
    }
    create_dir_all(folder).map_err(|error| not_writable(folder, &error))?;
    let simulator = Simulator::new(scenario.clone(), arguments.seed);
    let navigation = simulator.navigation().clone();
    let base_position = simulator.base_position();
    write_navigation(create(&folder.join("navigation.rnx"))?, &navigation)
        .map_err(|error| not_writable(&folder.join("navigation.rnx"), &error))?;
    let epochs = write_epochs((folder, arguments.format), &scenario, simulator)?;
    let summary = summary(arguments, (&scenario, &meaning), epochs, base_position);
    let readme = folder.join("README.txt");
    let written = create(&readme)?.write_all(summary.as_bytes());
    written.map_err(|error| not_writable(&readme, &error))?;
    print(&summary)
}

impl SimulateArguments {
    /// The scenario of the name, and its description.
    fn named(&self) -> Result<(Scenario, String), Failure> {
        if self.scenario == RandomDrive::NAME.0 {
            let drive = RandomDrive::draw(self.seed);
            return Ok((drive.scenario, format!("{}\n{}", RandomDrive::NAME.1, drive.description)));
        }
        let all = Scenario::NAMES.into_iter().chain([RandomDrive::NAME]);
        let found = Scenario::by_name(&self.scenario);
        let meaning = all.clone().find(|(name, _)| *name == self.scenario);
        let Some((scenario, (_, meaning))) = found.zip(meaning) else {
            let names: Vec<_> = all.map(|(name, _)| name).collect();
            let message = format!("no scenario is named {:?}", self.scenario);
            let remedy = format!("one of {}", names.join(", "));
            return Err(Failure::new(Code::UnknownScenario, message, remedy));
        };
        Ok((scenario, meaning.to_owned()))
    }

    /// The scenario with the requested options.
    fn scenario(&self) -> Result<(Scenario, String), Failure> {
        let (mut scenario, meaning) = self.named()?;
        if let Some(duration_s) = self.duration {
            if !(0.0..=LONGEST_S).contains(&duration_s) {
                return Err(out_of_range("--duration", duration_s, 0.0, LONGEST_S));
            }
            scenario.duration_s = duration_s;
        }
        if let Some(rate_hz) = self.rate {
            let (lowest, highest) = (1.0 / SECONDS_PER_HOUR, 1.0 / SHORTEST_INTERVAL_S);
            if !(lowest..=highest).contains(&rate_hz) {
                return Err(out_of_range("--rate", rate_hz, lowest, highest));
            }
            scenario.interval_s = 1.0 / rate_hz;
        }
        if let Some(baseline_m) = self.baseline {
            if !(0.0..=LONGEST_BASELINE_M).contains(&baseline_m) {
                return Err(out_of_range("--baseline", baseline_m, 0.0, LONGEST_BASELINE_M));
            }
            scenario = scenario.with_baseline(baseline_m);
        }
        if self.single_frequency {
            scenario.frequencies = 1;
        }
        Ok((scenario, meaning))
    }
}

/// Writes rover, base, odometry and truth; returns the number of epochs.
fn write_epochs(
    (folder, format): (&Path, RoverFormat),
    scenario: &Scenario,
    simulator: Simulator,
) -> Result<usize, Failure> {
    let navigation = simulator.navigation().clone();
    let failed = |error: RinexWriteError| not_writable(folder, &error);
    let mut rover = ObservationFile::create((folder, format), scenario, &navigation)?;
    let mut base = match simulator.base_position() {
        Some(position) => {
            Some(rinex_writer((folder, "base.obs"), scenario, Some(position), &navigation)?)
        }
        None => None,
    };
    let (mut rows, mut ways) = (Vec::new(), Vec::new());
    for epoch in simulator {
        rover.write_epoch(folder, &epoch.rover)?;
        if let (Some(writer), Some(observed)) = (&mut base, &epoch.base) {
            writer.write_epoch(observed).map_err(failed)?;
        }
        let time = epoch.rover.time;
        ways.extend(epoch.odometry.map(|odometry| OdometryRow { time, odometry }));
        rows.push(TruthRow { time: epoch.rover.time, position: epoch.position });
    }
    rover.finish(folder)?;
    base.map(ObservationWriter::finish).transpose().map_err(failed)?;
    let path = folder.join("truth.csv");
    truth::write(create(&path)?, &rows).map_err(|error| not_writable(&path, &error))?;
    let path = folder.join("odometry.csv");
    odometry::write(create(&path)?, &ways).map_err(|error| not_writable(&path, &error))?;
    Ok(rows.len())
}

/// The file of the rover's observations.
enum ObservationFile<'a> {
    Rinex(ObservationWriter<BufWriter<File>>),
    GnssLogger(LogWriter<'a, BufWriter<File>>),
}

impl<'a> ObservationFile<'a> {
    fn create(
        (folder, format): (&Path, RoverFormat),
        scenario: &Scenario,
        navigation: &'a Navigation,
    ) -> Result<Self, Failure> {
        let (name, _) = format.file();
        if format == RoverFormat::Rinex {
            return rinex_writer((folder, name), scenario, None, navigation).map(Self::Rinex);
        }
        let path = folder.join(name);
        let writer = LogWriter::new(create(&path)?, navigation);
        writer.map(Self::GnssLogger).map_err(|error| not_writable(&path, &error))
    }

    fn write_epoch(&mut self, folder: &Path, epoch: &Epoch) -> Result<(), Failure> {
        match self {
            Self::Rinex(writer) => {
                writer.write_epoch(epoch).map_err(|error| not_writable(folder, &error))
            }
            Self::GnssLogger(writer) => {
                let written = writer.write_epoch(epoch);
                written.map(|_| ()).map_err(|error| not_writable(folder, &error))
            }
        }
    }

    fn finish(self, folder: &Path) -> Result<(), Failure> {
        match self {
            Self::Rinex(writer) => {
                writer.finish().map(|_| ()).map_err(|error| not_writable(folder, &error))
            }
            Self::GnssLogger(writer) => {
                writer.finish().map(|_| ()).map_err(|error| not_writable(folder, &error))
            }
        }
    }
}

fn rinex_writer(
    (folder, name): (&Path, &str),
    scenario: &Scenario,
    position: Option<Ecef>,
    navigation: &Navigation,
) -> Result<ObservationWriter<BufWriter<File>>, Failure> {
    let path = folder.join(name);
    let header = header(name, scenario, position, navigation);
    ObservationWriter::new(create(&path)?, &header).map_err(|error| not_writable(&path, &error))
}

/// The header of a simulated file of observations.
pub(super) fn header(
    name: &str,
    scenario: &Scenario,
    position: Option<Ecef>,
    navigation: &Navigation,
) -> ObservationHeader {
    let mut codes = [const { Vec::new() }; Constellation::COUNT];
    for constellation in &scenario.constellations {
        codes[constellation.index()] = scenario.signals(*constellation).collect();
    }
    let channel = |list: &[Ephemeris]| {
        let first = list.first()?;
        Some((first.satellite().number, first.glonass_channel()?))
    };
    ObservationHeader {
        marker: name.trim_end_matches(".obs").to_uppercase(),
        receiver: "GRAPHFIX SIMULATION".to_owned(),
        antenna: "IDEAL".to_owned(),
        approximate_position: position,
        interval_s: Some(scenario.interval_s),
        first_observation: Some(scenario.start),
        leap_seconds: Some(navigation.leap_seconds.at(scenario.start)),
        glonass_channels: navigation.satellites().filter_map(|(_, list)| channel(list)).collect(),
        codes,
        ..ObservationHeader::new(RinexVersion::new(3, 5))
    }
}

fn summary(
    arguments: &SimulateArguments,
    (scenario, meaning): (&Scenario, &str),
    epochs: usize,
    base: Option<Ecef>,
) -> String {
    let (rover, format) = arguments.format.file();
    let mut text = format!(
        "Simulated by graphfix {}: scenario {}, seed {}\n{}\n\n\
         {epochs} epochs from GPS {} on, every {} s\n\
         {rover:<16}what the rover measured ({format})\n",
        env!("CARGO_PKG_VERSION"),
        arguments.scenario,
        arguments.seed,
        meaning,
        scenario.start,
        scenario.interval_s,
    );
    if let Some(Ecef(p)) = base {
        text += &format!(
            "base.obs        what the base measured, antenna at {:.4},{:.4},{:.4} (ECEF, m)\n",
            p.x, p.y, p.z
        );
    }
    text += "navigation.rnx  what the satellites broadcast (RINEX 3.05)\n\
             odometry.csv    displacements measured by the wheels, for solve --odometry\n\
             truth.csv       where the rover's antenna was: gps_week,tow,x_m,y_m,z_m\n";
    text
}

fn create(path: &Path) -> Result<BufWriter<File>, Failure> {
    File::create(path).map(BufWriter::new).map_err(|error| not_writable(path, &error))
}

fn not_writable(path: &Path, error: &dyn std::error::Error) -> Failure {
    let message = format!("cannot write {}: {error}", path.display());
    Failure::of(Code::FileNotWritable, message)
}

fn out_of_range(name: &str, value: f64, low: f64, high: f64) -> Failure {
    let message = format!("{name} {value} is outside {low} to {high}");
    Failure::new(Code::InvalidOptionValue, message, "give a value inside")
}
