//! Decoding speed of receivers' bytes: real logs in memory, where available.
//!
//! `cargo bench --bench decoders` prints the bytes per second of one core.

use std::fs;
use std::hint::black_box;
use std::io::Read;
use std::path::Path;

use divan::Bencher;
use divan::counter::BytesCount;
use graphfix::formats::decompress;
use graphfix::formats::receiver::{Decoder, Event, TimeReference};
use graphfix::gnss::GpsTime;

fn main() {
    divan::main();
}

/// The bytes of a file of the data folder, unpacked; `None` if it is absent.
fn real(name: &str) -> Option<Vec<u8>> {
    let root = std::env::var_os("GRAPHFIX_DATA").unwrap_or_else(|| "../shared/data".into());
    let packed = fs::read(Path::new(&root).join(name)).ok()?;
    let mut bytes = Vec::new();
    decompress(packed.as_slice()).read_to_end(&mut bytes).ok()?;
    Some(bytes)
}

fn observations(bytes: &[u8]) -> usize {
    let reference = TimeReference::Week(GpsTime::from_week_seconds(2046, 302_400.0));
    let mut decoder = Decoder::new(Some(reference));
    let mut events = Vec::new();
    let mut count = 0;
    for piece in bytes.chunks(1 << 16) {
        decoder.push(piece, &mut events);
        for event in events.drain(..) {
            if let Event::Epoch(epoch) = black_box(event) {
                count += epoch.observations.len();
            }
        }
    }
    count
}

#[divan::bench(sample_count = 50, args = [
    "formats/rtcm3/missing-beidou-STR17.rtcm3",
    "formats/rtcm3/switch-legacy-msm-legacy-msm.rtcm",
    "formats/rtcm3/trimble.rtcm",
    "formats/rtcm3/rtklib_testglo.rtcm3",
    "formats/rtcm3/eph.rtcm",
])]
fn rtcm(bencher: Bencher, name: &str) {
    let Some(bytes) = real(name) else { return };
    bencher.counter(BytesCount::of_slice(&bytes)).bench(|| observations(black_box(&bytes)));
}

#[divan::bench(sample_count = 50, args = [
    "spirent-ubx/spirent_f9p_static_15min.ubx",
    "formats/ubx/polyu_COM18_240925_072456.ubx",
    "formats/ubx/F9T-L2-5min.ubx.gz",
    "galway-walk/base-20181004-1452.ubx.gz",
])]
fn ubx(bencher: Bencher, name: &str) {
    let Some(bytes) = real(name) else { return };
    bencher.counter(BytesCount::of_slice(&bytes)).bench(|| observations(black_box(&bytes)));
}
