//! `graphfix evaluate`: a solution file against the truth.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;

use super::Failure;
use super::output::{note, print};
use crate::evaluation::plot::{self, PlotError};
use crate::evaluation::{
    Criteria, ErrorStatistics, Expected, Judgement, MatchedReport, Report, Truth, judge,
};
use crate::formats::observations::{Observations, Recognised};
use crate::formats::track::read_positions;
use crate::formats::{decompress, truth};
use crate::gnss::{Ecef, Enu, Epoch, Geodetic, GpsTime, Navigation};
use crate::refusal::Code;

/// Judges a solution file against the truth: errors, availability, fixes, consistency of the
/// covariance.
#[derive(Debug, Args)]
pub(crate) struct EvaluateArguments {
    /// Solution: RTKLIB .pos, or CSV of Graphfix.
    #[arg(long, value_name = "FILE")]
    solution: PathBuf,
    /// Truth: CSV of gps_week,tow,lat_deg,lon_deg,height_m or gps_week,tow,x_m,y_m,z_m.
    #[arg(long, value_name = "FILE", required_unless_present_any = ["static_ecef", "static_place"],
          conflicts_with_all = ["static_ecef", "static_place"])]
    truth: Option<PathBuf>,
    /// One fixed true position instead: ECEF (m).
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, conflicts_with = "static_place")]
    static_ecef: Option<Triple>,
    /// One fixed true position instead: degrees, degrees, ellipsoidal metres.
    #[arg(long = "static", value_name = "LAT,LON,H", allow_hyphen_values = true)]
    static_place: Option<Triple>,
    /// First second of week to evaluate (s).
    #[arg(long, value_name = "TOW", alias = "start")]
    from: Option<f64>,
    /// Last second of week to evaluate (s). One before the first is of the next week.
    #[arg(long, value_name = "TOW", alias = "end")]
    to: Option<f64>,
    /// Rover observations (RINEX, UBX or GnssLogger log): their epochs are the expected ones.
    #[arg(long, value_name = "FILE", conflicts_with = "expect")]
    obs: Option<PathBuf>,
    /// Number of expected epochs.
    #[arg(long, value_name = "N")]
    expect: Option<usize>,
    /// Vector from the reference point to the antenna (m).
    #[arg(long, value_name = "E,N,U", allow_hyphen_values = true)]
    lever: Option<Triple>,
    /// Largest time difference to the nearest truth, where interpolation is impossible (s).
    #[arg(long, value_name = "S", default_value_t = 0.02)]
    tol: f64,
    /// Longest gap of the truth that is interpolated (s).
    #[arg(long, value_name = "S", default_value_t = 1.5)]
    max_gap: f64,
    /// Offset added to the times of the solution (s).
    #[arg(long, value_name = "S", default_value_t = 0.0, allow_hyphen_values = true)]
    shift: f64,
    /// Evaluate only these quality numbers, as in 1,2.
    #[arg(long, value_name = "Q,Q", value_delimiter = ',')]
    q: Vec<i64>,
    /// Largest error of a correct fix (m).
    #[arg(long, value_name = "M", default_value_t = 0.10)]
    fix_tol: f64,
    /// Prints JSON.
    #[arg(long)]
    json: bool,
    /// Plot of track, errors over time and their distribution; the name ends in .svg or .png.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
}

/// Three numbers separated by commas.
#[derive(Clone, Copy, Debug)]
pub(super) struct Triple(pub(super) [f64; 3]);

impl std::str::FromStr for Triple {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let wrong = || format!("{text:?} is not three numbers separated by commas");
        let parse = |part: &str| part.trim().parse().ok().filter(|v: &f64| v.is_finite());
        let numbers: Option<Vec<f64>> = text.split(',').map(parse).collect();
        let numbers = numbers.ok_or_else(wrong)?;
        numbers.try_into().map(Self).map_err(|_| wrong())
    }
}

/// The JSON output: the report under the name of its file.
#[derive(Serialize)]
struct Answer<'a> {
    file: String,
    #[serde(flatten)]
    report: &'a Report,
}

/// Judges the file and prints the report.
pub(crate) fn run(arguments: &EvaluateArguments) -> Result<(), Failure> {
    let solution = read_positions(open(&arguments.solution)?)
        .map_err(|error| unreadable(&arguments.solution, &error))?;
    if !solution.unreadable.is_empty() {
        note!(
            "warning: {}: {} unreadable lines left out, the first of them line {}",
            arguments.solution.display(),
            solution.unreadable.len(),
            solution.unreadable[0]
        );
    }
    let first = solution.rows.iter().map(|row| row.time).min();
    let unknown_week = first.map_or(0, |time| (time + arguments.shift).week());
    let truth = arguments.truth(unknown_week)?;
    let judgement = judge(&solution.rows, truth, &arguments.criteria()?);
    let file = arguments.solution.display().to_string();
    if let Some(path) = &arguments.plot {
        plot::write(path, &file, &judgement).map_err(plot_failure)?;
    }
    let text = if arguments.json {
        let answer = Answer { file, report: &judgement.report };
        serde_json::to_string_pretty(&answer).expect("numbers and texts serialise") + "\n"
    } else {
        table(&file, &judgement)
    };
    print(&text)
}

impl EvaluateArguments {
    fn truth(&self, unknown_week: i32) -> Result<Truth, Failure> {
        if let Some(Triple([x, y, z])) = self.static_ecef {
            return Ok(Truth::Static(Ecef::new(x, y, z)));
        }
        if let Some(Triple([latitude, longitude, height_m])) = self.static_place {
            let place = Geodetic::from_degrees(latitude, longitude, height_m);
            return Ok(Truth::Static(place.to_ecef()));
        }
        let path = self.truth.as_ref().expect("clap asks for one of the three");
        let rows = truth::read(open(path)?, unknown_week);
        rows.map(Truth::Trajectory).map_err(|error| unreadable(path, &error))
    }

    fn criteria(&self) -> Result<Criteria, Failure> {
        let expected = match (&self.obs, self.expect) {
            (Some(path), _) => Expected::RoverEpochs(rover_epochs(path)?),
            (None, Some(count)) => Expected::Count(count),
            (None, None) => Expected::Reference,
        };
        Ok(Criteria {
            window_tow_s: (
                self.from.unwrap_or(f64::NEG_INFINITY),
                self.to.unwrap_or(f64::INFINITY),
            ),
            tolerance_s: self.tol,
            max_gap_s: self.max_gap,
            shift_s: self.shift,
            lever: self.lever.map(|Triple(enu)| Enu(enu.into())),
            qualities: self.q.clone(),
            fix_tolerance_m: self.fix_tol,
            expected,
        })
    }
}

fn rover_epochs(path: &Path) -> Result<Vec<GpsTime>, Failure> {
    let file = Recognised::new(decompress(open(path)?));
    let mut reader = Observations::new(file, None, &Navigation::default())
        .map_err(|error| unreadable(path, &error))?;
    let (mut times, mut epoch) = (Vec::new(), Epoch::new(GpsTime::EPOCH));
    while reader.read_epoch(&mut epoch).map_err(|error| unreadable(path, &error))? {
        times.push(epoch.time);
    }
    // The epochs after the damage are missing from the list, and would not be expected.
    if let Some(damage) = reader.left_out().damage {
        let message = format!("{}: {damage}", path.display());
        return Err(Failure::of(Code::FileMalformed, message));
    }
    Ok(times)
}

fn open(path: &Path) -> Result<BufReader<File>, Failure> {
    let file = File::open(path).map_err(|error| {
        let message = format!("cannot open {}: {error}", path.display());
        Failure::of(Code::FileNotReadable, message)
    })?;
    Ok(BufReader::with_capacity(1 << 16, file))
}

fn unreadable(path: &Path, error: &dyn std::error::Error) -> Failure {
    let message = format!("{}: {error}", path.display());
    Failure::of(Code::FileMalformed, message)
}

fn plot_failure(error: PlotError) -> Failure {
    match error {
        PlotError::Empty => Failure::of(Code::NothingToPlot, error),
        PlotError::UnknownFormat(_) => {
            Failure::new(Code::UnknownOutputFormat, error, "name a file that ends in .svg or .png")
        }
        PlotError::Draw(_) | PlotError::Write { .. } => Failure::of(Code::FileNotWritable, error),
    }
}

/// The report as text.
fn table(file: &str, judgement: &Judgement) -> String {
    let report = &judgement.report;
    let Some(errors) = &report.errors else {
        return format!("{file}\n  no epoch matches the truth ({} expected)\n", report.expected);
    };
    let percent = |share: Option<f64>| share.map_or("-".into(), |s| format!("{:.2} %", 100.0 * s));
    let mut text = format!(
        "{file}\n  {} of {} epochs (availability {}), tow {:.3} to {:.3}, {} without truth\n",
        report.matched,
        report.expected,
        percent(report.availability),
        errors.first_tow,
        errors.last_tow,
        report.unmatched_solutions,
    );
    text += &format!(
        "  {:<10}{:>9}{:>9}{:>9}{:>9}{:>9}{:>9}{:>9}\n",
        "error (m)", "mean", "std", "rms", "50 %", "68 %", "95 %", "max"
    );
    for (name, s) in [("2D", &errors.err2d), ("|up|", &errors.err_up), ("3D", &errors.err3d)] {
        text += &statistics_row(name, s);
    }
    text += &bias_row(errors);
    // The limits are texts, in the order of texts.
    let mut within: Vec<_> = errors.within.iter().collect();
    within.sort_by(|(a, _), (b, _)| metres(a).total_cmp(&metres(b)));
    let shares = within.into_iter().map(|(limit, [plane, space])| {
        format!("{limit} m {:.1}, {:.1} %", 100.0 * plane, 100.0 * space)
    });
    text += &format!("  within (2D, 3D): {}\n", shares.collect::<Vec<_>>().join("; "));
    if let Some(stated) = &errors.uncertainty {
        text += &format!(
            "  inside the stated 95 % ellipse: 2D {}, 3D {}; normalised error 2D {:.2}, 3D {:.2}\n",
            percent(Some(stated.inside_95_2d)),
            percent(Some(stated.inside_95_3d)),
            stated.normalised_rms_2d,
            stated.normalised_rms_3d,
        );
    }
    let counts = errors.q_counts.iter().map(|(quality, count)| format!("Q{quality} {count}"));
    text += &format!("  {}\n", counts.collect::<Vec<_>>().join(", "));
    if let Some(fixes) = &errors.fix.errors {
        text += &format!(
            "  fixed {} of solutions, {} of expected; correct {} (3D), {} (2D); beyond 0.5 m {}; \
             first after {:.1} s\n",
            percent(Some(errors.fix.rate_of_solutions)),
            percent(errors.fix.rate_of_expected),
            percent(Some(fixes.correct_3d)),
            percent(Some(fixes.correct_2d)),
            percent(Some(fixes.wrong_3d_gt_0p5)),
            fixes.ttff_s,
        );
        text += &statistics_row("fixed 2D", &fixes.err2d);
        text += &statistics_row("fixed 3D", &fixes.err3d);
    }
    text
}

/// A limit of the report (m).
fn metres(limit: &str) -> f64 {
    limit.parse().unwrap_or(f64::NAN)
}

fn statistics_row(name: &str, s: &ErrorStatistics) -> String {
    let values = [s.mean, s.std, s.rms, s.p50, s.p68, s.p95, s.max];
    let cells: String = values.iter().map(|value| format!("{value:>9.3}")).collect();
    format!("  {name:<10}{cells}\n")
}

fn bias_row(errors: &MatchedReport) -> String {
    let ([e, n, u], [me, mn, mu]) = (errors.bias_enu_mean, errors.bias_enu_median);
    format!("  east, north, up: mean {e:.3}, {n:.3}, {u:.3}; median {me:.3}, {mn:.3}, {mu:.3}\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triples() {
        assert_eq!("-1, 2.5,3e3".parse::<Triple>().unwrap().0, [-1.0, 2.5, 3000.0]);
        for wrong in ["1,2", "1,2,3,4", "1,2,x", "1,2,nan"] {
            assert!(wrong.parse::<Triple>().is_err(), "{wrong}");
        }
    }
}
