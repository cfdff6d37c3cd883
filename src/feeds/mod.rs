//! Doors that bring aiding in: streams of NTRIP casters.
//!
//! [`Feeds`] holds one connection for each stream, however many bases it fills and sessions name
//! these. A stream is decoded as it comes; its epochs become those of its bases, its ephemerides
//! serve every session, and what it tells of its station places the bases that nobody has placed.
//! When it ends it is asked for again, after a delay that doubles; [`FeedHealth`] says what it does
//! and why.
//!
//! What is fetched here is fetched by a client's wish, so nothing is asked but hosts that the
//! operator lists, at addresses that were checked ([`FetchPolicy`]).

mod address;
mod backoff;
mod connection;
mod desk;
mod error;
mod health;
pub mod ntrip;
mod options;
mod stream;

pub use address::{FetchPolicy, is_public};
pub use backoff::Backoff;
pub use connection::{Connection, Connector, Patience};
pub use desk::Feeds;
pub use error::FetchError;
pub use health::{FeedHealth, FeedProblem, FeedState};
pub use options::FeedOptions;
