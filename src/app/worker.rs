//! The desks of a worker, which runs jobs beside a service.

use crate::config::ServiceConfiguration;
use crate::feeds::TimeLimits;
use crate::jobs::{JobError, Worker};
use crate::quotas::{Meters, TenantQuotas};
use crate::session::BatchLane;
use crate::store::Store;

use super::{AppError, aiding_limits, connector, geoid_table, node_name};

/// A worker that runs jobs.
pub struct WorkerApp {
    store: Store,
    quotas: TenantQuotas,
    worker: Worker,
}

/// Opens the database of a service, and starts to run its jobs. Needs the service's configuration.
///
/// # Errors
/// The database cannot be opened or is SQLite, the folder of jobs is not the service's, or the
/// table of the geoid cannot be read.
pub async fn open_worker(
    configuration: &ServiceConfiguration,
    time_limits: TimeLimits,
) -> Result<WorkerApp, AppError> {
    let ServiceConfiguration { database, fetch, jobs, limits, .. } = configuration;
    let geoid = configuration.geoid_file.as_deref().map(geoid_table).transpose()?;
    let connector = connector(fetch, time_limits)?;
    let node = node_name(configuration);
    if database.starts_with("sqlite:") {
        return Err(JobError::WorkerOnSqlite.into());
    }
    let store = Store::open_existing(database).await?;
    let meters = Meters::default();
    let quotas = TenantQuotas::open(store.clone(), meters.clone()).await?;
    let lane = BatchLane::alone(jobs.running, meters.clone());
    let stored = (store.clone(), aiding_limits(limits), meters);
    let worker = Worker::start(stored, (lane, connector), jobs.clone(), node, geoid).await?;
    Ok(WorkerApp { store, quotas, worker })
}

impl WorkerApp {
    /// Runs jobs until `stop` is ready, then returns the running jobs to the queue. Returns false
    /// if a task ended before that.
    pub async fn work(mut self, stop: impl Future<Output = ()>) -> bool {
        let is_asked = tokio::select! {
            () = stop => true,
            () = self.worker.broken() => false,
        };
        self.worker.stop().await;
        self.quotas.close().await;
        self.store.close().await;
        is_asked
    }
}
