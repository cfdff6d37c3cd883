//! `graphfix simulate`: its files can be read back, and wrong arguments are refused.

use std::path::Path;
use std::process::{Command, Output};

use graphfix::formats::rinex::{ObservationReader, read_navigation};
use graphfix::formats::truth;
use graphfix::gnss::{Epoch, GpsTime};
use graphfix::models::{satellite_state, select_ephemeris};
use graphfix::simulation::{Atmosphere, Scenario, Simulator};

use crate::support::reading::open;

fn simulate(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_graphfix"))
        .args(["simulate", "--seed", "5", "--output"])
        .arg(folder)
        .args(arguments)
        .output()
        .unwrap()
}

/// RINEX keeps 0.5 mm and 0.0005 cycles, and drops nothing.
fn assert_read_back(folder: &Path, name: &str, expected: &[Epoch]) {
    let mut reader = ObservationReader::new(open(&folder.join(name))).unwrap();
    let mut epoch = Epoch::new(GpsTime::EPOCH);
    for made in expected {
        assert!(reader.read_epoch(&mut epoch).unwrap(), "{name} ends early");
        assert_eq!(epoch.time, made.time);
        assert_eq!(epoch.observations.len(), made.observations.len(), "{name} {}", made.time);
        for (a, b) in epoch.observations.iter().zip(&made.observations) {
            assert_eq!((a.satellite, a.code), (b.satellite, b.code));
            assert_eq!(a.loss_of_lock, b.loss_of_lock, "{name} {} {b:?}", made.time);
            assert_eq!(a.half_cycle, b.half_cycle, "{name} {} {b:?}", made.time);
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
        let rows = truth::read(open(&folder.path().join("truth.csv")), 0).unwrap();
        for (row, epoch) in rows.iter().zip(&made) {
            assert_eq!(row.time, epoch.rover.time);
            assert!(row.position.distance_m(epoch.position) < 2e-5);
        }
        let (read, skipped) = read_navigation(open(&folder.path().join("navigation.rnx"))).unwrap();
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

/// A phone's log gives the same positions as the RINEX file of the same observations, which rounds
/// each range to half a millimetre.
#[test]
fn a_phones_log_is_solved_like_rinex() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let solved = |format: &str, rover: &str| {
        let arguments = ["--scenario", "urban-canyon", "--duration", "60", "--force", "--format"];
        let output = simulate(folder.path(), &[&arguments[..], &[format]].concat());
        assert!(String::from_utf8_lossy(&output.stdout).contains(rover), "{output:?}");
        let output = Command::new(env!("CARGO_BIN_EXE_graphfix"))
            .args(["solve", "--mode", "spp", "--rover"])
            .arg(path(rover))
            .arg("--nav")
            .arg(path("navigation.rnx"))
            .arg("--output")
            .arg(path("solution.csv"))
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let text = std::fs::read_to_string(path("solution.csv")).unwrap();
        let title: Vec<String> =
            text.lines().next().unwrap().split(',').map(str::to_owned).collect();
        let column = |name: &str| title.iter().position(|known| known == name).unwrap();
        let columns = ["tow_s", "x_m", "y_m", "z_m"].map(column);
        let row = |line: &str| {
            let fields: Vec<&str> = line.split(',').collect();
            columns.map(|column| fields[column].parse::<f64>().unwrap_or(f64::NAN))
        };
        text.lines().skip(1).map(row).collect::<Vec<_>>()
    };
    let of_rinex = solved("rinex", "rover.obs");
    let of_log = solved("gnss-logger", "gnss_log.txt");
    assert_eq!((of_rinex.len(), of_log.len()), (61, 61));
    let answered = of_rinex.iter().zip(&of_log).filter(|(a, _)| !a[1].is_nan());
    for (a, b) in answered {
        assert_eq!(a[0], b[0]);
        let off_m = (1..4).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt();
        assert!(off_m < 0.01, "{off_m} m at {}", a[0]);
    }
}

/// A log without a usable measurement, and one as navigation data: the reason and the remedy.
#[test]
fn a_phones_log_that_does_not_serve_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["--scenario", "clean", "--duration", "2", "--format", "gnss-logger"];
    assert!(simulate(folder.path(), &arguments).status.success());
    let log = folder.path().join("gnss_log.txt");
    let text = std::fs::read_to_string(&log).unwrap();
    let useless = folder.path().join("useless.txt");
    std::fs::write(&useless, text.replace(",0.0,10.0,0.0,,", ",0.0,1.1e7,0.0,,")).unwrap();
    let refusal = |rover: &Path, navigation: &Path| {
        let output = Command::new(env!("CARGO_BIN_EXE_graphfix"))
            .args(["solve", "--mode", "spp", "--rover"])
            .arg(rover)
            .arg("--nav")
            .arg(navigation)
            .arg("--output")
            .arg(folder.path().join("solution.csv"))
            .output()
            .unwrap();
        assert!(!output.status.success());
        String::from_utf8(output.stderr).unwrap()
    };
    let message = refusal(&useless, &folder.path().join("navigation.rnx"));
    assert!(message.contains("no measurement is usable in"), "{message}");
    assert!(message.contains("GPS time is uncertain by more than 10 ms"), "{message}");
    assert!(message.contains("under open sky"), "{message}");
    let message = refusal(&log, &log);
    assert!(message.contains("no navigation data that is decoded"), "{message}");
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
    assert!(unknown.contains("open-sky, urban-canyon, rtk-open, rtk-canyon, clean"), "{unknown}");
    let clean = ["--scenario", "clean", "--duration", "2"];
    assert!(simulate(folder.path(), &clean).status.success());
    assert!(refusal(&clean).starts_with("error[FILE_EXISTS]"));
    let again = [&clean[..], &["--force"]].concat();
    assert!(simulate(folder.path(), &again).status.success());
    let backwards = ["--scenario", "clean", "--duration=-1"];
    assert!(refusal(&backwards).starts_with("error[INVALID_OPTION_VALUE]"));
    assert!(refusal(&["--scenario", "clean", "--rate", "0"]).contains("--rate 0"));
    assert!(refusal(&["--scenario", "clean", "--baseline", "1e6"]).contains("--baseline"));
}

/// `--baseline` sets the distance of the base, and the ionosphere's gradient lengthens its
/// pseudoranges in proportion to it.
#[test]
fn baselines_and_gradients() {
    let quiet = |baseline_m: f64, gradient: [f64; 2]| {
        let scenario = Scenario::rtk_open().with_baseline(baseline_m);
        let atmosphere = scenario
            .atmosphere
            .map(|atmosphere| Atmosphere { ionosphere_gradient: gradient, ..atmosphere });
        let scenario = Scenario {
            atmosphere,
            duration_s: 10.0,
            rover_errors: None,
            base_errors: None,
            ..scenario
        };
        let origin = scenario.origin.to_ecef();
        let simulator = Simulator::new(scenario, 1);
        let base = simulator.base_position().unwrap();
        let epoch = simulator.last().unwrap().base.unwrap();
        (origin.distance_m(base), epoch.observations)
    };
    for baseline_m in [1_000.0, 20_000.0] {
        let (distance_m, plain) = quiet(baseline_m, [0.0; 2]);
        assert!((distance_m - baseline_m).abs() < 0.01 * baseline_m, "{distance_m}");
        let (_, sloped) = quiet(baseline_m, [3e-6, 4e-6]);
        // 5 mm/km along the gradient, times the cosine of its angle to the baseline, at most one,
        // and a slant factor below 3.5.
        let largest_m = 5e-6 * baseline_m * 3.5;
        let mut seen_m = 0.0_f64;
        for (a, b) in plain.iter().zip(&sloped).filter(|(a, _)| a.code.band_digit() == 1) {
            let longer_m = b.pseudorange_m.unwrap() - a.pseudorange_m.unwrap();
            seen_m = seen_m.max(longer_m.abs());
            assert!(longer_m.abs() <= largest_m, "{longer_m}");
        }
        assert!(1e-7 * baseline_m < seen_m, "{seen_m}");
    }
}
