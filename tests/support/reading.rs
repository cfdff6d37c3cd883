//! Files of recordings, packed or not.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

use graphfix::formats::decompress;
use graphfix::formats::rinex::{ObservationReader, read_navigation};
use graphfix::gnss::{Epoch, GpsTime, Navigation};

pub(crate) fn open(path: &Path) -> impl BufRead + use<> {
    let file = File::open(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    decompress(BufReader::new(file))
}

/// All epochs of an observation file.
pub(crate) fn epochs(path: &Path) -> Vec<Epoch> {
    read(open(path))
}

/// All epochs of an observation file's content.
pub(crate) fn epochs_of(content: &[u8]) -> Vec<Epoch> {
    read(content)
}

fn read(input: impl BufRead) -> Vec<Epoch> {
    let mut reader = ObservationReader::new(input).unwrap();
    let (mut epochs, mut epoch) = (Vec::new(), Epoch::new(GpsTime::EPOCH));
    while reader.read_epoch(&mut epoch).unwrap() {
        epochs.push(epoch.clone());
    }
    epochs
}

/// The navigation data of some files of a folder, merged.
pub(crate) fn navigation(folder: &Path, files: &[&str]) -> Navigation {
    let mut navigation = Navigation::default();
    for file in files {
        navigation.merge(read_navigation(open(&folder.join(file))).unwrap().0);
    }
    navigation
}
