//! What the desk and the tasks of its queue share.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::{Notify, watch};
use tokio::time::sleep;

use crate::aiding::{AidingDesk, AidingError, AidingLimits};
use crate::clock::Clock;
use crate::config::JobsConfiguration;
use crate::feeds::{Connector, NavigationArchives};
use crate::gnss::Geoid;
use crate::quotas::Meters;
use crate::session::BatchLane;
use crate::store::{JobProgress, Store};

use super::files::JobFiles;
use super::request::{JobRequest, Plan};
use super::retries::Retries;
use super::{JobError, JobId};

/// Interval at which a run that waits for a turn checks whether it is stopped.
pub(super) const LOOK: Duration = Duration::from_secs(1);

/// Interval at which other work checks whether it is stopped.
const STOP_LOOK: Duration = Duration::from_millis(200);

/// The desk.
pub(super) struct Desk {
    pub(super) store: Store,
    aiding: Aiding,
    /// The quotas of tenants.
    pub(super) meters: Meters,
    pub(super) files: Option<Arc<JobFiles>>,
    pub(super) limits: JobsConfiguration,
    pub(super) lane: BatchLane,
    /// Contacts the hosts that clients name.
    pub(super) connector: Connector,
    /// The operator's archives of ephemerides; `None` in a worker.
    pub(super) archives: Option<NavigationArchives>,
    /// The operator's table of the geoid.
    pub(super) geoid: Option<Arc<Geoid>>,
    pub(super) clock: Clock,
    /// Name of the node, for claims.
    pub(super) node: String,
    /// Wakes a task of the queue.
    pub(super) queued: Notify,
    /// Wakes the task that fetches inputs.
    pub(super) unfetched: Notify,
    /// Number of changes of jobs, for the watches of jobs.
    pub(super) changes: watch::Sender<u64>,
    /// Whether the service is stopping.
    pub(super) stopping: watch::Sender<bool>,
    runs: Mutex<HashMap<String, Arc<Running>>>,
    /// Attempts at jobs that the database has ended.
    pub(super) retries: Retries,
}

/// The source of stored bases and ephemerides for a run.
pub(super) enum Aiding {
    /// The service's desk, which has them in memory.
    Service(Box<AidingDesk>),
    /// The store. It is read for each run, because other processes change it.
    Worker(AidingLimits),
}

/// A run as other tasks see it.
#[derive(Default)]
pub(super) struct Running {
    stop: AtomicBool,
    cpu_us: AtomicU64,
    epochs: AtomicU64,
    answered: AtomicU64,
    read_bytes: AtomicU64,
    resumed_epochs: AtomicU64,
    resumed_bytes: AtomicU64,
}

impl Desk {
    pub(super) fn new(
        (store, aiding, meters): (Store, Aiding, Meters),
        (lane, connector): (BatchLane, Connector),
        limits: JobsConfiguration,
        files: Option<Arc<JobFiles>>,
        node: String,
    ) -> Self {
        Self {
            store,
            aiding,
            meters,
            files,
            limits,
            lane,
            connector,
            archives: None,
            geoid: None,
            clock: Clock::system(),
            node,
            queued: Notify::new(),
            unfetched: Notify::new(),
            changes: watch::Sender::new(0),
            stopping: watch::Sender::new(false),
            runs: Mutex::default(),
            retries: Retries::default(),
        }
    }

    /// The desk with a table of the geoid.
    pub(super) fn with_geoid(self, geoid: Option<Arc<Geoid>>) -> Self {
        Self { geoid, ..self }
    }

    /// The desk with archives of ephemerides.
    pub(super) fn with_archives(self, archives: NavigationArchives) -> Self {
        Self { archives: Some(archives), ..self }
    }

    /// The desk with the stored bases and ephemerides.
    ///
    /// # Errors
    /// The store fails, or a row is corrupt.
    pub(super) async fn aiding(&self) -> Result<AidingDesk, AidingError> {
        match &self.aiding {
            Aiding::Service(desk) => {
                if self.store.fence().is_some() {
                    // Another node may have created the job, with data that this node does not know
                    // yet.
                    desk.follow().await?;
                }
                Ok(AidingDesk::clone(desk))
            }
            Aiding::Worker(limits) => AidingDesk::open(self.store.clone(), limits.clone()).await,
        }
    }

    /// The time to store for what happens now (ms since 1970-01-01 UTC).
    pub(super) fn arrival_time(&self) -> i64 {
        self.store.arrival_time(self.clock.unix_ms())
    }

    /// The files of jobs.
    ///
    /// # Errors
    /// The service has none.
    pub(super) fn files(&self) -> Result<&Arc<JobFiles>, JobError> {
        self.files.as_ref().ok_or(JobError::Off)
    }

    /// The plan that results from a request, after a check of its files and options.
    ///
    /// # Errors
    /// A part is missing or given twice, or an option does not exist, does not fit the others, or
    /// asks for what the service does not have.
    pub(super) fn plan(&self, request: &JobRequest) -> Result<Plan, JobError> {
        let plan = request.plan()?;
        match plan.options.output.geoid && self.geoid.is_none() {
            true => Err(JobError::GeoidMissing),
            false => Ok(plan),
        }
    }

    pub(super) fn is_stopping(&self) -> bool {
        *self.stopping.borrow()
    }

    /// Waits until the service stops.
    pub(super) async fn stopped(&self) {
        let mut stopping = self.stopping.subscribe();
        // Err: the desk no longer exists.
        stopping.wait_for(|stopping| *stopping).await.ok();
    }

    /// Wakes the watches of jobs.
    pub(super) fn changed(&self) {
        self.changes.send_modify(|changes| *changes += 1);
    }

    /// Registers a run.
    pub(super) fn begin(&self, id: &str) -> Arc<Running> {
        let running = Arc::<Running>::default();
        self.runs().insert(id.to_owned(), running.clone());
        if self.is_stopping() {
            running.stop();
        }
        running
    }

    /// Removes a run that has ended.
    pub(super) fn end(&self, id: &str) {
        self.runs().remove(id);
    }

    /// Stops the run of a job, if this service runs it.
    pub(super) fn stop(&self, id: &JobId) {
        if let Some(running) = self.runs().get(id.as_str()) {
            running.stop();
        }
    }

    /// Stops all runs.
    pub(super) fn stop_all(&self) {
        self.stopping.send_replace(true);
        self.runs().values().for_each(|running| running.stop());
    }

    fn runs(&self) -> MutexGuard<'_, HashMap<String, Arc<Running>>> {
        self.runs.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Running {
    pub(super) fn stop(&self) {
        self.stop.store(true, Ordering::Release);
    }

    pub(super) fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Acquire)
    }

    pub(super) fn set_progress(&self, progress: JobProgress) {
        self.epochs.store(progress.epochs, Ordering::Release);
        self.answered.store(progress.answered, Ordering::Release);
        self.read_bytes.store(progress.read_bytes, Ordering::Release);
        self.resumed_epochs.store(progress.resumed_epochs, Ordering::Release);
        self.resumed_bytes.store(progress.resumed_bytes, Ordering::Release);
    }

    /// Sets the processor time that the run has used.
    pub(super) fn set_cpu(&self, cpu: Duration) {
        self.cpu_us.store(cpu.as_micros() as u64, Ordering::Release);
    }

    /// The processor time that the run has used.
    pub(super) fn cpu(&self) -> Duration {
        Duration::from_micros(self.cpu_us.load(Ordering::Acquire))
    }

    pub(super) fn progress(&self) -> JobProgress {
        JobProgress {
            epochs: self.epochs.load(Ordering::Acquire),
            answered: self.answered.load(Ordering::Acquire),
            read_bytes: self.read_bytes.load(Ordering::Acquire),
            resumed_epochs: self.resumed_epochs.load(Ordering::Acquire),
            resumed_bytes: self.resumed_bytes.load(Ordering::Acquire),
        }
    }
}

/// The folder beside a SQLite database.
pub(super) fn folder(limits: &JobsConfiguration, store: &Store) -> Option<PathBuf> {
    limits.folder.clone().or_else(|| {
        let mut name = store.file()?.into_os_string();
        name.push(".jobs");
        Some(name.into())
    })
}

/// The result of `work`; `None` if the job is stopped before.
pub(super) async fn unless_stopped<T>(
    running: &Running,
    work: impl Future<Output = T>,
) -> Option<T> {
    let stopped = async {
        while !running.is_stopped() {
            sleep(STOP_LOOK).await;
        }
    };
    tokio::select! {
        done = work => Some(done),
        () = stopped => None,
    }
}
