//! A worker: a process beside a service that runs the service's jobs, and does nothing else.
//!
//! It needs a database that several processes write to, and the service's folder of jobs or its
//! bucket. It does not create, fetch, remove or report jobs.

use std::sync::Arc;

use tokio::task::JoinSet;

use crate::aiding::AidingLimits;
use crate::config::JobsConfiguration;
use crate::feeds::Connector;
use crate::gnss::Geoid;
use crate::quotas::Meters;
use crate::session::BatchLane;
use crate::store::Store;

use super::JobError;
use super::files::JobFiles;
use super::queue;
use super::state::{Aiding, Desk};

/// A process that runs jobs of a service.
pub struct Worker {
    desk: Arc<Desk>,
    tasks: JoinSet<()>,
}

impl Worker {
    /// Opens the service's folder, and starts to claim jobs: `limits.running` at the same time.
    ///
    /// # Errors
    /// The folder is not the service's, or the store fails.
    pub async fn start(
        (store, aiding, meters): (Store, AidingLimits, Meters),
        (lane, connector): (BatchLane, Connector),
        limits: JobsConfiguration,
        node: String,
        geoid: Option<Arc<Geoid>>,
    ) -> Result<Self, JobError> {
        let folder = limits.folder.clone().ok_or(JobError::Off)?;
        let id = store.job_folder().await?;
        let files = JobFiles::join(folder, limits.clone(), id.as_deref()).await?;
        let files = Some(Arc::new(files));
        let (stored, running) = ((store, Aiding::Worker(aiding), meters), limits.running);
        let desk = Desk::new(stored, (lane, connector), limits, files, node).with_geoid(geoid);
        let (desk, mut tasks) = (Arc::new(desk), JoinSet::new());
        (0..running).for_each(|_| drop(tasks.spawn(queue::work(desk.clone()))));
        tasks.spawn(queue::count(desk.clone()));
        Ok(Self { desk, tasks })
    }

    /// Waits until a task has ended. A task ends only because of a defect, or if no thread can
    /// start.
    pub async fn broken(&mut self) {
        self.tasks.join_next().await;
    }

    /// Returns the running jobs to the queue, and ends.
    pub async fn stop(mut self) {
        self.desk.stop_all();
        while self.tasks.join_next().await.is_some() {}
    }
}
