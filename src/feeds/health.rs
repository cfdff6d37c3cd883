//! How a stream is doing.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crate::aiding::AidingError;
use crate::formats::receiver::Statistics;
use crate::gnss::GpsTime;

use super::ntrip::NtripError;
use super::web::WebError;

/// What a stream is at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FeedState {
    /// It is being asked for.
    Connecting,
    /// It comes.
    Streaming,
    /// It ended or was refused, and is asked for again after a delay.
    Waiting,
}

impl FeedState {
    /// The name as the API writes it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Connecting => "CONNECTING",
            Self::Streaming => "STREAMING",
            Self::Waiting => "WAITING",
        }
    }
}

/// What went wrong last.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FeedProblem {
    /// Stable code, upper snake case.
    pub code: &'static str,
    /// What is wrong.
    pub message: String,
    /// What can be done about it.
    pub remedy: &'static str,
}

impl From<&NtripError> for FeedProblem {
    fn from(error: &NtripError) -> Self {
        Self { code: error.code(), message: error.to_string(), remedy: error.remedy() }
    }
}

impl From<&WebError> for FeedProblem {
    fn from(error: &WebError) -> Self {
        Self { code: error.code(), message: error.to_string(), remedy: error.remedy() }
    }
}

impl From<&AidingError> for FeedProblem {
    fn from(error: &AidingError) -> Self {
        Self { code: error.code(), message: error.to_string(), remedy: error.remedy() }
    }
}

/// How a stream is doing.
#[derive(Clone, Debug, PartialEq)]
pub struct FeedHealth {
    /// What it is at.
    pub state: FeedState,
    /// Since when (ms since 1970-01-01 UTC).
    pub since_unix_ms: i64,
    /// Why it was lost last, even if it has come back.
    pub problem: Option<FeedProblem>,
    /// Why its epochs are not taken.
    pub refusal: Option<FeedProblem>,
    /// When it is asked for again (ms since 1970-01-01 UTC), while it waits.
    pub retry_unix_ms: Option<i64>,
    /// How often it was granted.
    pub connections: u64,
    /// How often it was asked for.
    pub attempts: u64,
    /// Bytes that came.
    pub bytes: u64,
    /// When the last of them came (ms since 1970-01-01 UTC).
    pub heard_unix_ms: Option<i64>,
    /// Epochs that came.
    pub epochs: u64,
    /// Time of the last of them.
    pub last_epoch: Option<GpsTime>,
    /// Ephemerides that came, each issue once.
    pub ephemerides: u64,
    /// What the present connection brought, by type of message, or else the last.
    pub statistics: Statistics,
    /// From where the base is stated to stand to where the stream says (m).
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
            heard_unix_ms: None,
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

/// What an archive is at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SourceState {
    /// Its files are being asked for.
    Fetching,
    /// It gave what it has, and is asked again in a while.
    Current,
    /// It failed, and is asked again after a delay.
    Waiting,
}

impl SourceState {
    /// The name as the API writes it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Fetching => "FETCHING",
            Self::Current => "CURRENT",
            Self::Waiting => "WAITING",
        }
    }
}

/// How an archive is doing.
#[derive(Clone, Debug, PartialEq)]
pub struct ArchiveHealth {
    /// What it is at.
    pub state: SourceState,
    /// Since when (ms since 1970-01-01 UTC).
    pub since_unix_ms: i64,
    /// When it last gave all that it has (ms since 1970-01-01 UTC).
    pub succeeded_unix_ms: Option<i64>,
    /// Why it failed last, until it succeeds.
    pub problem: Option<FeedProblem>,
    /// When it is asked again (ms since 1970-01-01 UTC).
    pub retry_unix_ms: Option<i64>,
    /// Ephemerides that it brought and nobody had before.
    pub ephemerides: u64,
}

/// How an archive is doing that fills a base.
#[derive(Clone, Debug, PartialEq)]
pub struct BaseArchiveHealth {
    /// What it is at: current where nothing is missing that rovers need.
    pub state: SourceState,
    /// Since when (ms since 1970-01-01 UTC).
    pub since_unix_ms: i64,
    /// When it is asked again (ms since 1970-01-01 UTC), while it waits.
    pub retry_unix_ms: Option<i64>,
    /// Why the first file that is missing did not come.
    pub problem: Option<FeedProblem>,
    /// Why epochs that came last are not taken.
    pub refusal: Option<FeedProblem>,
    /// Files that rovers need and that have not come, or still grow.
    pub missing: usize,
    /// How often it was asked.
    pub requests: u64,
    /// Files that came.
    pub files: u64,
    /// Bytes of them, as they came.
    pub bytes: u64,
    /// Epochs of them that the base took and did not hold.
    pub epochs: u64,
    /// Address of the last of them.
    pub last_file: Option<String>,
}

/// The same, as its task writes it.
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
        self.note().clone()
    }

    pub(super) fn enter(&self, state: SourceState, now_unix_ms: i64) {
        let mut health = self.note();
        (health.state, health.since_unix_ms, health.retry_unix_ms) = (state, now_unix_ms, None);
    }

    pub(super) fn succeeded(&self, now_unix_ms: i64) {
        self.enter(SourceState::Current, now_unix_ms);
        let mut health = self.note();
        (health.succeeded_unix_ms, health.problem) = (Some(now_unix_ms), None);
    }

    pub(super) fn failed(&self, problem: FeedProblem, now_unix_ms: i64) {
        self.enter(SourceState::Waiting, now_unix_ms);
        self.note().problem = Some(problem);
    }

    pub(super) fn wait(&self, delay: Duration, now_unix_ms: i64) {
        self.note().retry_unix_ms = Some(now_unix_ms + delay.as_millis() as i64);
    }

    pub(super) fn brought(&self, ephemerides: u64) {
        self.note().ephemerides += ephemerides;
    }

    fn note(&self) -> MutexGuard<'_, ArchiveHealth> {
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
