//! `graphfix evaluate` against the independent judge `evaluate.py` on the same files.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

use crate::support::{data, python};

/// Required relative agreement of every number.
const RELATIVE: f64 = 1e-6;
/// Rounding errors of the judge (m, s): it counts seconds since 1980 in a double, with steps of
/// 0.24 µs, which move a car's interpolated reference by some micrometres.
const ABSOLUTE: f64 = 1e-5;

/// The judge beside the data folder; `None` (noted) if it or its Python is absent.
fn judge() -> Option<Command> {
    let python = python::with("numpy")?;
    let script = data::root().0.join("../tools/evaluate.py");
    if !script.is_file() {
        data::note_missing("../tools/evaluate.py beside the data sets");
        return None;
    }
    let mut judge = Command::new(python);
    judge.arg(script);
    Some(judge)
}

fn json(command: &mut Command) -> Value {
    let output = command.output().expect("the program can be started");
    let complaint = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{complaint}");
    serde_json::from_slice(&output.stdout).expect("the answer is JSON")
}

/// Checks that every member of `theirs` is in `ours` with the same value. Ours may have more
/// members.
fn assert_covers(ours: &Value, theirs: &Value, at: &str) -> usize {
    match (ours, theirs) {
        (Value::Object(ours), Value::Object(theirs)) => theirs
            .iter()
            .map(|(key, value)| {
                let own = ours.get(key).unwrap_or_else(|| panic!("{at}.{key} is missing"));
                assert_covers(own, value, &format!("{at}.{key}"))
            })
            .sum(),
        (Value::Array(ours), Value::Array(theirs)) => {
            assert_eq!(ours.len(), theirs.len(), "{at}");
            ours.iter().zip(theirs).map(|(a, b)| assert_covers(a, b, at)).sum()
        }
        (Value::Number(a), Value::Number(b)) => {
            let (a, b) = (a.as_f64().unwrap(), b.as_f64().unwrap());
            assert!((a - b).abs() <= RELATIVE * b.abs() + ABSOLUTE, "{at}: {a} against {b}");
            1
        }
        (a, b) => {
            assert_eq!(a, b, "{at}");
            0
        }
    }
}

/// Runs both judges on the same files; returns how many numbers agreed.
fn compare(mut judge: Command, solution: &Path, ours: &[String], theirs: &[String]) -> usize {
    let own = json(
        Command::new(env!("CARGO_BIN_EXE_graphfix"))
            .args(["evaluate", "--json", "--solution"])
            .arg(solution)
            .args(ours),
    );
    let other = json(judge.arg(solution).args(theirs).arg("--json"));
    assert_covers(&own, &other, "")
}

/// A small generator of reproducible numbers in −0.5 … 0.5 (Knuth's MMIX constants).
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    }
}

/// Writes a truth of 600 s with a gap, and a solution at times between those of the truth. The
/// solution has all qualities, outliers, rows without truth, two rows of one time, and a broken
/// row.
fn synthetic(folder: &Path) -> (PathBuf, PathBuf) {
    let mut numbers = Numbers(7);
    let mut truth = "# made up\ngps_week,tow,lat_deg,lon_deg,height_m\n".to_owned();
    for second in (0..600).filter(|s| !(200..230).contains(s)) {
        let s = f64::from(second);
        writeln!(
            truth,
            "2300,{},{:.10},{:.10},{:.4}",
            100_000 + second,
            48.1 + 2e-5 * s,
            -11.5 + 1e-5 * s,
            500.0 + (s / 50.0).sin()
        )
        .unwrap();
    }
    let mut solution =
        "%  GPST  latitude(deg) longitude(deg) height(m) Q ns sdn sde sdu sdne sdeu \
                        sdun age ratio\n"
            .to_owned();
    for index in 0..1300 {
        let s = f64::from(index) * 0.5 - 20.0 + 0.003;
        let quality = [1, 2, 5][index as usize % 3];
        let spread = [2e-7, 8e-6, 5e-5][index as usize % 3];
        let outlier = if index % 97 == 0 { 30.0 } else { 1.0 };
        writeln!(
            solution,
            "2300 {:.3} {:.9} {:.9} {:.4} {quality} 9 1.5 1.2 3.0 0.3 -0.2 0.4 0.0 1.0",
            100_000.0 + s,
            48.1 + 2e-5 * s + spread * outlier * numbers.next(),
            -11.5 + 1e-5 * s + spread * outlier * numbers.next(),
            500.0 + (s / 50.0).sin() + 1e5 * spread * numbers.next()
        )
        .unwrap();
    }
    solution += "2300 100010.003 48.1 -11.5 500.0 5 9 1 1 1 0 0 0 0 0\nbroken row\n";
    let paths = (folder.join("solution.pos"), folder.join("truth.csv"));
    std::fs::write(&paths.0, solution).unwrap();
    std::fs::write(&paths.1, truth).unwrap();
    paths
}

fn texts(parts: &[&str]) -> Vec<String> {
    parts.iter().map(|part| (*part).to_owned()).collect()
}

#[test]
fn numbers_equal_the_independent_judge() {
    let folder = tempfile::tempdir().unwrap();
    let (solution, truth) = synthetic(folder.path());
    let truth = truth.display().to_string();
    let runs: [(&[&str], &[&str]); 6] = [
        (&[], &[]),
        (&["--from", "100100", "--to", "100300.5"], &["--start", "100100", "--end", "100300.5"]),
        (&["--lever=1,-2,0.5", "--q", "1,2"], &["--lever=1,-2,0.5", "--q", "1,2"]),
        (&["--shift=-0.25", "--fix-tol", "0.02"], &["--shift=-0.25", "--fix-tol", "0.02"]),
        (&["--max-gap", "60", "--expect", "5000"], &["--max-gap", "60", "--expect", "5000"]),
        (&["--max-gap", "0.5", "--tol", "0.004"], &["--max-gap", "0.5", "--tol", "0.004"]),
    ];
    for (ours, theirs) in runs {
        let mut own = texts(&["--truth", &truth]);
        own.extend(texts(ours));
        let mut other = texts(&[&truth]);
        other.extend(texts(theirs));
        let Some(judge) = judge() else { return };
        let agreed = compare(judge, &solution, &own, &other);
        assert!(50 < agreed, "{ours:?}: only {agreed} numbers");
    }
    for place in ["--static=48.1,-11.5,500", "--static-ecef=4181877.0,-850822.0,4724823.0"] {
        let Some(judge) = judge() else { return };
        let agreed = compare(judge, &solution, &texts(&[place]), &texts(&[place]));
        assert!(50 < agreed, "{place}: only {agreed} numbers");
    }
}

/// The paper's truth and rover file, with a solution made from the truth. With `--obs` both
/// programs count the same epochs.
#[test]
fn expected_epochs_of_a_real_rover_equal_the_judges() {
    let Some(set) = data::set("tst-2019") else { return };
    let Some(judge) = judge() else { return };
    let truth = set.join("truth.csv");
    let mut solution = String::new();
    let mut numbers = Numbers(3);
    for line in std::fs::read_to_string(&truth).unwrap().lines().step_by(2) {
        let v: Vec<f64> = line.split(',').map(|field| field.trim().parse().unwrap()).collect();
        let (lat, lon) = (v[2] + 1e-4 * numbers.next(), v[3] + 1e-4 * numbers.next());
        writeln!(solution, "{} {:.3} {lat:.9} {lon:.9} {} 5 8", v[0], v[1], v[4]).unwrap();
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("solution.pos");
    std::fs::write(&path, solution).unwrap();
    let rover = set.join("COM3_190428_124409.obs").display().to_string();
    let truth = truth.display().to_string();
    let window = ["46701", "47185.5"];
    let own = texts(&["--truth", &truth, "--obs", &rover, "--from", window[0], "--to", window[1]]);
    let other = texts(&[&truth, "--obs", &rover, "--start", window[0], "--end", window[1]]);
    assert!(30 < compare(judge, &path, &own, &other));
}

#[test]
fn the_figure_is_drawn_as_svg_and_png() {
    let folder = tempfile::tempdir().unwrap();
    let (solution, truth) = synthetic(folder.path());
    for (name, magic) in [("figure.svg", b"<svg".as_slice()), ("figure.png", b"\x89PNG\r\n\x1a\n")]
    {
        let figure = folder.path().join(name);
        let output = Command::new(env!("CARGO_BIN_EXE_graphfix"))
            .args(["evaluate", "--solution"])
            .arg(&solution)
            .arg("--truth")
            .arg(&truth)
            .arg("--plot")
            .arg(&figure)
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let bytes = std::fs::read(&figure).unwrap();
        assert!(bytes.starts_with(magic) && 20_000 < bytes.len(), "{name}: {} B", bytes.len());
    }
    let svg = std::fs::read_to_string(folder.path().join("figure.svg")).unwrap();
    for text in ["east (m)", "Up error", "GPS seconds of week (s)", "95 %", "fixed "] {
        assert!(svg.contains(text), "the figure does not say {text:?}");
    }
}

#[test]
fn what_cannot_be_judged_is_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let (solution, truth) = synthetic(folder.path());
    let refusal = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_graphfix"))
            .args(["evaluate", "--solution"])
            .arg(&solution)
            .args(arguments)
            .output()
            .unwrap();
        assert!(!output.status.success());
        let text = String::from_utf8(output.stderr).unwrap();
        text.lines().last().unwrap().to_owned()
    };
    let truth = truth.display().to_string();
    assert!(refusal(&["--truth", "/nowhere.csv"]).starts_with("error[FILE_NOT_READABLE]"));
    assert!(refusal(&[]).starts_with("error[USAGE]"));
    assert!(
        refusal(&["--truth", &truth, "--plot", "x.gif"])
            .starts_with("error[UNKNOWN_OUTPUT_FORMAT]")
    );
    let late = ["--truth", &truth, "--from", "600000", "--plot", "x.svg"];
    assert!(refusal(&late).starts_with("error[NOTHING_TO_PLOT]"));
}
