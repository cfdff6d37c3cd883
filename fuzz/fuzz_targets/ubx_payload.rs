//! Any bytes as payloads of RXM-RAWX and RXM-SFRBX with a right checksum.
#![no_main]

use graphfix::formats::receiver::{Decoder, TimeReference};
use graphfix::gnss::GpsTime;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let mut decoder =
        Decoder::new(Some(TimeReference::Day(GpsTime::from_week_seconds(2046, 1000.0))));
    let mut events = Vec::new();
    for payload in data.chunks(113) {
        let (id, payload) = payload.split_first().unwrap_or((&0, &[]));
        let id = if id & 1 == 0 { 0x15 } else { 0x13 };
        let length = (payload.len() as u16).to_le_bytes();
        let mut frame = vec![0xb5, 0x62, 0x02, id, length[0], length[1]];
        frame.extend_from_slice(payload);
        let sums = frame[2..].iter().fold((0_u8, 0_u8), |(a, b), byte| {
            let a = a.wrapping_add(*byte);
            (a, b.wrapping_add(a))
        });
        frame.extend([sums.0, sums.1]);
        decoder.push(&frame, &mut events);
    }
    decoder.finish(&mut events);
});
