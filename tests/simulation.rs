//! `graphfix simulate`: what it writes reads back, and what it refuses.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use std::process::{Command, Output};

use graphfix::formats::rinex::{ObservationReader, read_navigation};
use graphfix::formats::truth;
use graphfix::gnss::{Epoch, GpsTime};
use graphfix::models::{satellite_state, select_ephemeris};
use graphfix::simulation::{Scenario, Simulator};

fn simulate(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_graphfix"))
        .args(["simulate", "--seed", "5", "--output"])
        .arg(folder)
        .args(arguments)
        .output()
        .unwrap()
}

fn open(folder: &Path, name: &str) -> BufReader<File> {
    BufReader::new(File::open(folder.join(name)).unwrap())
}

/// RINEX keeps 0.5 mm and 0.0005 cycles, and drops nothing.
fn assert_read_back(folder: &Path, name: &str, expected: &[Epoch]) {
    let mut reader = ObservationReader::new(open(folder, name)).unwrap();
    let mut epoch = Epoch::new(GpsTime::EPOCH);
    for made in expected {
        assert!(reader.read_epoch(&mut epoch).unwrap(), "{name} ends early");
        assert_eq!(epoch.time, made.time);
        assert_eq!(epoch.observations.len(), made.observations.len(), "{name} {}", made.time);
        for (a, b) in epoch.observations.iter().zip(&made.observations) {
            assert_eq!((a.satellite, a.code), (b.satellite, b.code));
            assert_eq!(a.loss_of_lock, b.loss_of_lock, "{name} {} {b:?}", made.time);
            let near = |a: Option<f64>, b: Option<f64>| (a.unwrap() - b.unwrap()).abs() < 5.1e-4;
            assert!(near(a.pseudorange_m, b.pseudorange_m), "{a:?} {b:?}");
            assert!(near(a.carrier_phase.map(|p| p.0), b.carrier_phase.map(|p| p.0)));
            assert!(near(a.doppler_hz, b.doppler_hz) && near(a.cn0_db_hz, b.cn0_db_hz));
        }
    }
    assert!(!reader.read_epoch(&mut epoch).unwrap(), "{name} has more");
    assert!(reader.skipped().is_empty(), "{name}: {:?}", reader.skipped());
}

#[test]
fn what_is_written_reads_back() {
    for (name, _) in Scenario::NAMES {
        let folder = tempfile::tempdir().unwrap();
        let output = simulate(folder.path(), &["--scenario", name, "--duration", "60"]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let scenario = Scenario { duration_s: 60.0, ..Scenario::by_name(name).unwrap() };
        let simulator = Simulator::new(scenario.clone(), 5);
        let navigation = simulator.navigation().clone();
        let made: Vec<_> = simulator.collect();
        let rover: Vec<_> = made.iter().map(|epoch| epoch.rover.clone()).collect();
        let base: Vec<_> = made.iter().filter_map(|epoch| epoch.base.clone()).collect();
        assert_eq!((rover.len(), base.len()), (61, 61));
        assert_read_back(folder.path(), "rover.obs", &rover);
        assert_read_back(folder.path(), "base.obs", &base);
        let rows = truth::read(open(folder.path(), "truth.csv"), 0).unwrap();
        for (row, epoch) in rows.iter().zip(&made) {
            assert_eq!(row.time, epoch.rover.time);
            assert!(row.position.distance_m(epoch.position) < 2e-5);
        }
        let (read, skipped) = read_navigation(open(folder.path(), "navigation.rnx")).unwrap();
        assert!(skipped.is_empty(), "{skipped:?}");
        assert_eq!(read.len(), navigation.len());
        for (satellite, _) in navigation.satellites() {
            let time = scenario.start + 30.0;
            let state = |navigation| {
                satellite_state(select_ephemeris(navigation, satellite, time).unwrap(), time)
            };
            let (a, b) = (state(&read), state(&navigation));
            // Thirteen digits of radians at 42 000 km, and millimetres per second over 15 min.
            assert!(a.position.distance_m(b.position) < 1e-3, "{satellite}");
            assert!((a.clock_m - b.clock_m).abs() < 1e-4, "{satellite}");
        }
    }
}

#[test]
fn what_it_cannot_do_is_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let refusal = |arguments: &[&str]| {
        let output = simulate(folder.path(), arguments);
        assert!(!output.status.success(), "{arguments:?}");
        String::from_utf8(output.stderr).unwrap()
    };
    let unknown = refusal(&["--scenario", "moon"]);
    assert!(unknown.starts_with("error[UNKNOWN_SCENARIO]"), "{unknown}");
    assert!(unknown.contains("open-sky, urban-canyon, clean"), "{unknown}");
    let clean = ["--scenario", "clean", "--duration", "2"];
    assert!(simulate(folder.path(), &clean).status.success());
    assert!(refusal(&clean).starts_with("error[FILE_EXISTS]"));
    let again = [&clean[..], &["--force"]].concat();
    assert!(simulate(folder.path(), &again).status.success());
    let backwards = ["--scenario", "clean", "--duration=-1"];
    assert!(refusal(&backwards).starts_with("error[INVALID_OPTION_VALUE]"));
    assert!(refusal(&["--scenario", "clean", "--rate", "0"]).contains("--rate 0"));
}
