//! An archive that fills a base: its files are fetched when rovers need them.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::{Semaphore, watch};
use tokio::time::{Instant, sleep};

use crate::aiding::BaseBroker;
use crate::aiding::bases::{BaseFile, BaseFileLimits, BaseId, CommittedEpoch, Coverage};
use crate::clock::{gps_time, unix_ms};
use crate::formats::unpack_within;
use crate::gnss::GpsTime;
use crate::refusal::Code;

use super::archive::{PACKED_LIMIT, UNPACKED_LIMIT};
use super::health::{BaseArchiveHealth, FeedProblem, SourceState};
use super::stop::stopped;
use super::web::{self, Fetched, Validators, WebError, without_query};
use super::{ArchiveTemplate, Backoff, Connector, FeedOptions};

/// A file is complete if it is fetched this long after the end of its time (ms), by the service's
/// clock and by the host's. Otherwise a clock that is ahead would take a growing file as complete.
const COMPLETE_AFTER_MS: i64 = 3_600_000;
/// After this many failures in a row a file no longer delays newer files. The base takes epochs in
/// order of time, so the file cannot be added any more once a newer one is.
const BLOCKING_FAILURES: u32 = 4;
/// Longest interval at which the requested times are read.
const LOOK_INTERVAL: Duration = Duration::from_secs(3600);
/// Tolerance of epoch tags to the nominal second (s).
const TAG_TOLERANCE_S: f64 = 0.5;

/// The archive's health, shared between its task and the desk.
pub(super) struct ArchiveStatus(Mutex<BaseArchiveHealth>);

impl ArchiveStatus {
    pub(super) fn new() -> Self {
        Self(Mutex::new(BaseArchiveHealth::new(unix_ms())))
    }

    pub(super) fn read(&self) -> BaseArchiveHealth {
        self.write().clone()
    }

    fn write(&self) -> MutexGuard<'_, BaseArchiveHealth> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A file that rovers need.
struct File {
    /// When to fetch it next. A step of the clock does not change this.
    due: Instant,
    failing: Backoff,
    known: Validators,
    /// No more epochs can come from it.
    is_done: bool,
    problem: Option<FeedProblem>,
    /// Failures in a row.
    failures: u32,
}

impl File {
    /// A file that is due now.
    fn new(options: &FeedOptions, now: Instant) -> Self {
        Self {
            due: now,
            failing: Backoff::new(options.file_delay, options.file_ceiling),
            known: Validators::default(),
            is_done: false,
            problem: None,
            failures: 0,
        }
    }

    /// Notes that it was fetched at `now`. It is due again after `refresh`, unless it is done.
    fn succeeded(&mut self, now: Instant, refresh: Duration) {
        self.due = now + refresh;
        (self.problem, self.failures) = (None, 0);
        self.failing.reset();
    }

    /// Notes that it could not be fetched at `now`. It is due after a delay that grows with each
    /// failure, or after the one that the host asks for.
    fn failed(&mut self, problem: FeedProblem, now: Instant, retry_after: Option<Duration>) {
        self.failures += 1;
        // Fetched again even if unchanged, because the failure may have been on this side.
        self.known = Validators::default();
        self.due = now + self.failing.next(retry_after);
        self.problem = Some(problem);
    }

    /// Whether newer files wait for this one: the archive has the file, but it could not be fetched
    /// completely.
    fn blocks_newer(&self) -> bool {
        let exists = |problem: &FeedProblem| problem.code != Code::FileNotFound;
        let may_come = self.problem.as_ref().is_some_and(exists);
        !self.is_done && may_come && self.failures < BLOCKING_FAILURES
    }
}

/// The task that fetches a base's files.
pub(super) struct BaseArchive {
    pub(super) base: BaseId,
    pub(super) template: ArchiveTemplate,
    pub(super) connector: Connector,
    pub(super) bases: BaseBroker,
    pub(super) options: FeedOptions,
    pub(super) status: Arc<ArchiveStatus>,
    /// Limits how many files are unpacked at the same time, for all bases together.
    pub(super) reading: Arc<Semaphore>,
    pub(super) stopped: watch::Receiver<bool>,
}

impl BaseArchive {
    /// Runs until stopped or until the base is deleted. A file being read is finished first.
    pub(super) async fn run(mut self) {
        let mut files: BTreeMap<GpsTime, File> = BTreeMap::new();
        while self.list(&mut files) {
            let now = Instant::now();
            let delay = match next(&mut files, now) {
                Some((start, file)) if file.due <= now => {
                    self.status.write().enter(SourceState::Fetching, None, unix_ms());
                    if self.fetch(start, file).await.is_none() {
                        return;
                    }
                    self.report(&files);
                    continue;
                }
                Some((_, file)) => file.due - now,
                None => LOOK_INTERVAL,
            };
            self.report(&files);
            tokio::select! {
                () = stopped(&mut self.stopped) => return,
                // Err: the base is deleted; `list` returns false then.
                _ = self.bases.wait_for_request(&self.base) => {}
                () = sleep(delay.min(LOOK_INTERVAL)) => {}
            }
        }
    }

    /// Updates the list of files that rovers need. Returns false if the base no longer exists.
    fn list(&self, files: &mut BTreeMap<GpsTime, File>) -> bool {
        let Ok(needed) = self.bases.requested_times(&self.base) else { return false };
        let now = gps_time(unix_ms());
        let start = |time: GpsTime| Some(self.template.span(time)?.0);
        let starts: BTreeSet<GpsTime> =
            needed.into_iter().filter(|time| *time <= now).filter_map(start).collect();
        files.retain(|start, _| starts.contains(start));
        for start in starts {
            files.entry(start).or_insert_with(|| File::new(&self.options, Instant::now()));
        }
        true
    }

    /// Fetches a file if the base can still take epochs of its time. `None` once stopped.
    async fn fetch(&mut self, start: GpsTime, file: &mut File) -> Option<()> {
        let (from, until) = self.template.span(start)?;
        match self.bases.coverage(&self.base, from, until) {
            Ok(Coverage::Incomplete) => {}
            coverage => {
                file.is_done = true;
                if matches!(coverage, Ok(Coverage::Missed)) {
                    self.status.write().refusal = Some(too_old(from));
                }
                return Some(());
            }
        }
        let url = self.template.at(start);
        let fetched = match &url {
            Ok(url) => tokio::select! {
                () = stopped(&mut self.stopped) => return None,
                fetched = web::fetch(&self.connector, url, &file.known, PACKED_LIMIT) => fetched,
            },
            Err(error) => Err(WebError::from(error.clone())),
        };
        self.status.write().requests += 1;
        let url = url.map_or_else(|_| self.template.to_string(), |url| url.to_string());
        let taken = match fetched {
            Ok(Fetched::Unchanged { host_unix_ms }) => Ok(host_unix_ms),
            Ok(Fetched::New { content, validators, host_unix_ms }) => {
                file.known = validators;
                let taken = self.take(&url, content, from, until).await;
                taken.map(|()| host_unix_ms).map_err(|problem| (problem, None))
            }
            Err(error) => Err((FeedProblem::from(&error), error.retry_after())),
        };
        let now = Instant::now();
        match taken {
            Ok(host_unix_ms) => {
                let unix_ms = host_unix_ms.map_or(unix_ms(), |of_host| of_host.min(unix_ms()));
                let is_complete = until < gps_time(unix_ms - COMPLETE_AFTER_MS);
                let coverage = self.bases.coverage(&self.base, from, until);
                file.is_done = is_complete || !matches!(coverage, Ok(Coverage::Incomplete));
                file.succeeded(now, self.options.file_refresh);
            }
            Err((problem, retry_after)) => {
                let FeedProblem { code, message } = problem;
                if file.problem.as_ref().is_none_or(|before| before.code != code) {
                    let url = without_query(&url);
                    tracing::warn!(%code, base = %self.base, url, %message, "no file of a base");
                }
                let message = format!("{url}: {message}");
                file.failed(FeedProblem { code, message }, now, retry_after);
            }
        }
        Some(())
    }

    /// Uploads the epochs of a file to the base.
    async fn take(
        &self,
        url: &str,
        content: Vec<u8>,
        from: GpsTime,
        until: GpsTime,
    ) -> Result<(), FeedProblem> {
        // Err: never, because the semaphore is never closed.
        let _turn = self.reading.acquire().await.ok();
        let (bytes, limits) = (content.len(), self.bases.file_limits());
        let reading = tokio::task::spawn_blocking(move || read(&content, &limits));
        let read = reading.await.unwrap_or_else(|panic| Err(panic.to_string()));
        let BaseFile { mut epochs, site, .. } =
            read.map_err(|message| FeedProblem { code: Code::FileUnreadable, message })?;
        epochs.retain(|epoch| {
            from - TAG_TOLERANCE_S <= epoch.time && epoch.time < until - TAG_TOLERANCE_S
        });
        if epochs.is_empty() {
            return Err(FeedProblem {
                code: Code::FileOfOtherTime,
                message: format!("the file has no epoch from {from} until {until}"),
            });
        }
        let pushed = self.bases.upload(&self.base, epochs, site.as_ref()).await;
        let outcomes = pushed.map_err(|error| FeedProblem::from(&error))?.outcomes;
        let is_new = |epoch: &&CommittedEpoch| !epoch.resent;
        let new = outcomes.iter().flatten().filter(is_new).count() as u64;
        let refusal = outcomes.iter().find_map(|outcome| outcome.as_ref().err());
        let (base, shown) = (&self.base, without_query(url));
        tracing::info!(%base, url = shown, epochs = new, "a file of a base was fetched");
        let mut health = self.status.write();
        health.files += 1;
        health.bytes += bytes as u64;
        health.epochs += new;
        health.last_file = Some(url.to_owned());
        health.refusal = refusal
            .map(|refusal| FeedProblem { code: refusal.code(), message: refusal.to_string() });
        Ok(())
    }

    /// Updates the health between two files.
    fn report(&self, files: &BTreeMap<GpsTime, File>) {
        let open = || files.values().filter(|file| !file.is_done);
        let (now, unix_ms) = (Instant::now(), unix_ms());
        let unix_ms_of = |due: Instant| unix_ms + (due - now).as_millis() as i64;
        let retry = open().map(|file| unix_ms_of(file.due)).min();
        let problem = open().find_map(|file| file.problem.clone());
        let state = if problem.is_some() { SourceState::Waiting } else { SourceState::Current };
        let mut health = self.status.write();
        health.enter(state, retry, unix_ms);
        (health.problem, health.missing) = (problem, open().count());
    }
}

/// The file to fetch next: of those that are due the earliest in time, otherwise the one that is
/// due first. Files that are newer than one that blocks them wait.
fn next(files: &mut BTreeMap<GpsTime, File>, now: Instant) -> Option<(GpsTime, &mut File)> {
    let blocking = files.iter().find(|(_, file)| file.blocks_newer()).map(|(start, _)| *start);
    let is_allowed = |start: &GpsTime| blocking.is_none_or(|blocking| *start <= blocking);
    let open = files.iter_mut().filter(|(start, file)| !file.is_done && is_allowed(start));
    let next = open.min_by_key(|(start, file)| (file.due.max(now), **start));
    next.map(|(start, file)| (*start, file))
}

fn too_old(from: GpsTime) -> FeedProblem {
    FeedProblem {
        code: Code::BaseOutOfOrder,
        message: format!("the file of {from} is not fetched: the base already has newer epochs"),
    }
}

fn read(content: &[u8], limits: &BaseFileLimits) -> Result<BaseFile, String> {
    let text = unpack_within(content, UNPACKED_LIMIT);
    BaseFile::read(text, limits).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    const OPTIONS: FeedOptions = FeedOptions::standard();

    fn start(hour: u32) -> GpsTime {
        GpsTime::from_week_seconds(2300, 3600.0 * f64::from(hour))
    }

    /// Files of three hours that are due at `now`.
    fn files(now: Instant) -> BTreeMap<GpsTime, File> {
        (0..3).map(|hour| (start(hour), File::new(&OPTIONS, now))).collect()
    }

    fn fails(file: &mut File, code: Code, now: Instant, retry_after: Option<Duration>) -> Duration {
        file.failed(FeedProblem { code, message: String::new() }, now, retry_after);
        file.due - now
    }

    #[test]
    fn files_that_are_due_are_fetched_in_order_of_time() {
        let now = Instant::now();
        let (mut files, later) = (files(now), now + OPTIONS.file_refresh);
        for hour in 0..3 {
            let (next, file) = next(&mut files, now).unwrap();
            assert_eq!((next, file.due), (start(hour), now));
            file.succeeded(now, OPTIONS.file_refresh + Duration::from_secs(hour.into()));
        }
        assert_eq!(next(&mut files, now).unwrap().0, start(0), "it is due first");
        files.get_mut(&start(0)).unwrap().is_done = true;
        let (next_start, file) = next(&mut files, now).unwrap();
        assert_eq!((next_start, file.due), (start(1), later + Duration::from_secs(1)));
        // Both are due, so the earlier one is next although the other has been due for longer.
        files.get_mut(&start(2)).unwrap().due = now;
        assert_eq!(next(&mut files, now).unwrap().0, start(2));
        assert_eq!(next(&mut files, later + Duration::from_secs(9)).unwrap().0, start(1));
        files.values_mut().for_each(|file| file.is_done = true);
        assert!(next(&mut files, later).is_none());
    }

    #[test]
    fn a_file_that_fails_is_due_after_growing_delays_and_blocks_newer_ones_for_some() {
        let now = Instant::now();
        let mut files = files(now);
        let mut longest = OPTIONS.file_delay;
        for failures in 1..=10 {
            let file = files.get_mut(&start(1)).unwrap();
            let delay = fails(file, Code::HostSlow, now, None);
            assert!(longest / 2 <= delay && delay <= longest, "{delay:?} of {longest:?}");
            longest = (2 * longest).min(OPTIONS.file_ceiling);
            files.get_mut(&start(0)).unwrap().is_done = true;
            let is_blocked = next(&mut files, now).unwrap().0 == start(1);
            assert_eq!(is_blocked, failures < BLOCKING_FAILURES, "{failures} failures");
        }
        let file = files.get_mut(&start(1)).unwrap();
        let asked = Duration::from_secs(7200);
        assert!(asked <= fails(file, Code::HostRefuses, now, Some(asked)));
        file.succeeded(now, OPTIONS.file_refresh);
        assert_eq!((file.due - now, file.problem.is_none()), (OPTIONS.file_refresh, true));
        assert!(fails(file, Code::FileNotFound, now, None) <= OPTIONS.file_delay, "it began again");
        assert_eq!(next(&mut files, now).unwrap().0, start(2), "a missing file blocks nothing");
    }
}
