//! The formats of solutions, read by programs that others wrote: pynmea2, gpxpy, fastkml with the
//! schema of KML 2.2, and RTKLIB's pos2kml.

use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::support::{data, python};

fn run(command: &mut Command) -> String {
    let output = command.output().expect("the program can be started");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}: {errors}");
    String::from_utf8(output.stdout).expect("text")
}

fn graphfix(folder: &Path, arguments: &[&str]) {
    run(Command::new(env!("CARGO_BIN_EXE_graphfix")).current_dir(folder).args(arguments));
}

/// A simulated rover between buildings with its base, positioned once for each format.
fn tracks(folder: &Path, formats: &[&str]) {
    let simulate = ["simulate", "--scenario", "rtk-canyon", "--seed", "2", "--duration", "120"];
    graphfix(folder, &[&simulate[..], &["--output", "."]].concat());
    for format in formats {
        let output = format!("track.{format}");
        let files = ["--rover", "rover.obs", "--base", "base.obs", "--nav", "navigation.rnx"];
        let arguments = ["solve", "--mode", "rtk-fgo", "--output", &output];
        graphfix(folder, &[&arguments[..], &files].concat());
    }
}

#[test]
fn others_read_the_same_track_from_each_format() {
    let Some(python) = python::with("pynmea2, gpxpy, fastkml, lxml") else { return };
    let folder = tempfile::tempdir().unwrap();
    tracks(folder.path(), &["csv", "nmea", "gpx", "kml", "geojson"]);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/support/python/tracks.py");
    let mut compare = Command::new(python);
    let counts = run(compare.arg(script).arg(folder.path()).arg("track"));
    let counts: Value = serde_json::from_str(&counts).unwrap();
    assert_eq!(counts["epochs"], 121, "{counts}");
    // Between buildings the status changes, and each change begins another line of the track.
    assert!(100 < counts["positions"].as_u64().unwrap(), "{counts}");
    assert!(1 < counts["lines"].as_u64().unwrap(), "{counts}");
}

/// pyarrow and DuckDB read the same values from Parquet as from CSV.
#[cfg(feature = "parquet")]
#[test]
fn others_read_parquet() {
    let Some(python) = python::with("pyarrow, duckdb") else { return };
    let folder = tempfile::tempdir().unwrap();
    tracks(folder.path(), &["csv", "parquet"]);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/support/python/parquet.py");
    let mut compare = Command::new(python);
    let counts = run(compare.arg(script).arg(folder.path()).arg("track"));
    let counts: Value = serde_json::from_str(&counts).unwrap();
    assert_eq!((&counts["epochs"], &counts["columns"]), (&121.into(), &47.into()), "{counts}");
    assert!(100 < counts["positions"].as_u64().unwrap(), "{counts}");
}

/// RTKLIB reads the `.pos` file, and its own KML has each position.
#[test]
fn rtklib_reads_the_solution_file() {
    if Command::new("pos2kml").arg("-h").output().is_err() {
        return data::note_missing("RTKLIB's pos2kml");
    }
    let folder = tempfile::tempdir().unwrap();
    tracks(folder.path(), &["pos", "csv"]);
    run(Command::new("pos2kml").current_dir(folder.path()).args([
        "-o",
        "by_rtklib.kml",
        "track.pos",
    ]));
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    let kml = read("by_rtklib.kml");
    let csv = read("track.csv");
    let rows: Vec<Vec<&str>> = csv.lines().skip(1).map(|row| row.split(',').collect()).collect();
    let answered: Vec<_> = rows.iter().filter(|row| row[2] != "NONE").collect();
    let texts = kml.split("<Point>").skip(1).filter_map(|point| {
        let (_, rest) = point.split_once("<coordinates>")?;
        Some(rest.split_once("</coordinates>")?.0)
    });
    let points: Vec<Vec<f64>> = texts
        .map(|text| text.split(',').map(|number| number.trim().parse().unwrap()).collect())
        .collect();
    assert_eq!(points.len(), answered.len());
    for (point, row) in points.iter().zip(answered) {
        let (latitude, longitude) =
            (row[6].parse::<f64>().unwrap(), row[7].parse::<f64>().unwrap());
        assert!((point[0] - longitude).abs() < 2e-9 && (point[1] - latitude).abs() < 2e-9);
    }
}
