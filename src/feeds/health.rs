//! Health of streams and archives, as the API reports it.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crate::aiding::AidingError;
use crate::formats::receiver::Statistics;
use crate::gnss::GpsTime;
use crate::refusal::Code;

use super::ntrip::NtripError;
use super::web::WebError;

/// State of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FeedState {
    /// The stream has been requested from the caster.
    Connecting,
    /// The caster sends the stream.
    Streaming,
    /// The stream ended or was refused. It is requested again after a delay.
    Waiting,
}

impl FeedState {
    /// The name as the API writes it.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Connecting => "CONNECTING",
            Self::Streaming => "STREAMING",
            Self::Waiting => "WAITING",
        }
    }
}

/// The last failure of a stream or archive, or the last refusal of its data.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FeedProblem {
    /// The stable code, which has the remedy.
    pub code: Code,
    /// What is wrong, with the values at fault.
    pub message: String,
}

impl From<&NtripError> for FeedProblem {
    fn from(error: &NtripError) -> Self {
        Self { code: error.code(), message: error.to_string() }
    }
}

impl From<&WebError> for FeedProblem {
    fn from(error: &WebError) -> Self {
        Self { code: error.code(), message: error.to_string() }
    }
}

impl From<&AidingError> for FeedProblem {
    fn from(error: &AidingError) -> Self {
        Self { code: error.code(), message: error.to_string() }
    }
}

/// Health of a stream.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct FeedHealth {
    /// Present state.
    pub state: FeedState,
    /// When this state began (ms since 1970-01-01 UTC).
    pub since_unix_ms: i64,
    /// Why the last connection was lost. It is kept after a reconnection.
    pub problem: Option<FeedProblem>,
    /// Why the last epochs were refused; `None` once epochs are accepted again.
    pub refusal: Option<FeedProblem>,
    /// While waiting: when the stream is requested again (ms since 1970-01-01 UTC).
    pub retry_unix_ms: Option<i64>,
    /// Number of times that the caster granted the stream.
    pub connections: u64,
    /// Number of times that the stream was requested.
    pub attempts: u64,
    /// Number of bytes received.
    pub bytes: u64,
    /// When bytes were last received (ms since 1970-01-01 UTC).
    pub received_unix_ms: Option<i64>,
    /// Number of epochs received.
    pub epochs: u64,
    /// Time of the last epoch.
    pub last_epoch: Option<GpsTime>,
    /// Number of ephemerides received. A repeated issue counts once.
    pub ephemerides: u64,
    /// Messages by type, of the present connection; without a connection, those of the last one.
    pub statistics: Statistics,
    /// Distance from the base's stated position to the position in the stream (m).
    pub station_off_m: Option<f64>,
}

impl FeedHealth {
    pub(super) fn new(now_unix_ms: i64) -> Self {
        Self {
            state: FeedState::Connecting,
            since_unix_ms: now_unix_ms,
            problem: None,
            refusal: None,
            retry_unix_ms: None,
            connections: 0,
            attempts: 0,
            bytes: 0,
            received_unix_ms: None,
            epochs: 0,
            last_epoch: None,
            ephemerides: 0,
            statistics: Statistics::default(),
            station_off_m: None,
        }
    }

    pub(super) fn enter(&mut self, state: FeedState, now_unix_ms: i64) {
        (self.state, self.since_unix_ms, self.retry_unix_ms) = (state, now_unix_ms, None);
        match state {
            FeedState::Connecting => self.attempts += 1,
            FeedState::Streaming => self.connections += 1,
            FeedState::Waiting => {}
        }
    }
}

/// State of an archive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SourceState {
    /// Files are being fetched.
    Fetching,
    /// All available files are fetched. The archive is asked again after its interval.
    Current,
    /// The last request failed. It is repeated after a delay.
    Waiting,
}

impl SourceState {
    /// The name as the API writes it.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Fetching => "FETCHING",
            Self::Current => "CURRENT",
            Self::Waiting => "WAITING",
        }
    }
}

/// Health of an archive of ephemerides.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ArchiveHealth {
    /// Present state.
    pub state: SourceState,
    /// When this state began (ms since 1970-01-01 UTC).
    pub since_unix_ms: i64,
    /// When all available files were last fetched (ms since 1970-01-01 UTC).
    pub succeeded_unix_ms: Option<i64>,
    /// Why the archive last failed; `None` after a success.
    pub problem: Option<FeedProblem>,
    /// When the archive is asked again (ms since 1970-01-01 UTC).
    pub retry_unix_ms: Option<i64>,
    /// Number of ephemerides that were new to the service.
    pub ephemerides: u64,
}

/// Health of an archive that fills a base.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct BaseArchiveHealth {
    /// Present state; `Current` if no file that rovers need is missing.
    pub state: SourceState,
    /// When this state began (ms since 1970-01-01 UTC).
    pub since_unix_ms: i64,
    /// While waiting: when the archive is asked again (ms since 1970-01-01 UTC).
    pub retry_unix_ms: Option<i64>,
    /// Why the first missing file could not be fetched.
    pub problem: Option<FeedProblem>,
    /// Why epochs of the last file were refused.
    pub refusal: Option<FeedProblem>,
    /// Number of files that rovers need and that are missing or still grow.
    pub missing: usize,
    /// Number of requests to the archive.
    pub requests: u64,
    /// Number of files fetched.
    pub files: u64,
    /// Bytes of these files, as received.
    pub bytes: u64,
    /// Number of epochs that were new to the base.
    pub epochs: u64,
    /// URL of the last file.
    pub last_file: Option<String>,
}

/// The health of an archive of ephemerides, shared between its task and the desk.
pub(super) struct SourceHealth(Mutex<ArchiveHealth>);

impl SourceHealth {
    pub(super) const fn new(now_unix_ms: i64) -> Self {
        Self(Mutex::new(ArchiveHealth {
            state: SourceState::Fetching,
            since_unix_ms: now_unix_ms,
            succeeded_unix_ms: None,
            problem: None,
            retry_unix_ms: None,
            ephemerides: 0,
        }))
    }

    pub(super) fn read(&self) -> ArchiveHealth {
        self.lock().clone()
    }

    pub(super) fn enter(&self, state: SourceState, now_unix_ms: i64) {
        let mut health = self.lock();
        (health.state, health.since_unix_ms, health.retry_unix_ms) = (state, now_unix_ms, None);
    }

    pub(super) fn succeeded(&self, now_unix_ms: i64) {
        self.enter(SourceState::Current, now_unix_ms);
        let mut health = self.lock();
        (health.succeeded_unix_ms, health.problem) = (Some(now_unix_ms), None);
    }

    pub(super) fn failed(&self, problem: FeedProblem, now_unix_ms: i64) {
        self.enter(SourceState::Waiting, now_unix_ms);
        self.lock().problem = Some(problem);
    }

    pub(super) fn wait(&self, delay: Duration, now_unix_ms: i64) {
        self.lock().retry_unix_ms = Some(now_unix_ms + delay.as_millis() as i64);
    }

    pub(super) fn add(&self, ephemerides: u64) {
        self.lock().ephemerides += ephemerides;
    }

    fn lock(&self) -> MutexGuard<'_, ArchiveHealth> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl BaseArchiveHealth {
    pub(super) const fn new(now_unix_ms: i64) -> Self {
        Self {
            state: SourceState::Current,
            since_unix_ms: now_unix_ms,
            retry_unix_ms: None,
            problem: None,
            refusal: None,
            missing: 0,
            requests: 0,
            files: 0,
            bytes: 0,
            epochs: 0,
            last_file: None,
        }
    }

    pub(super) fn enter(&mut self, state: SourceState, retry_unix_ms: Option<i64>, now: i64) {
        if self.state != state {
            (self.state, self.since_unix_ms) = (state, now);
        }
        self.retry_unix_ms = retry_unix_ms;
    }
}
