//! RINEX goldens on real files: decoded content, refusals, and their numbers.

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use graphfix::formats::rinex::{ObservationReader, RinexError, Skipped, read_navigation};
use graphfix::gnss::{Cycles, Epoch, GpsTime};

use crate::support::data;
use crate::support::reading::open;

/// The expected outcome for each file, reviewed one by one. The counts of plain, undamaged
/// observation files agree with `scripts/count_rinex.py`. Each reason agrees with the lines that it
/// names.
const OUTCOMES: &str = include_str!("rinex/outcomes.txt");

/// All epochs of a file, with its reader.
fn read_epochs(path: &Path) -> Result<(Vec<Epoch>, Skipped), RinexError> {
    let mut reader = ObservationReader::new(open(path))?;
    let mut epochs = Vec::new();
    let mut epoch = Epoch::new(GpsTime::EPOCH);
    while reader.read_epoch(&mut epoch)? {
        epochs.push(epoch.clone());
    }
    Ok((epochs, reader.skipped().clone()))
}

/// One line with the outcome for a file.
fn outcome(path: &Path) -> String {
    let (mut text, skipped) = match read_epochs(path) {
        Ok((epochs, skipped)) => {
            let observations: usize = epochs.iter().map(|e| e.observations.len()).sum();
            (format!("{} epochs, {observations} observations", epochs.len()), skipped)
        }
        Err(RinexError::WrongKind { .. }) => match read_navigation(open(path)) {
            Ok((navigation, skipped)) => {
                let ionosphere = [
                    ("GPS", navigation.klobuchar_gps.is_some()),
                    ("BeiDou", navigation.klobuchar_beidou.is_some()),
                    ("QZSS", navigation.klobuchar_qzss.is_some()),
                    ("Galileo", navigation.nequick.is_some()),
                ];
                let named = ionosphere.iter().filter(|(_, there)| *there).map(|(name, _)| *name);
                let named = named.collect::<Vec<_>>().join(" ");
                (format!("{} ephemerides, ionosphere [{named}]", navigation.len()), skipped)
            }
            Err(error) => return format!("{} at line {}", error.code().name(), error.line()),
        },
        Err(error) => return format!("{} at line {}", error.code().name(), error.line()),
    };
    for entry in skipped.entries() {
        write!(text, "; {} × {} from line {}", entry.count, entry.reason, entry.lines[0]).unwrap();
    }
    text
}

fn rinex_files(root: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for folder in fs::read_dir(root).unwrap().map(|entry| entry.unwrap().path()) {
        let name = folder.file_name().unwrap().to_str().unwrap();
        if !matches!(name, "rtcm3" | "ubx") {
            files.extend(fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()));
        }
    }
    files.sort();
    files
}

#[test]
fn every_file_decodes_or_is_refused_as_judged() {
    let Some(root) = data::set("formats") else { return };
    let mut seen = String::new();
    for file in rinex_files(&root) {
        let name = file.strip_prefix(&root).unwrap().display().to_string();
        writeln!(seen, "{name}: {}", outcome(&file)).unwrap();
    }
    for (seen, expected) in seen.lines().zip(OUTCOMES.lines()) {
        assert_eq!(seen, expected);
    }
    assert_eq!(seen.lines().count(), OUTCOMES.lines().count(), "{seen}");
}

/// A CRINEX file and its plain twin give the same epochs.
#[test]
fn compact_twins_decode_to_equal_epochs() {
    let Some(root) = data::set("formats") else { return };
    let twins = [
        ("crx1/AJAC3550.21D", "obs2/AJAC3550.21O"),
        ("crx1/KOSG0010.95D", "obs2/KOSG0010.95O"),
        ("crx1/delf0010.21d", "obs2/delf0010.21o"),
        ("crx1/npaz3550.21d", "obs2/npaz3550.21o"),
        ("crx1/zegv0010.21d", "obs2/zegv0010.21o"),
        (
            "crx3/ACOR00ESP_R_20213550000_01D_30S_MO.crx",
            "obs3/ACOR00ESP_R_20213550000_01D_30S_MO.rnx",
        ),
        ("crx3/DUTH0630.22D", "obs3/DUTH0630.22O"),
        ("crx3/VLNS0630.22D", "obs3/VLNS0630.22O"),
        ("crx3/pdel0010.21d", "obs3/pdel0010.21o"),
        ("crx3/flrs0010.12d", "obs3/flrs0010.12o"),
    ];
    for (compact, plain) in twins {
        let (compact_epochs, _) = read_epochs(&root.join(compact)).unwrap();
        let (plain_epochs, _) = read_epochs(&root.join(plain)).unwrap();
        assert!(!plain_epochs.is_empty(), "{plain}");
        for (a, b) in compact_epochs.iter().zip(&plain_epochs) {
            assert_eq!(a, b, "{compact}");
        }
        assert_eq!(compact_epochs.len(), plain_epochs.len(), "{compact}");
    }
}

/// Numbers of epochs and observations in the data sets, as `scripts/count_rinex.py` counts them by
/// another method.
#[test]
fn counts_agree_with_an_independent_count() {
    let counts = [
        ("tst-2019/COM3_190428_124409.obs", 1760, 26_146),
        ("hers-hert/hers0010.18O", 2880, 57_766),
        ("hers-hert/hert0010.18O", 2880, 59_239),
        ("klt-2021/20210610.klt1.ublox.f9p.obs", 205, 10_250),
        ("klt-2021/hksc1610.obs", 205, 18_959),
        ("meijo-static/base.obs", 301, 44_240),
        ("meijo-static/rover.obs", 301, 45_089),
        ("spirent-rtk/Base-static_MO_Spirent.obs", 601, 60_100),
        ("spirent-ubx/spirent_f9p_static_15min.obs", 931, 28_669),
        ("galway-static/base-20181004-1236.obs.gz", 283, 5_918),
        ("galway-static/rover-20181004-1237.obs.gz", 1202, 25_291),
        ("galway-walk/rover-20181004-1532.obs.gz", 1180, 22_011),
        ("geonet/07590920.05o", 120, 1_872),
        ("geonet/30400920.05o", 120, 2_075),
        ("fujisawa-kinematic/3034265G.21O", 360, 23_040),
        ("fujisawa-kinematic/SEPT265G.21O", 360, 26_969),
    ];
    for (file, epochs, observations) in counts {
        let (set, name) = file.split_once('/').unwrap();
        let Some(folder) = data::set(set) else { continue };
        let (read, _) = read_epochs(&folder.join(name)).unwrap();
        let count: usize = read.iter().map(|epoch| epoch.observations.len()).sum();
        assert_eq!((read.len(), count), (epochs, observations), "{file}");
    }
}

/// The rover of hers-hert has P1 and no C1. P1 and the L1 phase become one observation.
#[test]
fn rinex_2_phase_goes_with_the_pseudorange_there_is() {
    let Some(folder) = data::set("hers-hert") else { return };
    let (epochs, _) = read_epochs(&folder.join("hers0010.18O")).unwrap();
    let first = &epochs[0].observations[0];
    assert_eq!(first.signal().to_string(), "G1W");
    assert_eq!(first.pseudorange_m, Some(24_133_243.234));
    assert_eq!(first.carrier_phase, Some(Cycles(126_821_078.928)));
    assert_eq!(epochs[0].observations[1].signal().to_string(), "G2W");
}

/// Column `X1` of meijo-static is a channel number. It is skipped, and the other columns keep their
/// meaning.
#[test]
fn unknown_types_keep_their_column() {
    let Some(folder) = data::set("meijo-static") else { return };
    let (epochs, _) = read_epochs(&folder.join("rover.obs")).unwrap();
    let first = &epochs[0].observations[0];
    assert_eq!(first.signal().to_string(), "C2I");
    assert_eq!(first.pseudorange_m, Some(36_842_422.530));
    assert_eq!(first.carrier_phase, Some(Cycles(191_848_164.080)));
    assert_eq!((first.doppler_hz, first.cn0_db_hz), (Some(161.587), Some(44.438)));
}
