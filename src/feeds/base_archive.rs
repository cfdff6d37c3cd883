//! An archive that fills a base: files that are fetched when rovers need them.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::{Semaphore, watch};
use tokio::time::sleep;

use crate::aiding::BaseBroker;
use crate::aiding::bases::{BaseFile, BaseId, HeldEpoch, Reach};
use crate::clock::{gps_time, unix_ms};
use crate::gnss::{Epoch, GpsTime};

use super::archive::{PACKED_LIMIT, unpacked};
use super::health::{BaseArchiveHealth, FeedProblem, SourceState};
use super::stop::stopped;
use super::web::{self, Fetched, Validators, WebError};
use super::{ArchiveTemplate, Backoff, Connector, FeedOptions};

/// A file that came so long after its time has ended grows no more (ms).
const SETTLED_MS: i64 = 3_600_000;
/// Behind a file that fails so often no later one waits, with which it cannot come any more.
const HOLDING_FAILURES: u32 = 4;
/// What rovers need no more is forgotten after so long at the latest.
const LOOKING_AGAIN: Duration = Duration::from_secs(3600);
/// Receivers tag epochs so near to the second that they mean (s).
const TOLERANCE_S: f64 = 0.5;

/// How an archive is doing, as the desk and its task share it.
pub(super) struct Note(Mutex<BaseArchiveHealth>);

impl Note {
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
    /// When it is to be asked for (ms since 1970-01-01 UTC).
    due_unix_ms: i64,
    failing: Backoff,
    known: Validators,
    /// All that can come of it has come.
    is_done: bool,
    problem: Option<FeedProblem>,
    /// How often it failed in a row.
    failures: u32,
}

impl File {
    /// Whether later files wait for it: it is there, but did not come whole.
    fn holds_up(&self) -> bool {
        let is_there = |problem: &FeedProblem| problem.code != "FILE_NOT_FOUND";
        let may_come = self.problem.as_ref().is_some_and(is_there);
        !self.is_done && may_come && self.failures < HOLDING_FAILURES
    }
}

/// Fetches the files of a base.
pub(super) struct BaseArchive {
    pub(super) base: BaseId,
    pub(super) template: ArchiveTemplate,
    pub(super) connector: Connector,
    pub(super) bases: BaseBroker,
    pub(super) options: FeedOptions,
    pub(super) note: Arc<Note>,
    /// Lets few files at a time be unpacked, of however many bases.
    pub(super) reading: Arc<Semaphore>,
    pub(super) stopped: watch::Receiver<bool>,
}

impl BaseArchive {
    /// Runs until it is stopped, between files, or the base is gone.
    pub(super) async fn run(mut self) {
        let mut files: BTreeMap<GpsTime, File> = BTreeMap::new();
        while self.list(&mut files) {
            let now = unix_ms();
            let held_up = files.iter().find(|(_, file)| file.holds_up()).map(|(start, _)| *start);
            let comes = |start: &GpsTime| held_up.is_none_or(|held_up| *start <= held_up);
            let open = files.iter_mut().filter(|(start, file)| !file.is_done && comes(start));
            let next = open.min_by_key(|(start, file)| (file.due_unix_ms.max(now), **start));
            let delay = match next {
                Some((start, file)) if file.due_unix_ms <= now => {
                    self.note.write().enter(SourceState::Fetching, None, now);
                    if self.fetch(*start, file).await.is_none() {
                        return;
                    }
                    self.tell(&files);
                    continue;
                }
                Some((_, file)) => Duration::from_millis((file.due_unix_ms - now) as u64),
                None => LOOKING_AGAIN,
            };
            self.tell(&files);
            tokio::select! {
                () = stopped(&mut self.stopped) => return,
                // Err: the base is gone, which the list tells.
                _ = self.bases.need(&self.base) => {}
                () = sleep(delay.min(LOOKING_AGAIN)) => {}
            }
        }
    }

    /// Lists the files that rovers need; whether there is such a base.
    fn list(&self, files: &mut BTreeMap<GpsTime, File>) -> bool {
        let Ok(needed) = self.bases.needed(&self.base) else { return false };
        let now = gps_time(unix_ms());
        let start = |time: GpsTime| Some(self.template.span(time)?.0);
        let starts: BTreeSet<GpsTime> =
            needed.into_iter().filter(|time| *time <= now).filter_map(start).collect();
        files.retain(|start, _| starts.contains(start));
        for start in starts {
            files.entry(start).or_insert_with(|| File {
                due_unix_ms: 0,
                failing: Backoff::new(self.options.file_delay, self.options.file_ceiling),
                known: Validators::default(),
                is_done: false,
                problem: None,
                failures: 0,
            });
        }
        true
    }

    /// Fetches a file, if something of it can be taken; `None` once it is stopped.
    async fn fetch(&mut self, start: GpsTime, file: &mut File) -> Option<()> {
        let (from, until) = self.template.span(start)?;
        match self.bases.reach(&self.base, from, until) {
            Ok(Reach::Open) => {}
            reach => {
                file.is_done = true;
                if matches!(reach, Ok(Reach::Passed)) {
                    self.note.write().refusal = Some(passed(from));
                }
                return Some(());
            }
        }
        let place = self.template.at(start);
        let fetched = match &place {
            Ok(place) => tokio::select! {
                () = stopped(&mut self.stopped) => return None,
                fetched = web::fetch(&self.connector, place, &file.known, PACKED_LIMIT) => fetched,
            },
            Err(error) => Err(WebError::from(error.clone())),
        };
        self.note.write().requests += 1;
        let place = place.map_or_else(|_| self.template.to_string(), |place| place.to_string());
        let taken = match fetched {
            Ok(Fetched::Unchanged) => Ok(()),
            Ok(Fetched::New { content, validators }) => {
                file.known = validators;
                self.take(&place, content, from, until).await.map_err(|problem| (problem, None))
            }
            Err(error) => Err((FeedProblem::from(&error), error.retry_after())),
        };
        let now = unix_ms();
        match taken {
            Ok(()) => {
                let is_settled = until < gps_time(now - SETTLED_MS);
                let reach = self.bases.reach(&self.base, from, until);
                file.is_done = is_settled || !matches!(reach, Ok(Reach::Open));
                file.due_unix_ms = now + self.options.file_refresh.as_millis() as i64;
                (file.problem, file.failures) = (None, 0);
                file.failing.reset();
            }
            Err((problem, retry_after)) => {
                let FeedProblem { code, message, remedy } = problem;
                if file.problem.as_ref().is_none_or(|before| before.code != code) {
                    tracing::warn!(code, base = %self.base, %place, %message, "no file of a base");
                }
                file.failures += 1;
                // What was wrong with it is looked at again, even if it is the same.
                file.known = Validators::default();
                file.due_unix_ms = now + file.failing.next(retry_after).as_millis() as i64;
                let message = format!("{place}: {message}");
                file.problem = Some(FeedProblem { code, message, remedy });
            }
        }
        Some(())
    }

    /// Gives the base the epochs of a file.
    async fn take(
        &self,
        place: &str,
        content: Vec<u8>,
        from: GpsTime,
        until: GpsTime,
    ) -> Result<(), FeedProblem> {
        // Err: never, for nobody closes it.
        let _turn = self.reading.acquire().await.ok();
        let (bytes, epochs_max) = (content.len(), self.bases.epochs_max());
        let reading = tokio::task::spawn_blocking(move || read(&content, epochs_max));
        let read = reading.await.unwrap_or_else(|panic| Err(panic.to_string()));
        let BaseFile { mut epochs, site, .. } = read.map_err(|message| FeedProblem {
            code: "FILE_UNREADABLE",
            message,
            remedy: "check that the address is of RINEX observation files, plain or gzip",
        })?;
        epochs.retain(|epoch: &Epoch| {
            from - TOLERANCE_S <= epoch.time && epoch.time < until - TOLERANCE_S
        });
        if epochs.is_empty() {
            return Err(FeedProblem {
                code: "FILE_OF_OTHER_TIME",
                message: format!("it has no epoch from {from} until {until}"),
                remedy: "check the placeholders of the address",
            });
        }
        let pushed = self.bases.upload(&self.base, epochs, site.as_ref()).await;
        let outcomes = pushed.map_err(|error| FeedProblem::from(&error))?.outcomes;
        let is_new = |held: &&HeldEpoch| !held.resent;
        let new = outcomes.iter().flatten().filter(is_new).count() as u64;
        let refusal = outcomes.iter().find_map(|outcome| outcome.as_ref().err());
        tracing::info!(base = %self.base, %place, epochs = new, "a file of a base came");
        let mut health = self.note.write();
        health.files += 1;
        health.bytes += bytes as u64;
        health.epochs += new;
        health.last_file = Some(place.to_owned());
        health.refusal = refusal.map(|refusal| FeedProblem {
            code: refusal.code(),
            message: refusal.to_string(),
            remedy: "the other epochs of the file are taken",
        });
        Ok(())
    }

    /// Tells how it is doing, between files.
    fn tell(&self, files: &BTreeMap<GpsTime, File>) {
        let open = || files.values().filter(|file| !file.is_done);
        let retry = open().map(|file| file.due_unix_ms).min();
        let problem = open().find_map(|file| file.problem.clone());
        let state = if problem.is_some() { SourceState::Waiting } else { SourceState::Current };
        let mut health = self.note.write();
        health.enter(state, retry, unix_ms());
        (health.problem, health.missing) = (problem, open().count());
    }
}

fn passed(from: GpsTime) -> FeedProblem {
    FeedProblem {
        code: "BASE_OUT_OF_ORDER",
        message: format!("the file of {from} is not asked for: the base's epochs are later"),
        remedy: "create another base of this archive for older data",
    }
}

fn read(content: &[u8], epochs_max: usize) -> Result<BaseFile, String> {
    BaseFile::read(&unpacked(content)?, epochs_max).map_err(|error| error.to_string())
}
