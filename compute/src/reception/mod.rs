//! Decodes a receiver's stream that arrives in chunks: bytes in, epochs and navigation data out.
//!
//! `Stream` recognises the format by its first bytes: RINEX or CRINEX observations, an Android
//! GnssLogger log, or frames of RTCM 3 and UBX with other bytes between them; each of them may be
//! packed by gzip. The stream may be split into chunks anywhere; incomplete data waits for the next
//! chunk.
//!
//! Nothing here reads a clock or stores data. The owner of a stream stores its chunks. After a
//! crash it passes the bytes of `Stream::needed` to `Stream::restore`, and the restored stream
//! decodes the following bytes in the same way. Memory is bounded: one decoder or reader, and one
//! frame or the text of one epoch. CRINEX and gzip can only be read from their beginning, so all
//! bytes of such a stream are needed, and its length is limited.
//!
//! Messages about base stations (RTCM 3 messages 1005, 1006 and 1033) are skipped, because the
//! stream is a rover's.

mod error;
mod received;
mod stream;

pub use error::ReceptionError;
pub use received::{LeftOut, MessageTotal, Received, StreamFormat};
pub use stream::{Needed, Stream};
