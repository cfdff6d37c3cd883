//! Any bytes as payloads of RTCM 3 frames with a right CRC: what is behind the CRC must hold too.
#![no_main]

use graphfix::formats::receiver::{Decoder, TimeReference};
use graphfix::gnss::GpsTime;
use libfuzzer_sys::fuzz_target;

/// CRC-24Q, bit by bit.
fn crc24q(bytes: &[u8]) -> u32 {
    bytes.iter().fold(0, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte) << 16, |crc, _| {
            let shifted = crc << 1;
            if shifted & 0x100_0000 == 0 { shifted } else { shifted ^ 0x186_4cfb }
        })
    })
}

fuzz_target!(|data: &[u8]| {
    let mut decoder =
        Decoder::new(Some(TimeReference::Day(GpsTime::from_week_seconds(2046, 1000.0))));
    let mut events = Vec::new();
    for payload in data.chunks(160) {
        let mut frame = vec![0xd3, (payload.len() >> 8) as u8, payload.len() as u8];
        frame.extend_from_slice(payload);
        frame.extend_from_slice(&crc24q(&frame).to_be_bytes()[1..]);
        decoder.push(&frame, &mut events);
    }
    decoder.finish(&mut events);
});
