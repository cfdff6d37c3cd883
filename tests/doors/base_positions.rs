//! The base position of `solve`: the given one, otherwise that of the file, otherwise the mean of
//! single-point positions.

use std::fs;
use std::path::Path;
use std::process::Command;

use graphfix::gnss::Ecef;

use crate::support::data;
use crate::support::streams::{message_number, moved_station, rtcm_frame, rtcm_payloads, unpacked};

/// Success or not, standard output, standard error.
fn run(folder: &Path, arguments: &[&str]) -> (bool, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_graphfix"));
    let output = command.current_dir(folder).args(arguments).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (output.status.success(), text(output.stdout), text(output.stderr))
}

/// The marker in a summary, and its stated source.
fn marker(summary: &str) -> (Ecef, String) {
    let line = summary.lines().find_map(|l| l.trim().strip_prefix("base: marker at ")).unwrap();
    let (numbers, rest) = line.split_once(" (ECEF, m) ").unwrap();
    let numbers: Vec<f64> = numbers.split(',').map(|n| n.parse().unwrap()).collect();
    let [x, y, z] = numbers[..] else { panic!("{line}") };
    (Ecef::new(x, y, z), rest.split_once(", antenna").unwrap().0.to_owned())
}

/// A simulated base whose header contains its position, the geocentre, or no position.
#[test]
fn a_base_of_rinex_stands_where_it_can_be_known() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let scenario = ["simulate", "--scenario", "rtk-open", "--seed", "1", "--duration", "30"];
    let (done, _, error) = run(folder, &[&scenario[..], &["--output", "."]].concat());
    assert!(done, "{error}");
    let told = fs::read_to_string(folder.join("base.obs")).unwrap();
    let line = told.lines().find(|line| line.contains("APPROX POSITION XYZ")).unwrap();
    let zero = format!("{:<60}APPROX POSITION XYZ", "        0.0000        0.0000        0.0000");
    fs::write(folder.join("zero.obs"), told.replacen(line, &zero, 1)).unwrap();
    fs::write(folder.join("untold.obs"), told.replacen(&format!("{line}\n"), "", 1)).unwrap();
    let solve = |base: &str, further: &[&str]| {
        let fixed = ["solve", "--rover", "rover.obs", "--nav", "navigation.rnx", "--base", base];
        let to = ["--mode", "rtk-fgo", "--output", "out.pos"];
        run(folder, &[&fixed[..], &to, further].concat())
    };

    let (done, summary, error) = solve("base.obs", &[]);
    assert!(done, "{error}");
    let (truth, source) = marker(&summary);
    assert_eq!(source, "from its header");
    assert!(!summary.contains("warning: base"), "{summary}");
    assert_eq!(
        solve("base.obs", &["--base-position", "from-header"]).1.lines().nth(1),
        summary.lines().nth(1)
    );

    for base in ["zero.obs", "untold.obs"] {
        let (done, summary, error) = solve(base, &[]);
        assert!(done, "{error}");
        let (mean, source) = marker(&summary);
        assert_eq!(source, "from its own single-point positions");
        let off_m = mean.distance_m(truth);
        // The error is metres, from orbits, clocks and atmosphere: the position is not the
        // header's.
        assert!((0.01..10.0).contains(&off_m), "{off_m}");
        let warning = "warning: base: no source gives its position; the mean of 31 single-point";
        assert!(summary.contains(warning), "{summary}");
        let (done, _, error) = solve(base, &["--base-position", "from-header"]);
        assert!(!done && error.contains("BASE_POSITION_MISSING"), "{error}");
        let given = format!("--base-position={:.4},{:.4},{:.4}", truth.0.x, truth.0.y, truth.0.z);
        let (_, summary, _) = solve(base, &[&given]);
        assert_eq!(marker(&summary), (truth, "as given".to_owned()));
    }
}

/// The Galway base's log has messages 1005 and no header. Without them no source gives its
/// position.
#[test]
fn a_base_of_messages_stands_where_they_say_or_by_itself() {
    let Some(data) = data::set("galway-static") else { return };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let rover = data.join("rover-20181004-1237.ubx.gz").to_str().unwrap().to_owned();
    let log = unpacked(&data.join("base-20181004-1236.ubx.gz"));
    let (mut whole, mut silent) = (Vec::new(), Vec::new());
    for payload in rtcm_payloads(&log[..log.len() / 8]) {
        let frame = rtcm_frame(&payload);
        whole.extend_from_slice(&frame);
        if ![1005, 1006].contains(&message_number(&payload)) {
            silent.extend_from_slice(&frame);
        }
    }
    assert!(silent.len() < whole.len());
    fs::write(folder.join("whole.rtcm3"), whole).unwrap();
    fs::write(folder.join("silent.rtcm3"), silent).unwrap();
    let solve = |base: &str| {
        let fixed = ["solve", "--rover", &rover, "--nav", &rover, "--base", base, "--to", "391100"];
        let (done, summary, error) =
            run(folder, &[&fixed[..], &["--mode", "rtk-fgo", "--output", "out.pos"]].concat());
        assert!(done, "{error}");
        summary
    };
    let summary = solve("whole.rtcm3");
    let (truth, source) = marker(&summary);
    assert_eq!(source, "from its messages 1005 and 1006");
    assert!(!summary.contains("warning: base"), "{summary}");
    let summary = solve("silent.rtcm3");
    let (mean, source) = marker(&summary);
    assert_eq!(source, "from its own single-point positions");
    let off_m = mean.distance_m(truth);
    assert!((0.01..15.0).contains(&off_m), "{off_m}");
    assert!(summary.contains("warning: base: no source gives its position"), "{summary}");
}

/// Messages 1005 that move the base by 5 m along x: positions follow from that epoch on, the reason
/// is reported, and the rover is fixed again.
#[test]
fn a_base_of_messages_may_move() {
    let Some(data) = data::set("galway-static") else { return };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let rover = data.join("rover-20181004-1237.ubx.gz").to_str().unwrap().to_owned();
    let log = unpacked(&data.join("base-20181004-1236.ubx.gz"));
    let payloads = rtcm_payloads(&log[..log.len() / 3]);
    let payload = payloads.iter().find(|payload| message_number(payload) == 1005).unwrap();
    let (still, moved) = (rtcm_frame(payload), rtcm_frame(&moved_station(payload, 50_000)));
    let mut bytes = log[..log.len() / 3].to_vec();
    fs::write(folder.join("still.ubx"), &bytes).unwrap();
    for place in log.len() * 3 / 20..bytes.len() {
        if bytes[place..].starts_with(&still) {
            bytes[place..place + moved.len()].copy_from_slice(&moved);
        }
    }
    fs::write(folder.join("moved.ubx"), &bytes).unwrap();
    let solve = |base: &str| {
        let fixed = ["solve", "--rover", &rover, "--nav", &rover, "--base", base, "--to", "391440"];
        let to = ["--mode", "rtk-fgo", "--output", "out.csv"];
        let (done, summary, error) = run(folder, &[&fixed[..], &to].concat());
        assert!(done, "{error}");
        let rows = fs::read_to_string(folder.join("out.csv")).unwrap();
        let row = |row: &str| {
            let fields: Vec<&str> = row.split(',').collect();
            let x: f64 = fields[3].parse().unwrap();
            (fields[2] == "FIXED", x, row.contains("BASE_MOVED"))
        };
        (summary, rows.lines().skip(1).map(row).collect::<Vec<_>>())
    };
    let (summary, still) = solve("still.ubx");
    assert!(!summary.contains("its file moved it") && !summary.contains("BASE_MOVED"), "{summary}");
    let (summary, moved) = solve("moved.ubx");
    assert!(summary.contains("base: its file moved it 1 times"), "{summary}");
    let at = moved.iter().position(|(_, _, says)| *says).unwrap();
    assert_eq!(moved.iter().filter(|(_, _, says)| *says).count(), 1);
    assert_eq!(moved[..at], still[..at]);
    let at_once_m = moved[at].1 - still[at].1;
    assert!(still[at].0 && (at_once_m - 5.0).abs() < 2.5, "{at_once_m}");
    let both = still.iter().zip(&moved).skip(at).filter(|(a, b)| a.0 && b.0);
    let moves: Vec<f64> = both.map(|(a, b)| b.1 - a.1).collect();
    assert!(100 < moves.len(), "{} fixed after the base moved", moves.len());
    assert!(moves.iter().all(|moved_m| (moved_m - 5.0).abs() < 0.02), "{moves:?}");
}

/// A header record in the middle of a base's file raises the antenna by a metre: so are positions
/// from there on, whether the marker is that of the header or given.
#[test]
fn a_base_of_rinex_has_the_antenna_height_that_its_file_states_last() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let scenario = ["simulate", "--scenario", "rtk-open", "--seed", "1", "--duration", "60"];
    let (done, _, error) = run(folder, &[&scenario[..], &["--output", "."]].concat());
    assert!(done, "{error}");
    let still = fs::read_to_string(folder.join("base.obs")).unwrap();
    let line = still.lines().find(|line| line.contains("ANTENNA: DELTA H/E/N")).unwrap();
    let height_m: f64 = line[..14].trim().parse().unwrap();
    let raised = format!("{:14.4}{}", height_m + 1.0, &line[14..]);
    let epochs: Vec<usize> = still.match_indices("\n>").map(|(at, _)| at + 1).collect();
    let middle = epochs[epochs.len() / 2];
    let event = format!(">{:30}4{:3}\n{raised}\n", "", 1);
    fs::write(folder.join("raised.obs"), [&still[..middle], &event, &still[middle..]].concat())
        .unwrap();
    let solve = |base: &str, further: &[&str]| {
        let fixed = ["solve", "--rover", "rover.obs", "--nav", "navigation.rnx", "--base", base];
        let to = ["--mode", "rtk-fgo", "--output", "out.csv"];
        let (done, summary, error) = run(folder, &[&fixed[..], &to, further].concat());
        assert!(done, "{error}");
        let rows = fs::read_to_string(folder.join("out.csv")).unwrap();
        let row = |row: &str| {
            let fields: Vec<&str> = row.split(',').collect();
            let [x, y, z] = [3, 4, 5].map(|axis| fields[axis].parse().unwrap());
            (fields[2] == "FIXED", Ecef::new(x, y, z), row.contains("BASE_MOVED"))
        };
        (summary, rows.lines().skip(1).map(row).collect::<Vec<_>>())
    };
    let (summary, still) = solve("base.obs", &[]);
    assert!(!summary.contains("its file moved it"), "{summary}");
    let marker = marker(&summary).0.0;
    let given = format!("--base-position={:.4},{:.4},{:.4}", marker.x, marker.y, marker.z);
    for further in [&[][..], &[given.as_str()]] {
        let (summary, raised) = solve("raised.obs", further);
        assert!(summary.contains("base: its file moved it 1 times"), "{summary}");
        let at = raised.iter().position(|(_, _, says)| *says).unwrap();
        let moves = |epochs: std::ops::Range<usize>| -> Vec<f64> {
            let both = still[epochs.clone()].iter().zip(&raised[epochs]);
            both.filter(|(a, b)| a.0 && b.0).map(|(a, b)| a.1.distance_m(b.1)).collect()
        };
        let (before, after) = (moves(0..at), moves(at..raised.len()));
        assert!(10 < before.len() && before.iter().all(|moved_m| *moved_m < 0.01), "{before:?}");
        let is_raised = |moved_m: &f64| (moved_m - 1.0).abs() < 0.02;
        assert!(10 < after.len() && after.iter().all(is_raised), "{after:?}");
    }
}

/// The first epoch of a base has five satellites, whose pseudoranges are a kilometre off: the base
/// is accepted by the next epochs.
#[test]
fn a_wild_epoch_does_not_refuse_a_base_for_ever() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let scenario = ["simulate", "--scenario", "rtk-open", "--seed", "1", "--duration", "120"];
    let (done, _, error) = run(folder, &[&scenario[..], &["--output", "."]].concat());
    assert!(done, "{error}");
    let sound = fs::read_to_string(folder.join("base.obs")).unwrap();
    let (mut epochs, mut satellites) = (0, 0);
    let wild = |line: &str| -> String {
        epochs += usize::from(line.starts_with('>'));
        match (epochs, line.starts_with('>')) {
            (1, true) => format!("{}{:3}\n", &line[..32], 5),
            (1, false) => {
                // The first number of a record is a pseudorange.
                satellites += 1;
                let range_m: f64 = line[3..17].trim().parse().unwrap();
                let off_m = if satellites % 2 == 0 { 1000.0 } else { -1000.0 };
                let moved = format!("{}{:14.3}{}\n", &line[..3], range_m + off_m, &line[17..]);
                if satellites <= 5 { moved } else { String::new() }
            }
            _ => format!("{line}\n"),
        }
    };
    let wild: String = sound.lines().map(wild).collect();
    fs::write(folder.join("wild.obs"), wild).unwrap();
    let fixed = ["solve", "--rover", "rover.obs", "--nav", "navigation.rnx", "--mode", "rtk-fgo"];
    let fixes = |base: &str| {
        let to = ["--base", base, "--output", "out.csv"];
        let (done, _, error) = run(folder, &[&fixed[..], &to].concat());
        assert!(done, "{error}");
        let rows = fs::read_to_string(folder.join("out.csv")).unwrap();
        rows.lines().filter(|row| row.split(',').nth(2) == Some("FIXED")).count()
    };
    let (sound, wild) = (fixes("base.obs"), fixes("wild.obs"));
    assert!(100 < sound && sound < wild + 20, "{sound} and {wild}");
}
