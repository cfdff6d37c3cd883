//! Phase centres of antennas, from an ANTEX file to positions.

use std::fs;
use std::path::Path;
use std::process::Command;

use graphfix::config::{Mode, PositioningOptions, Profile};
use graphfix::gnss::LocalFrame;
use graphfix::positioning::{Aiding, Estimator, correct_for_antenna};
use graphfix::simulation::{Motion, Scenario, Simulator};

use crate::support::antex::antex;

/// An invented antenna: phase centre 2 cm north, 1 cm west and 15 cm up on L1, no variations.
fn sample() -> String {
    antex(&[("MAKER123.00", "     20.00    -10.00    150.00")])
}

/// The true position is taken as that of the phase centre. After the correction the position is
/// that of the antenna reference point, to 2 mm: 15 cm below, 2 cm south and 1 cm east of the true
/// one.
#[test]
fn positions_come_down_to_the_reference_point() {
    let catalogue = graphfix::formats::antex::read(sample().as_bytes()).unwrap();
    let antenna = catalogue.receiver("MAKER123.00     NONE", "").unwrap();
    let scenario =
        Scenario { motion: Motion::Static, frequencies: 1, duration_s: 5.0, ..Scenario::clean() };
    let simulator = Simulator::new(scenario, 1);
    let navigation = simulator.navigation().clone();
    let mut options = PositioningOptions::new(Mode::Spp, Profile::General);
    for (key, value) in [("troposphere", "none"), ("ionosphere", "none")] {
        options.set(key, value).unwrap();
    }
    let mut estimator = Estimator::new(options);
    for epoch in simulator {
        let mut corrected = epoch.rover.clone();
        let mut uncalibrated = Vec::new();
        let place = epoch.position;
        correct_for_antenna(&mut corrected, antenna, place, &navigation, &mut uncalibrated);
        assert_eq!(uncalibrated, []);
        let solution = estimator.advance(&corrected, &Aiding::alone(&navigation));
        let position = solution.estimate.unwrap().position;
        let moved = LocalFrame::at(place).to_enu(position).0;
        let expected = nalgebra::Vector3::new(0.01, -0.02, -0.15);
        assert!((moved - expected).norm() < 2e-3, "{moved}");
        for (a, b) in epoch.rover.observations.iter().zip(&corrected.observations) {
            let range_m = b.pseudorange_m.unwrap() - a.pseudorange_m.unwrap();
            let cycles = b.carrier_phase.unwrap().0 - a.carrier_phase.unwrap().0;
            let channel = navigation.of(a.satellite)[0].glonass_channel();
            let hz = a.signal().frequency_hz(channel).unwrap();
            assert!((cycles * 299_792_458.0 / hz - range_m).abs() < 1e-6);
        }
    }
}

fn run(folder: &Path, arguments: &[&str]) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_graphfix"));
    let output = command.current_dir(folder).args(arguments).output().unwrap();
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{arguments:?}: {error}");
    String::from_utf8(output.stdout).unwrap()
}

/// `solve --antex` reports the corrected and the uncorrected antennas.
#[test]
fn the_summary_names_the_antennas() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let scenario = ["simulate", "--scenario", "rtk-open", "--seed", "1", "--duration", "30"];
    run(folder, &[&scenario[..], &["--output", "."]].concat());
    fs::write(folder.join("antennas.atx"), sample()).unwrap();
    // The rover has the antenna of the ANTEX file, and the base has another one.
    for (file, antenna) in [("rover.obs", "MAKER123.00     NONE"), ("base.obs", "MAKER9")] {
        let text = fs::read_to_string(folder.join(file)).unwrap();
        let ideal = format!("{:<20}", "IDEAL");
        assert!(text.contains(&ideal));
        fs::write(folder.join(file), text.replacen(&ideal, &format!("{antenna:<20}"), 1)).unwrap();
    }
    let solve = |further: &[&str]| {
        let fixed = ["solve", "--rover", "rover.obs", "--nav", "navigation.rnx"];
        let base = ["--base", "base.obs", "--mode", "rtk-fgo", "--output", "out.pos"];
        let summary = run(folder, &[&fixed[..], &base, further].concat());
        (summary, fs::read_to_string(folder.join("out.pos")).unwrap())
    };
    let (plain, before) = solve(&[]);
    assert!(!plain.contains("MAKER"), "{plain}");
    assert!(plain.contains("antenna reference point"), "{plain}");
    let (corrected, after) = solve(&["--antex", "antennas.atx"]);
    assert!(corrected.contains("rover: antenna MAKER123.00 NONE, phase centres"), "{corrected}");
    assert!(corrected.contains("warning: base: antenna MAKER9 is not in"), "{corrected}");
    assert!(corrected.contains("not calibrated, not corrected: "), "{corrected}");
    assert_ne!(before, after);
}
