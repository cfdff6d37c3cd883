//! Cost of the factor graph on an urban drive: `cargo bench --bench fgo`.
//!
//! The recording is `tst-2019` of the data folder (`GRAPHFIX_DATA`, else `../shared/data`); without
//! it nothing is measured.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use divan::Bencher;
use graphfix::config::{Mode, PositioningOptions, Profile};
use graphfix::formats::decompress;
use graphfix::formats::rinex::{ObservationReader, read_navigation};
use graphfix::gnss::{Epoch, GpsTime, Navigation};
use graphfix::positioning::{Aiding, Batch, Estimator};

fn main() {
    divan::main();
}

fn open(path: &Path) -> Option<impl std::io::BufRead + use<>> {
    Some(decompress(BufReader::new(File::open(path).ok()?)))
}

fn recording() -> Option<(Vec<Epoch>, Navigation)> {
    let root = std::env::var_os("GRAPHFIX_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
        PathBuf::from,
    );
    let folder = root.join("tst-2019");
    let mut navigation = Navigation::default();
    for file in ["hksc1180.19n", "hksc1180.19b"] {
        navigation.merge(read_navigation(open(&folder.join(file))?).ok()?.0);
    }
    let path = folder.join("COM3_190428_124409.obs");
    let mut reader = ObservationReader::new(open(&path)?).ok()?;
    let mut epoch = Epoch::new(GpsTime::from_ns(0));
    let mut epochs = Vec::new();
    while reader.read_epoch(&mut epoch).ok()? {
        epochs.push(epoch.clone());
    }
    Some((epochs, navigation))
}

fn options(kernel: &str, phase: &str, window_s: &str) -> PositioningOptions {
    let mut options = PositioningOptions::new(Mode::Fgo, Profile::UrbanVehicle);
    for (key, value) in [("pseudorange_kernel", kernel), ("phase", phase), ("window_s", window_s)] {
        options.set(key, value).expect("the options exist");
    }
    options
}

/// One causal update, from observations to solution, of a warm window.
#[divan::bench(
    args = [("huber", "off", "30"), ("geman-mcclure", "off", "30"), ("geman-mcclure", "on", "10")],
    sample_count = 1000, sample_size = 1,
)]
fn causal_update(bencher: Bencher, (kernel, phase, window_s): (&str, &str, &str)) {
    let Some((epochs, navigation)) = recording() else { return };
    let aiding = Aiding::alone(&navigation);
    let mut estimator = Estimator::new(options(kernel, phase, window_s));
    let mut source = epochs.iter();
    for epoch in source.by_ref().take(100) {
        estimator.advance(epoch, &aiding);
    }
    bencher.bench_local(|| {
        let epoch = source.next().expect("fewer samples than epochs");
        estimator.advance(epoch, &aiding)
    });
}

/// All epochs of the drive smoothed at once.
#[divan::bench(sample_count = 5, sample_size = 1)]
fn batch(bencher: Bencher) {
    let Some((epochs, navigation)) = recording() else { return };
    let aiding = Aiding::alone(&navigation);
    bencher.bench_local(|| {
        let mut batch = Batch::new(options("geman-mcclure", "on", "10"));
        epochs.iter().for_each(|epoch| batch.push(epoch, &aiding));
        batch.finish()
    });
}
