//! `graphfix solve`: a file of observations in, a file of positions out.

use std::fs::File;
use std::io::{self, BufWriter, IsTerminal};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Args;

use crate::app;
use crate::config::PositioningOptions;
use crate::formats::result::ResultFormat;
use crate::formats::track::TrackFormat;
use crate::gnss::{Ecef, FrameRefusal, LeapSeconds, Presentation, Solution};
use crate::recording::{
    AnswerKind, ExportError, Input, Provenance, Recording, RecordingInputs, SolutionWriter,
    Solutions, Tally, comments_of,
};
use crate::refusal::Code;

use super::Failure;
use super::option_arguments::OptionArguments;
use super::output::print;
use super::recording::RecordingArguments;
use super::solve_report::SolveReport;

const WRITE_BUFFER_BYTES: usize = 1 << 16;
/// The value of `--window` for all epochs at once.
const BATCH: &str = "batch";
/// Epochs between two readings of the clock for the progress line.
const PROGRESS_EPOCHS: u64 = 1_000;
/// Least time between two progress lines.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(200);

/// Positions a file of observations, without a server or a database.
///
/// Reads RINEX 2 to 4, CRINEX, UBX, RTCM 3 and Android GnssLogger logs, also packed with gzip. The
/// times of the solution are the receiver's epoch tags.
#[derive(Debug, Args)]
pub(crate) struct SolveArguments {
    #[command(flatten)]
    recording: RecordingArguments,
    #[command(flatten)]
    options: OptionArguments,
    /// Length of the window in seconds, in modes that have one; or `batch` for all epochs at once.
    #[arg(long, value_name = "SECONDS|batch")]
    window: Option<String>,
    /// Write the smoothed solution of each epoch, computed when the epoch leaves the window.
    #[arg(long)]
    smoothed: bool,
    /// Frame of the positions: native (WGS 84, or the base's frame) or ETRS89.
    #[arg(long, value_name = "FRAME")]
    frame: Option<String>,
    /// Frame and epoch of the base's coordinates, as ETRF2000 or ITRF2014@2010.0.
    #[arg(long, value_name = "FRAME[@YEAR]", requires = "base")]
    base_frame: Option<String>,
    /// Table of the geoid's heights (PGM of GeographicLib, GTX or ISG, also packed with gzip):
    /// heights above the geoid are written, too.
    #[arg(long, value_name = "FILE")]
    geoid: Option<PathBuf>,
    /// File to write; its name ends in .pos, .csv, .geojson, .kml, .gpx, .nmea or .parquet, or in
    /// .rnx or .obs for the rover's observations as RINEX. Default: the rover's file with .pos in
    /// place of its ending, if there is no such file yet.
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Report to write beside it, one HTML page with figures; the name ends in .html.
    #[arg(long, value_name = "REPORT.html")]
    report: Option<PathBuf>,
}

/// Runs the command; prints the summary on standard output.
pub(crate) fn run(arguments: &SolveArguments) -> Result<(), Failure> {
    let began = Instant::now();
    let options = arguments.options()?;
    let presentation = arguments.presentation(&options)?;
    let inputs = arguments.recording.inputs();
    let comments = comments_of(&options);
    let mut solutions = Solutions::open(&inputs, options.clone(), arguments.answer_kind())?;
    let leap_seconds = solutions.leap_seconds();
    let path = arguments.output()?;
    let mut report = arguments.report.as_deref().map(SolveReport::new).transpose()?;
    let mut output = arguments.begun(&path, &comments, leap_seconds, presentation)?;
    let mut position = None;
    let mut tally = Tally::default();
    let mut progress = Progress::new(began);
    for solution in &mut solutions {
        let solution = solution.inspect_err(|_| progress.clear())?;
        let foreign = output.write(&solution).map_err(|error| unwritable(&path, &error))?;
        tally.add(&solution, foreign);
        position = position.or(solution.estimate.as_ref().map(|estimate| estimate.position));
        if let Some(report) = &mut report {
            report.add(&solution);
        }
        progress.show(&tally);
    }
    output.finish((&path, solutions.recording()), position)?;
    progress.clear();
    let (provenance, elapsed) = (solutions.provenance(), began.elapsed());
    let mut summary = summary(&tally, &provenance, elapsed);
    summary += &format!("written to {}\n", path.display());
    if let Some(report) = report {
        let facts = facts(&inputs, &options, arguments.answer_kind());
        report.write(facts, &tally, &provenance, elapsed)?;
        summary += &format!("report in {}\n", report.path().display());
    }
    print(&summary)
}

impl SolveArguments {
    /// The options from the arguments, with `--window`.
    fn options(&self) -> Result<PositioningOptions, Failure> {
        let mut options = self.options.options(self.recording.has_base())?;
        if !options.mode.has_window() && (self.window.is_some() || self.smoothed) {
            let message = format!("mode {} has no window", options.mode.name());
            return Err(Failure::new(Code::Usage, message, "add --mode fgo"));
        }
        if let Some(window) = self.window.as_deref().filter(|window| *window != BATCH) {
            options.set("window_s", window)?;
        }
        for (name, value) in [("frame", &self.frame), ("base_frame", &self.base_frame)] {
            value.as_ref().map_or(Ok(()), |value| options.set(name, value))?;
        }
        options.output.geoid |= self.geoid.is_some();
        Ok(options)
    }

    /// How solutions are written.
    fn presentation(&self, options: &PositioningOptions) -> Result<Presentation, Failure> {
        let table = |path: &PathBuf| {
            app::geoid_table(path).map_err(|error| Failure::of(error.code(), error))
        };
        let geoid = self.geoid.as_ref().map(table).transpose()?;
        if options.output.geoid && geoid.is_none() {
            let message = "no table of the geoid is named";
            return Err(Failure::new(Code::GeoidMissing, message, "add --geoid FILE"));
        }
        Ok(options.output.presentation(geoid.as_ref()))
    }

    /// The file to write, in the format of its name's ending.
    fn begun(
        &self,
        path: &Path,
        comments: &[String],
        leap: LeapSeconds,
        presentation: Presentation,
    ) -> Result<Output, Failure> {
        let format = ResultFormat::from_ending(ending(path)).ok_or_else(|| {
            let message = format!("{} does not name a format", path.display());
            let remedy =
                "end the name in .pos, .csv, .geojson, .kml, .gpx, .nmea, .parquet, .rnx or .obs";
            Failure::new(Code::UnknownOutputFormat, message, remedy)
        })?;
        let is_input = |input: &Path| {
            let same = input.canonicalize().ok().zip(path.canonicalize().ok());
            same.is_some_and(|(input, output)| input == output)
        };
        if self.recording.files().any(is_input) {
            let message = format!("{} is an input", path.display());
            return Err(Failure::new(Code::FileNotWritable, message, "name another file"));
        }
        if format != ResultFormat::Rinex {
            return Ok(Output::Positions(create(path, comments, leap, presentation)?));
        }
        let file = File::create(path).map_err(|error| unwritable(path, &error))?;
        Ok(Output::Observations(BufWriter::with_capacity(WRITE_BUFFER_BYTES, file)))
    }

    /// The file to write. Only a file that is named is replaced.
    fn output(&self) -> Result<PathBuf, Failure> {
        if let Some(named) = &self.output {
            return Ok(named.clone());
        }
        let path = beside(&self.recording.rover);
        if path.exists() {
            let message = format!("{} exists", path.display());
            return Err(Failure::new(Code::FileExists, message, "name a file by --output"));
        }
        Ok(path)
    }

    fn answer_kind(&self) -> AnswerKind {
        match (self.window.as_deref(), self.smoothed) {
            (Some(BATCH), _) => AnswerKind::Batch,
            (_, true) => AnswerKind::FixedLag,
            (_, false) => AnswerKind::Causal,
        }
    }
}

/// The rows of the report about what was computed and from which files.
fn facts(
    inputs: &RecordingInputs,
    options: &PositioningOptions,
    answer: AnswerKind,
) -> Vec<(&'static str, String)> {
    let navigation: Vec<_> = inputs.navigation.iter().map(Input::name).collect();
    let ephemerides = match navigation.is_empty() {
        true => "those in the files of rover and base".to_owned(),
        false => navigation.join("; "),
    };
    let base = inputs.base.as_ref().map(|base| base.name().to_owned());
    [
        ("Mode", Some(options.mode.name().to_owned())),
        ("Profile", Some(options.profile.name().to_owned())),
        ("Answers", Some(answer.name().to_owned())),
        ("Rover", Some(inputs.rover.name().to_owned())),
        ("Base", base),
        ("Ephemerides", Some(ephemerides)),
        ("Configuration", Some(options.configuration_hash())),
    ]
    .into_iter()
    .filter_map(|(name, value)| Some((name, value?)))
    .collect()
}

/// The ending of a file's name, empty where it has none.
fn ending(path: &Path) -> &str {
    path.extension().and_then(|ending| ending.to_str()).unwrap_or_default()
}

/// The path beside the rover's observations, with `.pos` in place of the ending (and of `.gz`).
fn beside(rover: &Path) -> PathBuf {
    let packed = rover.extension().is_some_and(|ending| ending == "gz");
    let named = if packed { rover.with_extension("") } else { rover.to_owned() };
    named.with_extension("pos")
}

pub(super) fn unwritable(path: &Path, error: &std::io::Error) -> Failure {
    let message = format!("cannot write {}: {error}", path.display());
    Failure::of(Code::FileNotWritable, message)
}

/// The solution file, in the format of its name's ending.
pub(super) fn create(
    path: &Path,
    comments: &[String],
    leap: LeapSeconds,
    presentation: Presentation,
) -> Result<SolutionWriter<BufWriter<File>>, Failure> {
    let format = TrackFormat::from_name(ending(path)).ok_or_else(|| {
        let message = format!("{} does not name a format", path.display());
        let remedy = "end the name in .pos, .csv, .geojson, .kml, .gpx, .nmea or .parquet";
        Failure::new(Code::UnknownOutputFormat, message, remedy)
    })?;
    if !format.is_built() {
        return Err(Failure::of(Code::FeatureNotBuilt, format.not_built()));
    }
    let file = File::create(path)
        .map(|file| BufWriter::with_capacity(WRITE_BUFFER_BYTES, file))
        .and_then(|file| SolutionWriter::new(file, format, comments, leap, presentation));
    file.map_err(|error| unwritable(path, &error))
}

/// What the command writes.
enum Output {
    /// Positions, each as soon as it is computed.
    Positions(SolutionWriter<BufWriter<File>>),
    /// The rover's observations, written at the end.
    Observations(BufWriter<File>),
}

impl Output {
    /// Writes one solution. Returns why its position is not in the requested frame, if it is not.
    fn write(&mut self, solution: &Solution) -> io::Result<Option<FrameRefusal>> {
        match self {
            Self::Positions(writer) => writer.write(solution),
            Self::Observations(_) => Ok(None),
        }
    }

    /// Completes the file. `position` is the rover's first position (m).
    fn finish(
        self,
        (path, recording): (&Path, &Recording<'_>),
        position: Option<Ecef>,
    ) -> Result<(), Failure> {
        let file = match self {
            Self::Positions(writer) => {
                return writer.finish().map(drop).map_err(|error| unwritable(path, &error));
            }
            Self::Observations(file) => file,
        };
        let failure = |error| match error {
            ExportError::Read(error) => error.into(),
            ExportError::Write(error) => unwritable(path, &error),
        };
        let mut export = recording.export(file, position)?;
        while export.step().map_err(failure)? {}
        export.finish().map(drop).map_err(failure)
    }
}

/// A line on standard error with the number of epochs so far, on terminals only.
struct Progress {
    began: Instant,
    shown: Instant,
    is_terminal: bool,
}

impl Progress {
    fn new(began: Instant) -> Self {
        Self { began, shown: began, is_terminal: std::io::stderr().is_terminal() }
    }

    fn show(&mut self, tally: &Tally) {
        let is_due = self.is_terminal
            && tally.epochs.is_multiple_of(PROGRESS_EPOCHS)
            && PROGRESS_INTERVAL <= self.shown.elapsed();
        if is_due {
            self.shown = Instant::now();
            let seconds = self.began.elapsed().as_secs_f64();
            eprint!("\r{} epochs, {} answered, {seconds:.1} s", tally.epochs, tally.answered);
        }
    }

    fn clear(&self) {
        if self.shown != self.began {
            eprint!("\r\x1b[K");
        }
    }
}

/// The closing lines: epochs, speed, reasons, skipped content of the files, provenance of the
/// positions.
fn summary(tally: &Tally, provenance: &Provenance, elapsed: Duration) -> String {
    let seconds = elapsed.as_secs_f64();
    let mut text = format!(
        "{} epochs, {} answered, {} without position; {seconds:.3} s, {:.0} epochs/s\n",
        tally.epochs,
        tally.answered,
        tally.epochs - tally.answered,
        tally.epochs as f64 / seconds,
    );
    for (code, count) in &tally.reasons {
        text += &format!("  {code}: {count} epochs\n");
    }
    for (name, left_out) in &provenance.left_out {
        for line in left_out.to_string().lines() {
            text += &format!("  {name}: {line}\n");
        }
    }
    for line in provenance.lines() {
        text += &format!("  {line}\n");
    }
    text
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        solve: SolveArguments,
    }

    fn code(mode: &str, further: &[&str]) -> Option<Code> {
        let fixed = ["solve", "--rover", "r", "--nav", "n", "--output", "o.pos", "--mode", mode];
        let line = Line::try_parse_from(fixed.iter().chain(further)).unwrap();
        line.solve.options().err().map(|failure| failure.code())
    }

    #[test]
    fn the_output_stands_beside_the_rover() {
        for (rover, output) in
            [("a/r.obs", "a/r.pos"), ("r.24o.gz", "r.pos"), ("log.ubx", "log.pos"), ("r", "r.pos")]
        {
            assert_eq!(beside(Path::new(rover)), Path::new(output));
        }
    }

    #[test]
    fn a_frame_and_a_geoid_are_options() {
        assert_eq!(code("fgo", &["--frame", "ETRS89"]), None);
        assert_eq!(code("fgo", &["--frame", "WGS84"]), Some(Code::InvalidOptionValue));
        let based = ["--base", "b", "--base-frame"];
        assert_eq!(code("rtk-fgo", &[&based[..], &["ITRF2014@2010"]].concat()), None);
        let unknown = [&based[..], &["LOCAL"]].concat();
        assert_eq!(code("rtk-fgo", &unknown), Some(Code::InvalidOptionValue));
        let line = ["solve", "--rover", "r", "--set", "geoid=on"];
        let solve = Line::try_parse_from(line).unwrap().solve;
        let failure = solve.presentation(&solve.options().unwrap()).unwrap_err();
        assert_eq!(failure.code(), Code::GeoidMissing);
    }

    #[test]
    fn a_window_is_for_the_factor_graph() {
        for mode in ["spp", "ekf"] {
            assert_eq!(code(mode, &["--window", "30"]), Some(Code::Usage));
            assert_eq!(code(mode, &["--window", "batch"]), Some(Code::Usage));
            assert_eq!(code(mode, &["--smoothed"]), Some(Code::Usage));
        }
        assert_eq!(code("fgo", &["--window", "30", "--smoothed"]), None);
    }
}
