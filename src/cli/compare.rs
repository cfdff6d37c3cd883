//! `graphfix compare`: positions one recording in several modes and writes a report.

use std::fs::File;
use std::io::{BufReader, IsTerminal};
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Instant;

use clap::Args;

use crate::config::{Mode, PositioningOptions, Profile};
use crate::evaluation::Truth;
use crate::evaluation::comparison::{Comparison, Method};
use crate::formats::{decompress, truth};
use crate::gnss::{Ecef, Epoch, GpsTime};
use crate::recording::{AnswerKind, Recording, RecordingError, RecordingInputs, Solutions};
use crate::refusal::Code;

use super::Failure;
use super::evaluate::Triple;
use super::option_arguments::{assignments, check_as_computed};
use super::output::print;
use super::recording::RecordingArguments;

/// Largest number of methods of one report: more lines cannot be distinguished in a plot.
const METHODS_MAX: usize = 7;

/// Positions one recording in several modes and writes their errors and tracks as one HTML page.
///
/// The page has Table 1 and Figure 5 of Wen & Hsu (2021), with a base also Table 2 and Figure 6.
/// It needs no other file. Without a truth it compares the methods with each other.
#[derive(Debug, Args)]
pub(crate) struct CompareArguments {
    #[command(flatten)]
    recording: RecordingArguments,
    /// Methods to compare, separated by commas: MODE, MODE:WAY, MODE@PROFILE or MODE:WAY@PROFILE,
    /// where WAY is causal, smoothed or batch.
    #[arg(long, value_name = "METHOD,METHOD…", value_delimiter = ',', required = true)]
    modes: Vec<MethodName>,
    /// Profile of the methods that name none.
    #[arg(long, value_name = "NAME", default_value = "general")]
    profile: String,
    /// Overrides one option of every method, as in ionosphere=none; may be repeated.
    #[arg(long, value_name = "KEY=VALUE", allow_hyphen_values = true)]
    set: Vec<String>,
    /// Length of the sliding window, in modes that have one (s).
    #[arg(long, value_name = "SECONDS")]
    window: Option<String>,
    /// Truth: CSV of gps_week,tow,lat_deg,lon_deg,height_m or gps_week,tow,x_m,y_m,z_m.
    #[arg(long, value_name = "FILE", conflicts_with = "static_ecef")]
    truth: Option<PathBuf>,
    /// One true position instead: ECEF (m).
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    static_ecef: Option<Triple>,
    /// Largest error of a correct fix (m).
    #[arg(long, value_name = "M", default_value_t = 0.10)]
    fix_tol: f64,
    /// Report to write; the name ends in .html.
    #[arg(long, value_name = "REPORT.html")]
    output: PathBuf,
}

/// A method as written on the command line.
#[derive(Clone, Debug, PartialEq, Eq)]
struct MethodName {
    mode: String,
    answer: AnswerKind,
    profile: Option<String>,
}

impl FromStr for MethodName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let (rest, profile) = match text.split_once('@') {
            Some((rest, profile)) => (rest, Some(profile.to_owned())),
            None => (text, None),
        };
        let (mode, answer) = match rest.split_once(':') {
            Some((mode, answer)) => (mode, answer),
            None => (rest, AnswerKind::Causal.name()),
        };
        let answer = AnswerKind::from_name(answer).ok_or_else(|| {
            format!("{answer:?} is not a kind of answer; allowed: causal, smoothed, batch")
        })?;
        Ok(Self { mode: mode.to_owned(), answer, profile })
    }
}

/// Runs the command; prints the first table on standard output.
pub(crate) fn run(arguments: &CompareArguments) -> Result<(), Failure> {
    check_as_computed(&arguments.set)?;
    let inputs = arguments.recording.inputs();
    let truth = arguments.truth(&inputs)?;
    if arguments.output.extension().is_none_or(|ending| ending != "html") {
        let message = format!("{} does not end in .html", arguments.output.display());
        return Err(Failure::new(Code::UnknownOutputFormat, message, "end the name in .html"));
    }
    if METHODS_MAX < arguments.modes.len() {
        let message = format!("{} methods are too many for one page", arguments.modes.len());
        let remedy = format!("name at most {METHODS_MAX}");
        return Err(Failure::new(Code::Usage, message, remedy));
    }
    let options: Result<Vec<_>, _> =
        arguments.modes.iter().map(|method| arguments.options(method, &inputs)).collect();
    let mut methods = Vec::new();
    for (name, options) in arguments.modes.iter().zip(options?) {
        if std::io::stderr().is_terminal() {
            eprint!("\r\x1b[K{} {}", name.mode, name.answer.name());
        }
        methods.push(solve(&inputs, name, options)?);
    }
    if std::io::stderr().is_terminal() {
        eprint!("\r\x1b[K");
    }
    let file = arguments.recording.rover.file_name().unwrap_or_default();
    let title = file.to_string_lossy().into_owned();
    let command = std::env::args().collect::<Vec<_>>().join(" ");
    let comparison = Comparison::new(title, command, methods, truth.as_ref(), arguments.fix_tol);
    let unwritable = |error: &dyn std::fmt::Display| {
        let message = format!("cannot write {}: {error}", arguments.output.display());
        Failure::of(Code::FileNotWritable, message)
    };
    let page = comparison.html().map_err(|error| unwritable(&error))?;
    std::fs::write(&arguments.output, page).map_err(|error| unwritable(&error))?;
    print(&table(&comparison))
}

impl CompareArguments {
    fn truth(&self, inputs: &RecordingInputs) -> Result<Option<Truth>, Failure> {
        if let Some(Triple([x, y, z])) = self.static_ecef {
            return Ok(Some(Truth::Static(Ecef::new(x, y, z))));
        }
        let Some(path) = &self.truth else { return Ok(None) };
        let file = File::open(path).map_err(|error| {
            let message = format!("cannot open {}: {error}", path.display());
            Failure::of(Code::FileNotReadable, message)
        })?;
        // Rows of the truth with week −1 belong to the week of the recording.
        let mut epoch = Epoch::new(GpsTime::EPOCH);
        if !Recording::open(inputs)?.read_epoch(&mut epoch)? {
            let name = inputs.rover.name().to_owned();
            return Err(RecordingError::NoEpochs { name }.into());
        }
        let rows = truth::read(decompress(BufReader::new(file)), epoch.time.week());
        rows.map(|rows| Some(Truth::Trajectory(rows))).map_err(|error| {
            let message = format!("{}: {error}", path.display());
            Failure::of(Code::FileMalformed, message)
        })
    }

    fn options(
        &self,
        method: &MethodName,
        inputs: &RecordingInputs,
    ) -> Result<PositioningOptions, Failure> {
        let profile = method.profile.as_ref().unwrap_or(&self.profile);
        let mode = Mode::parse(&method.mode)?;
        let mut options = PositioningOptions::new(mode, Profile::parse(profile)?);
        inputs.check(&options, method.answer)?;
        for (key, value) in assignments(&self.set)? {
            options.set(key, value)?;
        }
        if let Some(window) = self.window.as_ref().filter(|_| mode.has_window()) {
            options.set("window_s", window)?;
        }
        Ok(options)
    }
}

fn solve(
    inputs: &RecordingInputs,
    name: &MethodName,
    options: PositioningOptions,
) -> Result<Method, Failure> {
    let began = Instant::now();
    let changed = options.entries().into_iter().filter(|entry| entry.value != entry.default);
    let overrides = changed.map(|entry| (entry.name.to_owned(), entry.value)).collect();
    let (profile, configuration_hash) =
        (options.profile.name().to_owned(), options.configuration_hash());
    let solutions = Solutions::open(inputs, options, name.answer)?;
    let mut solutions = solutions.collect::<Result<Vec<_>, _>>()?;
    solutions.sort_by_key(|solution| solution.time);
    Ok(Method {
        mode: name.mode.clone(),
        answer: name.answer.name().to_owned(),
        profile,
        configuration_hash,
        overrides,
        solutions,
        elapsed_s: began.elapsed().as_secs_f64(),
    })
}

/// One line for each method: its errors, or its number of epochs without a truth.
fn table(comparison: &Comparison) -> String {
    let mut text = String::new();
    for (index, method) in comparison.methods.iter().enumerate() {
        text += &format!("{:<20}{:<15}", method.name(), method.profile);
        let errors = comparison.judgements.get(index).map(|judgement| &judgement.report);
        text += &match errors.and_then(|report| report.errors.as_ref().zip(report.availability)) {
            Some((errors, availability)) => format!(
                "2D mean {:.3}, std {:.3}, max {:.3} m, available {:.1} %",
                errors.err2d.mean,
                errors.err2d.std,
                errors.err2d.max,
                100.0 * availability
            ),
            None => format!("{} epochs", method.solutions.len()),
        };
        text += "\n";
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn methods_as_users_write_them() {
        let named = |text: &str| text.parse::<MethodName>().unwrap();
        let method = |mode: &str, answer, profile: Option<&str>| MethodName {
            mode: mode.to_owned(),
            answer,
            profile: profile.map(str::to_owned),
        };
        assert_eq!(named("spp"), method("spp", AnswerKind::Causal, None));
        assert_eq!(named("fgo:batch"), method("fgo", AnswerKind::Batch, None));
        assert_eq!(named("fgo@paper"), method("fgo", AnswerKind::Causal, Some("paper")));
        let smoothed = method("fgo", AnswerKind::FixedLag, Some("urban-vehicle"));
        assert_eq!(named("fgo:smoothed@urban-vehicle"), smoothed);
        assert!("fgo:later".parse::<MethodName>().unwrap_err().contains("allowed: causal"));
    }
}
