//! Doors that bring aiding in: streams of NTRIP casters, and archives of ephemerides.
//!
//! [`Feeds`] holds one connection for each stream, however many bases it fills and sessions name
//! these. A stream is decoded as it comes; its epochs become those of its bases, its ephemerides
//! serve every session, and what it tells of its station places the bases that nobody has placed.
//! When it ends it is asked for again, after a delay that doubles; [`FeedHealth`] says what it does
//! and why.
//!
//! A base may be filled from an archive instead, which has a file for each day, hour or quarter of
//! an hour. One is fetched when epochs of its time are to be positioned, once for all sessions that
//! wait for it. The sourcetables of [`NetworkRequest`]s say where further bases stand: the one
//! nearest to a rover is connected while that needs it.
//!
//! What bases are filled from is fetched by a client's wish, so nothing is asked but hosts that the
//! operator lists, at addresses that were checked ([`FetchPolicy`]). What brings ephemerides beside
//! that the operator names himself ([`NavigationSources`]).

mod address;
mod archive;
mod backoff;
mod base_archive;
mod connection;
mod desk;
mod error;
mod head;
mod health;
mod network;
pub mod ntrip;
mod options;
mod sources;
mod stop;
mod stream;
mod web;

pub use address::{FetchPolicy, is_public};
pub use archive::ArchiveTemplate;
pub use backoff::Backoff;
pub use connection::{Connection, Connector, Patience};
pub use desk::Feeds;
pub use error::FetchError;
pub use health::{
    ArchiveHealth, BaseArchiveHealth, FeedHealth, FeedProblem, FeedState, SourceState,
};
pub use network::{NetworkHealth, NetworkRequest};
pub use options::FeedOptions;
pub use sources::{NavigationSources, SourceStatus};
pub use web::{Fetched, Location, Validators, WebError, fetch};
