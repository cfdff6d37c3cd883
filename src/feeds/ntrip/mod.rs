//! NTRIP, the protocol of casters: one request, then a stream of a receiver's bytes.
//!
//! Version 2 is HTTP/1.1, its body chunked or not; version 1 answers `ICY 200 OK`, and its list of
//! mountpoints (the sourcetable) where the one asked for does not exist. A request of version 2 is
//! understood by casters of version 1, so both answers are taken to either request.
//!
//! Nothing is believed of a caster: head, chunk lines and sourcetable are limited, each wait is,
//! and an answer that asks to go elsewhere is refused.
//!
//! Sources: RTCM 10410.0 (NTRIP 1.0) and 10410.1 (NTRIP 2.0), as the protocol is described
//! publicly; RFC 9112, section 7.1 (chunked).

mod chunked;
mod client;
mod error;
mod head;
mod request;
mod sourcetable;

pub use client::{NtripStream, connect, sourcetable};
pub use error::NtripError;
pub use request::{Caster, Credentials, NtripVersion, StreamRequest, position_sentence};
pub use sourcetable::{Mountpoint, Sourcetable};
