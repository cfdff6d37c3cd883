//! Reading speed of RINEX: a simulated RINEX 3 file in memory, and real files where available.
//!
//! `cargo bench --bench rinex` prints the bytes per second of one core.

use std::fs;
use std::hint::black_box;
use std::path::Path;

use divan::Bencher;
use divan::counter::BytesCount;
use graphfix::formats::rinex::{
    ObservationHeader, ObservationReader, ObservationWriter, RinexVersion, read_navigation,
};
use graphfix::gnss::{
    Constellation, Cycles, Epoch, GpsTime, Observation, ObservationCode, SatelliteId,
};

fn main() {
    divan::main();
}

/// Twenty megabytes of forty satellites with three signals, without gaps.
fn simulated() -> Vec<u8> {
    let codes = ["1C", "2W", "5Q"].map(|code| ObservationCode::parse(code).expect("a code"));
    let mut header = ObservationHeader::new(RinexVersion::new(3, 5));
    header.codes[Constellation::Gps.index()] = codes.to_vec();
    header.codes[Constellation::Galileo.index()] = codes.to_vec();
    let mut writer = ObservationWriter::new(Vec::new(), &header).expect("memory takes all");
    for second in 0..2_600 {
        let mut epoch = Epoch::new(GpsTime::from_week_seconds(2051, f64::from(second)));
        for index in 0..40_u8 {
            let system = [Constellation::Gps, Constellation::Galileo][usize::from(index / 20)];
            let satellite = SatelliteId::new(system, index % 20 + 1).expect("a number of 1 to 20");
            let range_m = 2.1e7 + f64::from(index) * 123_456.789 + f64::from(second) * 321.123;
            epoch.observations.extend(codes.map(|code| Observation {
                pseudorange_m: Some(range_m),
                carrier_phase: Some(Cycles(range_m * 5.255)),
                doppler_hz: Some(-1234.5 + f64::from(index) * 60.25),
                cn0_db_hz: Some(44.25),
                ..Observation::empty(satellite, code)
            }));
        }
        writer.write_epoch(&epoch).expect("all signals are declared");
    }
    writer.finish().expect("memory takes all")
}

fn read_observations(bytes: &[u8]) -> usize {
    let mut reader = ObservationReader::new(bytes).expect("a RINEX header");
    let mut epoch = Epoch::new(GpsTime::EPOCH);
    let mut observations = 0;
    while reader.read_epoch(&mut epoch).expect("readable to its end") {
        observations += black_box(&epoch).observations.len();
    }
    observations
}

#[divan::bench(sample_count = 20)]
fn simulated_observations(bencher: Bencher) {
    let bytes = simulated();
    assert_eq!(read_observations(&bytes), 2_600 * 120);
    bencher.counter(BytesCount::of_slice(&bytes)).bench(|| read_observations(black_box(&bytes)));
}

/// A file of the data folder; `None` if it is absent.
fn real(name: &str) -> Option<Vec<u8>> {
    let root = std::env::var_os("GRAPHFIX_DATA").unwrap_or_else(|| "../shared/data".into());
    fs::read(Path::new(&root).join(name)).ok()
}

#[divan::bench(sample_count = 20, args = [
    "tst-2019/COM3_190428_124409.obs",
    "hers-hert/hers0010.18O",
    "meijo-static/rover.obs",
    "spirent-rtk/Base-static_MO_Spirent.obs",
])]
fn real_observations(bencher: Bencher, name: &str) {
    let Some(bytes) = real(name) else { return };
    bencher.counter(BytesCount::of_slice(&bytes)).bench(|| read_observations(black_box(&bytes)));
}

#[divan::bench(sample_count = 20, args = [
    "tst-2019/hksc1180.19b",
    "hers-hert/brdc0010.18n",
    "klt-2021/hksc1610.nav",
])]
fn real_navigation(bencher: Bencher, name: &str) {
    let Some(bytes) = real(name) else { return };
    bencher
        .counter(BytesCount::of_slice(&bytes))
        .bench(|| read_navigation(black_box(bytes.as_slice())).expect("a navigation file").0.len());
}
