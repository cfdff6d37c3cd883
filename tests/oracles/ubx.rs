//! UBX: frames built byte by byte, real logs against the RINEX made from them, and damage.

use std::path::Path;
use std::process::Command;

use proptest::prelude::*;

use graphfix::formats::receiver::{Event, Ionosphere, MessageKind, Refusal, TimeReference};
use graphfix::gnss::{Epoch, Observation};

use crate::support::streams::{
    self, Agreement, Random, at, counts, decode, decode_in_pieces, epochs, satellite, ubx_frame,
    unpacked,
};
use crate::support::{data, reading};

/// One measurement of RXM-RAWX.
#[derive(Clone, Copy)]
struct Measurement {
    system: u8,
    number: u8,
    signal: u8,
    lock_ms: u16,
    phase_deviation: u8,
    status: u8,
}

const PLAIN: Measurement =
    Measurement { system: 0, number: 5, signal: 0, lock_ms: 5000, phase_deviation: 2, status: 7 };

fn rawx(second: f64, measurements: &[Measurement]) -> Vec<u8> {
    let mut payload = second.to_le_bytes().to_vec();
    payload.extend(2100_u16.to_le_bytes());
    payload.extend([18, measurements.len() as u8, 1, 1, 0, 0]);
    for m in measurements {
        payload.extend(21_000_000.25_f64.to_le_bytes());
        payload.extend(110_000_000.5_f64.to_le_bytes());
        payload.extend((-1234.5_f32).to_le_bytes());
        payload.extend([m.system, m.number, m.signal, 7]);
        payload.extend(m.lock_ms.to_le_bytes());
        payload.extend([44, 3, m.phase_deviation, 6, m.status, 0]);
    }
    ubx_frame(0x02, 0x15, &payload)
}

fn read(bytes: &[u8]) -> Vec<Epoch> {
    epochs(decode(bytes, None).0)
}

#[test]
fn a_measurement_is_what_the_receiver_wrote() {
    let found = read(&rawx(345_600.004, &[PLAIN]));
    assert_eq!(found[0].time, at(2100, 345_600.004));
    let [observation] = found[0].observations[..] else { panic!("{found:?}") };
    assert_eq!(observation.satellite, satellite("G05"));
    assert_eq!(observation.code.to_string(), "1C");
    assert_eq!(observation.pseudorange_m, Some(21_000_000.25));
    assert_eq!(observation.carrier_phase.unwrap().0, 110_000_000.5);
    assert_eq!((observation.doppler_hz, observation.cn0_db_hz), (Some(-1234.5), Some(44.0)));
    assert!(!observation.half_cycle);
}

#[test]
fn systems_and_signals_have_their_rinex_codes() {
    let signal = |system, number, signal| Measurement { system, number, signal, ..PLAIN };
    let measurements = [
        signal(0, 1, 3),
        signal(0, 1, 7),
        signal(2, 36, 0),
        signal(2, 36, 6),
        signal(3, 63, 1),
        signal(3, 63, 5),
        signal(5, 2, 5),
        signal(6, 24, 2),
        signal(1, 120, 0),
        signal(6, 255, 0),
        signal(0, 1, 15),
    ];
    let (events, statistics) = decode(&rawx(1.0, &measurements), None);
    let found = epochs(events);
    let named: Vec<String> =
        found[0].observations.iter().map(|o| format!("{} {}", o.satellite, o.code)).collect();
    let expected = ["G01 2L", "G01 5Q", "R24 2C", "E36 1C", "E36 7Q", "C63 1P", "C63 2I", "J02 2L"];
    assert_eq!(named, expected);
    let of = |reason| statistics.refused_for(reason);
    assert_eq!((of(Refusal::OtherConstellation), of(Refusal::UnknownSatellite)), (1, 1));
    let constellation = graphfix::gnss::Constellation::Gps;
    assert_eq!(of(Refusal::UnknownSignal { constellation, index: 15 }), 1);
}

#[test]
fn lock_and_half_cycles_follow_the_tracking_status() {
    let lost_and_half = |measurements: &[Measurement]| -> Vec<(bool, bool)> {
        let frames: Vec<u8> = measurements
            .iter()
            .enumerate()
            .flat_map(|(second, measurement)| rawx(second as f64, &[*measurement]))
            .collect();
        let flags = |o: &Observation| (o.loss_of_lock, o.half_cycle);
        read(&frames).iter().map(|epoch| flags(&epoch.observations[0])).collect()
    };
    let lock = |lock_ms| Measurement { lock_ms, ..PLAIN };
    let status = |status| Measurement { status, ..PLAIN };
    // Lock times: the first one, one that rises, one that falls, and zero.
    let found = lost_and_half(&[lock(4000), lock(5000), lock(900), lock(0), lock(1000)]);
    assert_eq!(found.iter().map(|f| f.0).collect::<Vec<_>>(), [true, false, true, true, false]);
    // The half cycle is unresolved, then resolved, and then subtracted from the phase.
    let found = lost_and_half(&[status(3), status(7), status(15), status(15)]);
    assert_eq!(found, [(true, true), (false, false), (true, false), (false, false)]);
    // A loss while there is no phase is reported with the next phase.
    let found = lost_and_half(&[lock(4000), Measurement { status: 1, ..lock(0) }, lock(9000)]);
    assert_eq!(found, [(true, false), (false, false), (true, false)]);
    let worst = Measurement { phase_deviation: 15, ..PLAIN };
    assert_eq!(lost_and_half(&[PLAIN, worst, PLAIN])[1], (true, false));
}

/// A loss within a pause, after which the lock time is again longer than before it.
#[test]
fn lock_is_lost_where_its_time_does_not_reach_the_last_phase() {
    let lost = |frames: &[(f64, Measurement)]| -> Vec<bool> {
        let bytes: Vec<u8> = frames.iter().flat_map(|(t, one)| rawx(*t, &[*one])).collect();
        read(&bytes).iter().map(|epoch| epoch.observations[0].loss_of_lock).collect()
    };
    let lock = |lock_ms| Measurement { lock_ms, ..PLAIN };
    let without_phase = |lock_ms| Measurement { status: 1, ..lock(lock_ms) };
    let pause = lost(&[(0.0, lock(600)), (47.0, lock(740)), (48.0, lock(1740))]);
    assert_eq!(pause, [true, true, false]);
    // Lock times in whole milliseconds, of epochs between them.
    let thirds = [(0.0, lock(600)), (1.0 / 3.0, lock(933)), (2.0 / 3.0, lock(1266))];
    assert_eq!(lost(&thirds), [true, false, false]);
    // The epochs between have no phase.
    let none = [(0.0, lock(600)), (1.0, without_phase(700)), (2.0, lock(1700))];
    assert_eq!(lost(&none), [true, false, true]);
    // The counter does not go on beyond 64.5 s.
    assert_eq!(lost(&[(0.0, lock(9000)), (200.0, lock(64_500))]), [true, false]);
}

#[test]
fn broken_frames_are_told_with_their_place() {
    let good = rawx(1.0, &[PLAIN]);
    let mut broken = good.clone();
    broken[30] ^= 4;
    let (events, statistics) = decode(&[broken, good.clone()].concat(), None);
    assert_eq!(epochs(events).len(), 1);
    assert_eq!(statistics.refused_for(Refusal::Checksum), 1);
    assert_eq!(statistics.refusals()[0].offsets, [0]);
    assert_eq!(statistics.garbage_bytes(), good.len() as u64);
    let short = ubx_frame(0x02, 0x15, &good[6..good.len() - 9]);
    let (_, statistics) = decode(&short, None);
    assert_eq!(statistics.refused_for(Refusal::Truncated), 1);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// The result does not depend on how a stream is split.
    #[test]
    fn any_split_gives_the_same(piece in 1_usize..300) {
        let mut bytes = b"\xb5\x62junk$".to_vec();
        for second in 0..5 {
            bytes.extend(rawx(f64::from(second), &[PLAIN, Measurement { number: 9, ..PLAIN }]));
            bytes.extend_from_slice(b"$GNGGA,,,*00\r\n\xb5\x62\x02\x15");
        }
        let whole = decode(&bytes, None);
        prop_assert_eq!(whole.0.len(), 5);
        prop_assert_eq!(decode_in_pieces(&bytes, None, piece), whole);
    }

    /// Any payload of the decoded messages is decoded or refused.
    #[test]
    fn no_payload_panics(
        id in 0_usize..4,
        payload in proptest::collection::vec(any::<u8>(), 0..200),
    ) {
        let (class, id) = [(0x02, 0x15), (0x02, 0x13), (0x01, 0x07), (0x01, 0x20)][id];
        let (_, statistics) = decode(&ubx_frame(class, id, &payload), None);
        prop_assert_eq!(statistics.of(MessageKind::Ubx { class, id }).total(), 1);
    }
}

/// All observations of a log agree with the RINEX beside it, including lock and half cycles. RTKLIB
/// does not report three losses after which the lock time is longer than before, but shorter than
/// the second between the epochs.
#[test]
fn a_recording_is_its_rinex() {
    let Some(folder) = data::set("spirent-ubx") else { return };
    let log = folder.join("spirent_f9p_static_15min.ubx");
    let ours = read(&unpacked(&log));
    let theirs = reading::epochs(&log.with_extension("obs"));
    let expected =
        Agreement { epochs: 931, observations: 28_669, flags: 3, ..Agreement::default() };
    assert_eq!(streams::compare(&ours, &theirs), expected);
    assert_eq!(ours.len(), 931);
}

/// The logs of Galway contain all observations of RTKLIB's RINEX, and more epochs: RTKLIB skips
/// frames after damaged ones.
///
/// Phases whose standard deviation is above 0.02 cycles by the receiver are not in that RINEX.
#[test]
fn logs_with_broken_frames_give_all_their_epochs() {
    for (name, own_epochs, epochs, observations, more_phases) in [
        ("galway-static/rover-20181004-1237", 1205, 1202, 25_291, 68),
        ("galway-static/base-20181004-1236", 321, 283, 5918, 6),
        ("galway-walk/rover-20181004-1532", 1180, 1180, 22_011, 471),
        ("galway-walk/base-20181004-1452", 882, 763, 14_964, 47),
    ] {
        let (set, file) = name.split_once('/').unwrap();
        let Some(folder) = data::set(set) else { continue };
        let ours = read(&unpacked(&folder.join(format!("{file}.ubx.gz"))));
        let theirs = reading::epochs(&folder.join(format!("{file}.obs.gz")));
        let found = streams::compare(&ours, &theirs);
        assert_eq!(ours.len(), own_epochs, "{name}");
        let seen = (found.epochs, found.observations, found.more_phases);
        assert_eq!(seen, (epochs, observations, more_phases), "{name}");
        assert_eq!(found.only, [0, 0], "{name}");
    }
}

/// A base sends its observations also as RTCM 3: RXM-RAWX is used, and the station from 1005.
#[test]
fn rawx_is_preferred_and_the_station_read() {
    let Some(folder) = data::set("galway-static") else { return };
    let bytes = unpacked(&folder.join("base-20181004-1236.ubx.gz"));
    let (events, statistics) = decode(&bytes, None);
    let of = |number| statistics.of(MessageKind::Rtcm(number)).total();
    assert_eq!([1005, 1077, 1087, 1230].map(of), [648, 607, 623, 685]);
    assert_eq!(statistics.refused_for(Refusal::Superseded), 606 + 623);
    let stations = events.iter().filter_map(|event| match event {
        Event::Station(station) => station.antenna_reference_point,
        _ => None,
    });
    let points: Vec<_> = stations.collect();
    assert_eq!(points.len(), 1);
    assert!((points[0].0.x - 3_774_089.212).abs() < 1e-4, "{points:?}");
}

/// Subframes give the same ephemerides as RTKLIB from the same logs.
#[test]
fn ephemerides_are_those_of_the_rinex() {
    for (name, count) in [
        ("spirent-ubx/spirent_f9p_static_15min.ubx", 47),
        ("galway-static/rover-20181004-1237.ubx.gz", 22),
        ("galway-walk/rover-20181004-1532.ubx.gz", 22),
    ] {
        let (set, file) = name.split_once('/').unwrap();
        let Some(folder) = data::set(set) else { continue };
        let ours = streams::navigation(&decode(&unpacked(&folder.join(file)), None).0);
        let stem = file.split_once(".ubx").unwrap().0;
        let beside = [format!("{stem}.nav"), format!("{stem}.ubx.nav")];
        let beside = beside.iter().map(|name| folder.join(name)).find(|path| path.is_file());
        let theirs = streams::rinex_navigation(&unpacked(&beside.unwrap()));
        let found = streams::compare_ephemerides(&ours, &theirs);
        assert_eq!((found, ours.len()), (count, count), "{name}");
    }
}

/// A receiver of all systems: also ephemerides of BeiDou and QZSS, ionosphere and leap seconds.
#[test]
fn all_systems_of_a_receiver_are_decoded() {
    let Some(folder) = data::set("formats") else { return };
    let bytes = unpacked(&folder.join("ubx/polyu_COM18_240925_072456.ubx"));
    let (events, statistics) = decode(&bytes, None);
    let ours = streams::navigation(&events);
    assert_eq!(ours.len(), 8 + 4 + 7 + 10 + 3);
    assert_eq!(statistics.refused_for(Refusal::Parity), 1);
    let seconds = events.iter().find_map(|event| match event {
        Event::LeapSeconds(seconds) => Some(*seconds),
        _ => None,
    });
    assert_eq!(seconds, Some(18));
    let of = |wanted: fn(&Ionosphere) -> bool| {
        events.iter().any(|event| matches!(event, Event::Ionosphere(i) if wanted(i)))
    };
    assert!(of(|i| matches!(i, Ionosphere::Galileo(c) if c.ai[0] == 200.5)));
    assert!(of(|i| matches!(i, Ionosphere::BeiDou(c) if c.beta[0] == 110_592.0)));
    assert!(of(|i| matches!(i, Ionosphere::Qzss(_))));
    if streams::has_convbin() {
        let (_, rinex) = streams::convbin(&bytes, "ubx", None);
        // RTKLIB 2.4.3 makes no ephemeris of this log's Galileo pages.
        assert_eq!(
            streams::compare_ephemerides(&ours, &streams::rinex_navigation(&rinex)),
            8 + 4 + 10 + 3
        );
    }
}

/// Messages by type as `pyubx2` 1.4 counts them: `UBXReader(stream, protfilter=7).read()`.
#[test]
fn message_counts_are_those_of_pyubx2() {
    let Some(folder) = data::set("formats") else { return };
    for (name, expected) in [
        (
            "F9T-L2-5min.ubx.gz",
            "UBX 01-01: 299, UBX 01-04: 299, UBX 01-07: 299, UBX 01-11: 299, UBX 01-20: 299, \
             UBX 01-22: 299, UBX 01-26: 1, UBX 01-35: 299, UBX 01-43: 299, UBX 01-61: 299, \
             UBX 02-15: 299, UBX 0A-38: 75",
        ),
        ("afl_rxm_rawx.ubx", "UBX 02-15: 1"),
        ("afl_rxm_sfrbx_gal.ubx", "UBX 02-13: 4"),
        ("afl_rxm_sfrbx_gps.ubx", "UBX 02-13: 3"),
        (
            "polyu_COM18_240925_072456.ubx",
            "UBX 01-07: 196, UBX 02-13: 2381, UBX 02-15: 196, UBX 05-01: 24, UBX 06-8B: 48, \
             UBX 0A-04: 2, NMEA: 5805",
        ),
        ("rtklib_ubx_20080526.ubx", "UBX 02-10: 242, UBX 02-11: 842, NMEA: 2563"),
    ] {
        let (_, statistics) = decode(&unpacked(&folder.join("ubx").join(name)), None);
        assert_eq!(counts(&statistics, |_| true), expected, "{name}");
    }
}

fn graphfix(arguments: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_graphfix")).args(arguments).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    assert!(output.status.success(), "{}", text(&output.stderr));
    text(&output.stdout)
}

/// Positions of a solution file: seconds of week and ECEF or degrees as written.
fn positions(path: &Path) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(path).unwrap();
    let lines = text.lines().filter(|line| !line.starts_with('%'));
    lines
        .map(|line| line.split_whitespace().skip(1).take(4).map(|n| n.parse().unwrap()).collect())
        .collect()
}

/// A UBX log alone gives the same positions as its RINEX; RTCM 3 is dated or refused.
#[test]
fn a_log_alone_is_positioned_as_its_rinex() {
    let Some(folder) = data::set("spirent-ubx") else { return };
    let output = tempfile::tempdir().unwrap();
    let file = |name: &str| output.path().join(name).to_str().unwrap().to_owned();
    let input = |ending: &str| {
        folder.join(format!("spirent_f9p_static_15min.{ending}")).to_str().unwrap().to_owned()
    };
    let solve = |rover: &str, nav: &str, to: &str| {
        graphfix(&["solve", "--mode", "spp", "--rover", rover, "--nav", nav, "--output", to])
    };
    let summary = solve(&input("ubx"), &input("ubx"), &file("ubx.pos"));
    assert!(summary.starts_with("931 epochs, 9"), "{summary}");
    solve(&input("obs"), &input("nav"), &file("obs.pos"));
    let (raw, rinex) =
        (positions(Path::new(&file("ubx.pos"))), positions(Path::new(&file("obs.pos"))));
    assert_eq!(raw.len(), rinex.len());
    assert!(900 < raw.len());
    for (raw, rinex) in raw.iter().zip(&rinex) {
        assert_eq!(raw[0], rinex[0]);
        // 1e-7 degrees are a centimetre: RINEX's digits and those of its ionosphere coefficients.
        assert!(
            (raw[1] - rinex[1]).abs() < 1e-7 && (raw[2] - rinex[2]).abs() < 1e-7,
            "{raw:?} {rinex:?}"
        );
        assert!((raw[3] - rinex[3]).abs() < 0.02, "{raw:?} {rinex:?}");
    }
}

/// Damaged logs, and damaged messages with a right checksum, never cause a panic.
#[test]
fn mutated_logs_never_panic() {
    let mut sources = vec![(0..50).flat_map(|s| rawx(f64::from(s), &[PLAIN; 12])).collect()];
    if let Some(folder) = data::set("formats") {
        for name in ["polyu_COM18_240925_072456.ubx", "F9T-L2-5min.ubx.gz"] {
            sources.push(unpacked(&folder.join("ubx").join(name)));
        }
    }
    let reference = Some(TimeReference::Day(at(2333, 285_000.0)));
    let mut random = Random::new(0x5eed_0002);
    let mut left = streams::mutated_bytes() as i64;
    while 0 < left {
        let source: &Vec<u8> = &sources[random.below(sources.len())];
        let start = random.below(source.len());
        let mut piece = source[start..source.len().min(start + 8192)].to_vec();
        let mut sealed = Vec::new();
        for message in piece.windows(6).enumerate().filter(|(_, head)| head[..2] == *b"\xb5\x62") {
            let (at, head) = message;
            let length = usize::from(u16::from_le_bytes([head[4], head[5]]));
            let Some(payload) = piece.get(at + 6..at + 6 + length) else { continue };
            let mut payload = payload.to_vec();
            streams::mutate(&mut payload, &mut random);
            sealed.extend(ubx_frame(head[2], head[3], &payload));
        }
        streams::mutate(&mut piece, &mut random);
        left -= (piece.len() + sealed.len()) as i64;
        let _ = decode(&piece, reference);
        let _ = decode(&sealed, reference);
    }
}
