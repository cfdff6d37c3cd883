//! RINEX goldens on real files: what decodes, what is refused, and how much comes out.

use std::fmt::Write;
use std::fs::{self, File};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

use graphfix::formats::decompress;
use graphfix::formats::rinex::{ObservationReader, RinexError, Skipped, read_navigation};
use graphfix::gnss::{Epoch, GpsTime};

use crate::data;

/// What becomes of each file, judged one by one: the counts of observation files agree with
/// `scripts/count_rinex.py`, and each reason with the lines it names.
const OUTCOMES: &str = include_str!("rinex/outcomes.txt");

fn open(path: &Path) -> impl BufRead {
    decompress(BufReader::new(File::open(path).unwrap()))
}

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

/// One line that says what became of a file.
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
            Err(error) => return format!("{} at line {}", error.code(), error.line()),
        },
        Err(error) => return format!("{} at line {}", error.code(), error.line()),
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
