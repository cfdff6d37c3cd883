//! Positions in the ETRS89 and heights above the geoid against PROJ, which has the parameters of
//! EUREF from EPSG's register, and reads tables by itself.

use std::path::Path;
use std::process::Command;

use graphfix::formats::rinex::write_navigation;
use serde_json::Value;

use crate::support::geoid::plane;
use crate::support::jobs::Files;
use crate::support::pair::MUNICH;
use crate::support::python;

/// Written coordinates have four decimals.
const ROUNDING_M: f64 = 0.0002;

/// The differences that PROJ finds in positions of this frame and epoch.
fn compared(python: &str, (mode, frame, year): (&str, &str, &str)) -> Value {
    let mut navigation = Vec::new();
    write_navigation(&mut navigation, &MUNICH.navigation).unwrap();
    let base = MUNICH.base_file(Some(MUNICH.position));
    let files = Files { rover: MUNICH.rover_file(), base, navigation };
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (native, etrs89, table) = (path("native.csv"), path("etrs89.csv"), path("geoid.gtx"));
    std::fs::write(&table, plane()).unwrap();
    let base_frame = format!("{frame}@{year}");
    let stated: &[&str] = if year.is_empty() { &[] } else { &["--base-frame", &base_frame] };
    let plain = files.solved(&["--mode", mode], "csv");
    let asked = [&["--mode", mode, "--frame", "ETRS89", "--geoid", &table], stated].concat();
    std::fs::write(&native, plain).unwrap();
    std::fs::write(&etrs89, files.solved(&asked, "csv")).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/support/python/frames.py");
    let mut command = Command::new(python);
    let output =
        command.arg(script).args([&*native, &*etrs89, frame, year, &*table]).output().unwrap();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{frame}: {errors}");
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn proj_transforms_to_the_same_positions_and_heights() {
    let Some(python) = python::with("pyproj") else { return };
    for asked in [
        ("spp", "ITRF2020", ""),
        ("rtk-fgo", "ITRF2020", "2024.5"),
        ("rtk-fgo", "ITRF2014", "2010.0"),
        ("rtk-fgo", "ITRF2008", "2016.25"),
        ("rtk-fgo", "ITRF2005", "2000.0"),
        ("rtk-fgo", "ITRF2000", "1997.0"),
    ] {
        let found = compared(&python, asked);
        assert_eq!(found["positions"], MUNICH.rover.len(), "{asked:?}: {found}");
        let of = |name: &str| found[name].as_f64().unwrap();
        assert!(of("moved") < ROUNDING_M && of("geoid") < ROUNDING_M, "{asked:?}: {found}");
    }
}
