//! Raw bytes of receivers: RTCM 3, UBX and NMEA, alone or interleaved, in chunks of any size.
//!
//! [`Decoder`] takes bytes as they arrive and yields epochs, ephemerides, ionosphere coefficients,
//! leap seconds and data of the station. Bytes that do not begin a frame with a valid checksum are
//! skipped one by one. Memory is bounded: one frame, one epoch and the satellites' latest
//! subframes. [`Statistics`] counts messages by type and everything left out by reason, with its
//! first positions in the stream.
//!
//! If a stream has an epoch more than once, RXM-RAWX comes before MSM, and MSM before the older
//! messages of RTCM 3. In a stream with RXM-RAWX, observations of RTCM 3 are never used: in a
//! rover's log they are those of its base.

mod assembly;
mod checksums;
mod frames;
mod reader;
mod statistics;
mod stream;

pub use reader::{ReceiverError, ReceiverReader};
pub use statistics::{MessageCount, MessageKind, RefusalEntry, Statistics};
pub use stream::{Decoder, Event};

pub use crate::formats::binary::{Ionosphere, Refusal, TimeReference};
pub use crate::formats::rtcm::Station;
pub use crate::formats::ubx::RawxWriter;

use frames::{Frame, FrameBuffer, Scan};

/// Whether the first bytes of a file hold a complete frame of UBX or RTCM 3.
pub(crate) fn is_receiver_data(head: &[u8]) -> bool {
    let mut frames = FrameBuffer::new();
    frames.push(head);
    while let Some(scan) = frames.next(false) {
        if matches!(scan, Scan::Frame { frame: Frame::Ubx { .. } | Frame::Rtcm(_), .. }) {
            return true;
        }
    }
    false
}
