//! Any bytes as a stream, whole and split in two: no panic, and the same events.
#![no_main]

use graphfix::formats::receiver::{Decoder, TimeReference};
use graphfix::gnss::GpsTime;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let reference = Some(TimeReference::Day(GpsTime::from_week_seconds(2046, 1000.0)));
    let (mut whole, mut split) = (Decoder::new(reference), Decoder::new(reference));
    let (mut of_whole, mut of_split) = (Vec::new(), Vec::new());
    whole.push(data, &mut of_whole);
    whole.finish(&mut of_whole);
    let (first, second) = data.split_at(data.len() / 2);
    split.push(first, &mut of_split);
    split.push(second, &mut of_split);
    split.finish(&mut of_split);
    assert_eq!(of_whole.len(), of_split.len());
});
