//! NTRIP, the protocol of casters: one request, then a stream of a receiver's bytes.
//!
//! Version 2 is HTTP/1.1, with a chunked body or not. Version 1 answers `ICY 200 OK`; if it does
//! not have the mountpoint, it answers with the list of its mountpoints, the sourcetable. Casters
//! of version 1 understand requests of version 2, so the client accepts both kinds of answer to
//! either request.
//!
//! The client does not trust the caster: head, chunk lines, sourcetable and each wait have limits,
//! and redirections are refused.
//!
//! Sources: RTCM 10410.0 (NTRIP 1.0) and 10410.1 (NTRIP 2.0), as publicly described; RFC 9112,
//! section 7.1 (chunked).

mod chunked;
mod client;
mod error;
mod head;
#[cfg(test)]
mod mutated;
mod request;
mod sourcetable;

pub use client::{NtripStream, connect, sourcetable};
pub use error::NtripError;
pub use request::Caster;
pub use request::{Credentials, NtripVersion, StreamRequest, position_sentence};
pub use sourcetable::{Mountpoint, Sourcetable};
