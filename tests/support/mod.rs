//! Shared parts of the tests: data, databases, a service in this process, streams, and waiting.

pub(crate) mod antex;
pub(crate) mod casters;
pub(crate) mod data;
pub(crate) mod database;
pub(crate) mod device;
pub(crate) mod doors;
pub(crate) mod drive;
#[cfg(target_os = "linux")]
pub(crate) mod failing;
pub(crate) mod flow;
pub(crate) mod geoid;
pub(crate) mod jobs;
pub(crate) mod pair;
pub(crate) mod proxy;
pub(crate) mod python;
pub(crate) mod reading;
pub(crate) mod recording;
pub(crate) mod server;
pub(crate) mod sessions;
pub(crate) mod snapshot;
pub(crate) mod streams;
pub(crate) mod tls;
pub(crate) mod wait;
