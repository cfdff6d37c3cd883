//! The desk that fetches aiding data: streams of NTRIP casters, and archives of files.
//!
//! [`Feeds`] keeps one connection per stream, however many bases the stream fills and however many
//! sessions use these bases. It decodes the stream, and pushes its epochs to its bases and its
//! ephemerides to the navigation broker. It also sets the position of bases whose creator gave
//! none. When a stream ends, it is requested again after a delay that doubles; `FeedHealth` reports
//! the state of the stream and the cause of its last failure.
//!
//! Instead of a stream, an archive can fill a base. It has one file per day, hour or quarter of an
//! hour. A file is fetched once for all sessions, when epochs of its time must be positioned.
//! [`NetworkRequest`]s name casters whose sourcetables list further bases: the base nearest to a
//! rover is connected while the rover needs it.
//!
//! Clients choose which casters and archives fill bases. Therefore only hosts that the operator
//! lists are contacted, at addresses that were checked ([`FetchPolicy`]). The sources of
//! ephemerides are named by the operator ([`NavigationSources`]).

mod address;
mod archive;
mod archived;
mod attempts;
mod backoff;
mod base_archive;
mod connection;
mod desk;
mod download;
mod error;
mod head;
mod health;
mod network;
pub mod ntrip;
mod options;
mod post;
mod sources;
mod stop;
mod stream;
mod tenant_feeds;
mod web;

pub use address::FetchPolicy;

pub use crate::tls::Connection;
pub use archive::ArchiveTemplate;
pub use archived::NavigationArchives;
pub(crate) use archived::{ArchivedFile, files as archived_files};
pub(crate) use attempts::Attempts;
pub(crate) use backoff::Backoff;
pub use connection::{Connector, TimeLimits};
pub use desk::Feeds;
pub(crate) use download::download;
pub use error::FetchError;
pub(crate) use health::BaseArchiveHealth;
pub(crate) use health::FeedHealth;
pub use health::FeedProblem;
pub use health::SourceState;
pub use network::{NetworkHealth, NetworkRequest};
pub use options::FeedOptions;
pub(crate) use post::post;
pub use sources::NavigationSources;
pub(crate) use sources::SourceStatus;
pub(crate) use tenant_feeds::TenantFeeds;
#[cfg(feature = "s3")]
pub(crate) use web::exchange;
pub use web::{Fetched, Validators, fetch};
pub use web::{Url, WebError};
