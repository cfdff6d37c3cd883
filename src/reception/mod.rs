//! A receiver's stream that comes in pieces: bytes in, epochs and navigation data out.
//!
//! [`Stream`] recognises the format by the first bytes: RINEX observations or CRINEX, or frames of
//! RTCM 3 and UBX, between which anything may stand; any of them may be packed by gzip. Pieces are
//! split anywhere; what is not whole waits.
//! Nothing here reads a clock or stores: who owns a stream stores its pieces and, after a crash,
//! gives [`Stream::restore`] those of [`Stream::needed`]. From these it decodes what follows as it
//! would have. Memory is bounded: one decoder or reader, one frame or the text of one epoch. CRINEX
//! and gzip can be read from their beginning alone, so all of such a stream is needed, and its
//! length is limited.
//!
//! What tells of base stations (RTCM 3 messages 1005, 1006, 1033) is passed over: the stream is a
//! rover's.

mod error;
mod received;
mod stream;

pub use error::ReceptionError;
pub use received::{LeftOut, MessageTotal, Received, StreamFormat};
pub use stream::{Needed, Stream};
