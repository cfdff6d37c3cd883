//! Starts the tasks of sessions, and keeps the states of tasks that have ended.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Instant;

use tokio::sync::mpsc;

use crate::aiding::rover_source;
use crate::store::{SessionKey, SessionRow};
use crate::tenant::Tenant;

use super::desk::{Desk, Sessions};
use super::parked::{KeepsParked, ParkedState};
use super::task::{Known, Stages, Task};
use super::tasks::{Handle, Start, Tasks};
use super::{SessionError, SessionId};

impl Sessions {
    /// Starts a session's task. If the limit of tasks is reached, some sessions are parked.
    pub(super) fn start(
        &self,
        id: &SessionId,
        row: SessionRow,
        start: Start,
    ) -> Result<(), SessionError> {
        let mut tasks = self.tasks();
        self.make_room(&mut tasks, start)?;
        let (key, tenant) = (row.key, row.tenant.clone());
        let known = match tasks.parked.take(id, &row) {
            Some(state) => Known::State(Box::new(state)),
            None => Known::Row(Box::new(row)),
        };
        self.begin(&mut tasks, id, (key, tenant), known);
        Ok(())
    }

    /// Starts the task of a session whose parked state is in memory. Returns `false` if the session
    /// has no such state.
    ///
    /// Nothing is read from the store: a change of settings removes the parked state, and nobody
    /// else writes to the database. In a cluster another node may have had the session, so the
    /// answer is then `false`.
    pub(super) fn resume(&self, id: &SessionId) -> Result<bool, SessionError> {
        if self.store().is_of_cluster() {
            return Ok(false);
        }
        let mut tasks = self.tasks();
        if !tasks.parked.has(id, self.tenant()) {
            return Ok(false);
        }
        self.make_room(&mut tasks, Start::Epochs)?;
        let Some(state) = tasks.parked.remove(id) else { return Ok(false) };
        let session = (state.key, state.tenant.clone());
        self.begin(&mut tasks, id, session, Known::State(Box::new(state)));
        Ok(true)
    }

    /// Parks some sessions if the limit of tasks is reached.
    fn make_room(&self, tasks: &mut Tasks, start: Start) -> Result<(), SessionError> {
        if tasks.stops.is_some() {
            return Err(SessionError::Draining);
        }
        let (limit, retry_after) = (self.limits().active_sessions, self.limits().retry_after);
        if limit <= tasks.handles.len() && !tasks.park_some(limit) && start == Start::Epochs {
            return Err(SessionError::TooManyActive { limit, retry_after });
        }
        Ok(())
    }

    fn begin(
        &self,
        tasks: &mut Tasks,
        id: &SessionId,
        (key, tenant): (SessionKey, Tenant),
        known: Known,
    ) {
        let Desk { store, aiding, limits, counters, live, clock, configurations, .. } =
            &**self.desk();
        let (mailbox, inbox) = mpsc::channel(limits.mailbox_epochs);
        let outdated = Arc::new(AtomicBool::new(false));
        let desk: Arc<dyn KeepsParked> = self.desk().clone();
        let task = Task {
            id: id.clone(),
            key,
            tenant: tenant.clone(),
            device: rover_source(&tenant, id.as_str()),
            store: store.clone(),
            aiding: aiding.clone(),
            solvers: self.solvers(),
            configurations: configurations.clone(),
            epochs_per_push: limits.epochs_per_push,
            observations_per_epoch: limits.observations_per_epoch,
            future_s: limits.future_s,
            retention_days: limits.retention_days,
            clock: clock.clone(),
            outdated: outdated.clone(),
            counters: counters.clone(),
            live: live.clone(),
            stages: Stages::default(),
            known: Mutex::new(Some(known)),
            desk: Arc::downgrade(&desk),
        };
        while tasks.running.try_join_next().is_some() {} // Forgets the tasks that have ended.
        tasks.running.spawn(task.run(inbox));
        let last_used = tasks.posted;
        let (waiting, started) = (Arc::default(), Instant::now());
        let handle = Handle { key, tenant, mailbox, waiting, outdated, last_used, started };
        tasks.parking.remove(id);
        tasks.handles.insert(id.clone(), handle);
        counters.in_memory.store(tasks.in_memory(), Ordering::Relaxed);
    }
}

impl KeepsParked for Desk {
    fn stops(&self) -> Option<Instant> {
        self.tasks().stops
    }

    fn keep_parked(
        &self,
        id: &SessionId,
        task: &Arc<AtomicBool>,
        state: Option<ParkedState>,
    ) -> Vec<ParkedState> {
        let mut tasks = self.tasks();
        if tasks.parking.get(id).is_none_or(|parking| !Arc::ptr_eq(parking, task)) {
            return Vec::new();
        }
        tasks.parking.remove(id);
        let Some(state) = state else { return Vec::new() };
        let dropped = tasks.parked.insert(id, state);
        self.counters.in_memory.store(tasks.in_memory(), Ordering::Relaxed);
        dropped
    }
}
