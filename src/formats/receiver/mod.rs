//! Receivers' raw bytes: RTCM 3, UBX and NMEA, alone or interleaved, split anywhere.
//!
//! [`Decoder`] takes bytes as they come and yields epochs, ephemerides, ionosphere coefficients,
//! leap seconds and what is told of the station. Garbage is passed over byte by byte until a frame
//! with a right checksum begins. Memory is bounded: one frame, one epoch and the satellites' latest
//! subframes. Nothing is lost silently: [`Statistics`] counts messages by type and what was left
//! out by reason, with the first places in the stream.
//!
//! Where a stream gives one epoch more than once, RXM-RAWX is preferred to MSM and MSM to the older
//! messages of RTCM 3. Beside RXM-RAWX observations of RTCM 3 are never taken: in a rover's log
//! they are its base's.

mod assembly;
mod frames;
mod reader;
mod statistics;
mod stream;

pub use reader::{ReceiverError, ReceiverReader};
pub use statistics::{MessageCount, MessageKind, RefusalEntry, Statistics};
pub use stream::{Decoder, Event};

pub use crate::formats::binary::{Ionosphere, Refusal, TimeReference};
pub use crate::formats::rtcm::Station;

use frames::{Frame, FrameBuffer, Scan};

/// Whether the first bytes of a file hold a whole frame of UBX or RTCM 3.
pub fn is_receiver_data(head: &[u8]) -> bool {
    let mut frames = FrameBuffer::new();
    frames.push(head);
    while let Some(scan) = frames.next(false) {
        if matches!(scan, Scan::Frame { frame: Frame::Ubx { .. } | Frame::Rtcm(_), .. }) {
            return true;
        }
    }
    false
}
