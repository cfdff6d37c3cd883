//! Logs of GnssLogger are written from the simulator's epochs and read back. Also logs like those
//! of other versions of the app and of other phones, and damaged logs.

use std::collections::BTreeSet;
use std::sync::Arc;

use graphfix::config::{Mode, PositioningOptions, Profile};
use graphfix::formats::gnss_logger::{Cause, Decoder, LogFileError, LogReader, LogWriter, Skipped};
use graphfix::gnss::{Constellation, Epoch, GpsTime, Navigation, Observation, Solution};
use graphfix::positioning::{Aiding, Estimator};
use graphfix::simulation::{Scenario, Simulator};

use crate::support::streams::{self, Random};

/// A simulated drive.
struct Drive {
    epochs: Vec<Epoch>,
    navigation: Arc<Navigation>,
    log: String,
}

fn drive(name: &str, duration_s: f64) -> Drive {
    let constellations = Constellation::ALL.to_vec();
    let named = Scenario::by_name(name).unwrap();
    let scenario = Scenario { duration_s, constellations, ..named };
    let simulator = Simulator::new(scenario, 11);
    let navigation = simulator.navigation().clone();
    let epochs: Vec<Epoch> = simulator.map(|epoch| epoch.rover).collect();
    let mut writer = LogWriter::new(Vec::new(), &navigation).unwrap();
    for epoch in &epochs {
        assert_eq!(writer.write_epoch(epoch).unwrap(), epoch.observations.len());
    }
    let log = String::from_utf8(writer.finish().unwrap()).unwrap();
    Drive { epochs, navigation, log }
}

fn read(log: &str) -> (Vec<Epoch>, Skipped) {
    let mut reader = LogReader::new(log.as_bytes());
    let (mut epochs, mut epoch) = (Vec::new(), Epoch::new(GpsTime::EPOCH));
    while reader.read_epoch(&mut epoch).unwrap() {
        epochs.push(epoch.clone());
    }
    (epochs, reader.skipped().clone())
}

/// The fields of each record after `change`; other lines unchanged.
fn with_records(log: &str, mut change: impl FnMut(&mut Vec<String>)) -> String {
    let line = |line: &str| {
        if !line.starts_with("Raw,") {
            return format!("{line}\n");
        }
        let mut fields: Vec<String> = line.split(',').map(str::to_owned).collect();
        change(&mut fields);
        fields.join(",") + "\n"
    };
    log.lines().map(line).collect()
}

/// The index of a column.
fn column(log: &str, name: &str) -> usize {
    let title = log.lines().find(|line| line.starts_with("# Raw,")).unwrap();
    title.split(',').position(|column| column == name).unwrap()
}

/// The expected loss-of-lock indicators: those of the epochs, and of every signal that had no phase
/// in the epoch before.
fn with_gaps(epochs: &[Epoch]) -> Vec<Epoch> {
    let mut before = BTreeSet::new();
    let mut epochs = epochs.to_vec();
    for epoch in &mut epochs {
        epoch.observations.sort_by_key(|observation| observation.satellite);
        let signals = |o: &&mut Observation| o.carrier_phase.is_some();
        let mut now = BTreeSet::new();
        for observation in epoch.observations.iter_mut().filter(signals) {
            let signal = (observation.satellite, observation.code);
            observation.loss_of_lock |= !before.contains(&signal);
            now.insert(signal);
        }
        before = now;
    }
    epochs
}

/// All values agree within the resolution of a double: 10 µm of range, 0.1 mm of phase.
fn assert_same(read: &[Epoch], expected: &[Epoch]) {
    assert_eq!(read.len(), expected.len());
    let near = |a: Option<f64>, b: Option<f64>, tolerance: f64| match (a, b) {
        (Some(a), Some(b)) => (a - b).abs() < tolerance,
        (a, b) => a == b,
    };
    for (a, b) in read.iter().zip(expected) {
        assert_eq!((a.time, a.power_failure), (b.time, b.power_failure));
        assert_eq!(a.observations.len(), b.observations.len(), "{}", a.time);
        for (a, b) in a.observations.iter().zip(&b.observations) {
            assert_eq!((a.satellite, a.code), (b.satellite, b.code));
            assert_eq!((a.loss_of_lock, a.half_cycle), (b.loss_of_lock, b.half_cycle), "{a:?}");
            assert!(near(a.pseudorange_m, b.pseudorange_m, 1e-5), "{a:?} {b:?}");
            let cycles = |o: &Observation| o.carrier_phase.map(|phase| phase.0);
            assert!(near(cycles(a), cycles(b), 5e-4), "{a:?} {b:?}");
            assert!(near(a.doppler_hz, b.doppler_hz, 1e-9), "{a:?} {b:?}");
            assert_eq!(a.cn0_db_hz, b.cn0_db_hz);
        }
    }
}

fn positions(epochs: &[Epoch], navigation: &Navigation, mode: Mode) -> Vec<Solution> {
    let mut estimator = Estimator::new(PositioningOptions::new(mode, Profile::General));
    let aiding = Aiding::alone(navigation);
    epochs.iter().map(|epoch| estimator.advance(epoch, &aiding)).collect()
}

/// For every constellation and scenario: the same epochs, and the same positions to 1 mm.
#[test]
fn what_is_written_reads_back() {
    for name in ["open-sky", "urban-canyon"] {
        let drive = drive(name, 120.0);
        let expected = with_gaps(&drive.epochs);
        let (epochs, skipped) = read(&drive.log);
        assert!(skipped.is_empty(), "{name}: {skipped:?}");
        assert_same(&epochs, &expected);
        for constellation in Constellation::ALL {
            let is_of = |o: &Observation| o.satellite.constellation == constellation;
            assert!(epochs.iter().any(|epoch| epoch.observations.iter().any(is_of)));
        }
        for mode in [Mode::Spp, Mode::Fgo] {
            let made = positions(&expected, &drive.navigation, mode);
            for (a, b) in positions(&epochs, &drive.navigation, mode).iter().zip(&made) {
                let position = |solution: &Solution| solution.estimate.as_ref().map(|e| e.position);
                let (Some(a), Some(b)) = (position(a), position(b)) else {
                    assert_eq!(position(a), position(b));
                    continue;
                };
                assert!((a.0 - b.0).norm() < 1e-3, "{name} {mode:?}: {} m", (a.0 - b.0).norm());
            }
        }
    }
}

/// The same log with its columns in reverse order, spaces after commas, other records in between,
/// and another system's line ends.
#[test]
fn the_title_decides_on_the_order() {
    let drive = drive("open-sky", 5.0);
    let mut text = String::new();
    for (index, line) in drive.log.lines().enumerate() {
        let (start, names) = match line.strip_prefix("# Raw,") {
            Some(names) => ("#   Raw", names),
            None => ("Raw", line.strip_prefix("Raw,").unwrap_or_default()),
        };
        if names.is_empty() {
            text += &format!("{line}\r\n");
            continue;
        }
        let reversed: Vec<&str> = names.split(',').rev().collect();
        text += &format!("{start},{}\r\n", reversed.join(", "));
        text += ["", "Fix,GPS,1,2\n", "UncalGyro,1,2,3\n", "# note\n"][index % 4];
    }
    let (epochs, skipped) = read(&text);
    assert_eq!(epochs, read(&drive.log).0);
    assert!(skipped.is_empty(), "{skipped:?}");
}

/// A phone that steers FullBiasNanos by up to 0.4 ms between epochs gives the same measurements,
/// since the oscillator of TimeNanos decides. If it steers by more than 0.5 ms, time tag and
/// pseudorange step together by a millisecond, and the phase does not.
#[test]
fn the_steered_bias_does_not_enter() {
    let drive = drive("open-sky", 20.0);
    let bias = column(&drive.log, "FullBiasNanos");
    let clock = column(&drive.log, "TimeNanos");
    let steered = |by_ns: fn(i64) -> i64| {
        with_records(&drive.log, |fields| {
            let second = fields[clock].parse::<i64>().unwrap() / 1_000_000_000;
            let bias_ns: i64 = fields[bias].parse().unwrap();
            fields[bias] = (bias_ns + by_ns(second)).to_string();
        })
    };
    let (plain, _) = read(&drive.log);
    assert_eq!(read(&steered(|second| second % 9 * 100_000 - 400_000)).0, plain);
    let (stepped, _) = read(&steered(|_| 600_000));
    for (a, b) in stepped.iter().zip(&plain) {
        assert_eq!(a.time.as_ns(), b.time.as_ns() - 1_000_000);
        for (a, b) in a.observations.iter().zip(&b.observations) {
            let shorter_m = b.pseudorange_m.unwrap() - a.pseudorange_m.unwrap();
            assert!((shorter_m - 299_792.458).abs() < 1e-6, "{shorter_m}");
            assert_eq!(a.carrier_phase, b.carrier_phase);
        }
    }
}

/// A discontinuity of the clock ends every arc, and so does an epoch whose phases are invalid.
#[test]
fn arcs_end_where_the_phone_says() {
    let drive = drive("open-sky", 6.0);
    let clock = column(&drive.log, "TimeNanos");
    let first: i64 = 1_000_000_000_000;
    let at = |fields: &[String], second: i64| {
        fields[clock].parse::<i64>().unwrap() - first >= second * 1_000_000_000
    };
    let (plain, _) = read(&drive.log);
    let lost = |log: &str| -> Vec<(bool, usize)> {
        let count = |e: &Epoch| e.observations.iter().filter(|o| o.loss_of_lock).count();
        read(log).0.iter().map(|epoch| (epoch.power_failure, count(epoch))).collect()
    };
    let tracked: Vec<usize> = plain.iter().map(|epoch| epoch.observations.len()).collect();
    let count = column(&drive.log, "HardwareClockDiscontinuityCount");
    let restarted = with_records(&drive.log, |fields| {
        fields[count] = if at(fields, 3) { "8" } else { "7" }.to_owned();
    });
    assert_eq!(lost(&restarted)[3], (true, tracked[3]));
    assert_eq!(lost(&restarted)[4], lost(&drive.log)[4]);
    let state = column(&drive.log, "AccumulatedDeltaRangeState");
    let reset = with_records(&drive.log, |fields| {
        if at(fields, 3) && !at(fields, 4) {
            fields[state] = "18".to_owned();
        }
    });
    let (epochs, _) = read(&reset);
    assert!(epochs[3].observations.iter().all(|o| o.carrier_phase.is_none()));
    assert_eq!((lost(&reset)[3], lost(&reset)[4]), ((false, 0), (false, tracked[4])));
}

/// Values that a phone does not know yet are left out and counted; the rest of the epoch is used.
#[test]
fn what_is_not_usable_is_left_out_and_counted() {
    let drive = drive("open-sky", 3.0);
    let [state, uncertainty, number, rate] = [
        "State",
        "ReceivedSvTimeUncertaintyNanos",
        "ReceivedSvTimeNanos",
        "PseudorangeRateUncertaintyMetersPerSecond",
    ]
    .map(|name| column(&drive.log, name));
    let mut index = 0;
    let damaged = with_records(&drive.log, |fields| {
        index += 1;
        match index {
            1 => fields[state] = "0".to_owned(),
            2 => fields[state] = "3".to_owned(),
            3 => fields[uncertainty] = "501".to_owned(),
            4 => fields[number] = "12three".to_owned(),
            5 => fields[number] = "0".to_owned(),
            6 => fields[rate] = "10.5".to_owned(),
            7 => fields.truncate(state),
            _ => {}
        }
    });
    let (plain, _) = read(&drive.log);
    let (epochs, skipped) = read(&damaged);
    let known = plain.iter().map(|epoch| epoch.observations.len()).sum::<usize>();
    let kept = epochs.iter().map(|epoch| epoch.observations.len()).sum::<usize>();
    assert_eq!(kept, known - 6);
    let number = Cause::NotANumber { column: "ReceivedSvTimeNanos" };
    for cause in [
        Cause::NoCodeLock,
        Cause::Ambiguous,
        Cause::TransmissionUncertain,
        number,
        Cause::ImpossibleFlight,
        Cause::RateUncertain,
        Cause::Blank { column: "ConstellationType" },
    ] {
        assert_eq!(skipped.count(cause), 1, "{cause}: {skipped:?}");
    }
    let title = drive.log.lines().position(|line| line.starts_with("# Raw,")).unwrap() as u64;
    let entry = skipped.entries().iter().find(|entry| entry.reason == number).unwrap();
    assert_eq!(entry.lines, [title + 2 + 4]);
    let none = with_records(&drive.log, |fields| fields[state] = "1".to_owned());
    let mut epoch = Epoch::new(GpsTime::EPOCH);
    let error = LogReader::new(none.as_bytes()).read_epoch(&mut epoch).unwrap_err();
    assert!(
        matches!(error, LogFileError::NothingUsable { records, .. } if records == known as u64)
    );
    assert!(error.to_string().contains("time of transmission is ambiguous"), "{error}");
}

/// Chunks of any size give the epochs of the whole, and damaged logs never panic.
#[test]
fn mutated_logs_never_panic_wherever_they_are_split() {
    let log = drive("urban-canyon", 60.0).log.into_bytes();
    let header = log.iter().position(|byte| *byte == b'R').unwrap_or_default();
    let title = String::from_utf8_lossy(&log[..header + 2000]).find("\nRaw,").unwrap() + 1;
    let mut random = Random::new(0x5eed_0003);
    let mut left = streams::mutated_bytes() as i64;
    let mut usable = 0;
    while 0 < left {
        let start = title + random.below(log.len() - title);
        let mut piece = log[start..log.len().min(start + 4096)].to_vec();
        streams::mutate(&mut piece, &mut random);
        left -= piece.len() as i64;
        let split = random.below(piece.len() + 1);
        let [whole, halves] =
            [&[&piece[..], &[]], &[&piece[..split], &piece[split..]]].map(|chunks: &[&[u8]; 2]| {
                let (mut decoder, mut epochs) = (Decoder::new(), Vec::new());
                let outcome = [&log[..title], chunks[0], chunks[1]]
                    .iter()
                    .try_for_each(|chunk| decoder.push(chunk, &mut epochs))
                    .and_then(|()| decoder.finish(&mut epochs));
                (outcome, epochs, decoder.skipped().clone())
            });
        assert_eq!(whole, halves);
        usable += whole.1.iter().map(|epoch| epoch.observations.len()).sum::<usize>();
    }
    assert!(2_000 < usable, "{usable} measurements survived: the damage is too large to test");
}
