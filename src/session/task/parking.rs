//! Snapshots of a session's state, and how its task ends and begins: parked and restored.
//!
//! A state is stored after so many epochs, or so much computing, that a restart of the service has
//! little to repeat: with many sessions in memory each may repeat less. A session that is parked
//! leaves its encoded state to the desk, which gives it to the next task. If the desk has dropped
//! it, the state is restored from the store.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::{Arc, PoisonError};
use std::time::Duration;

use crate::clock::gps_time;
use crate::session::SessionError;
use crate::session::batch::EpochRules;
use crate::session::parked::ParkedState;
use crate::session::replay::{ActiveConfiguration, Replay, ReplayWith, restored};
use crate::session::solvers::Lane;
use crate::session::state::State;
use crate::store::Batch;

use super::{Active, Task};

/// After a restart, the sessions that were in memory repeat this much computing on each thread.
const RESTART: Duration = Duration::from_secs(10);
/// Bounds of what one session repeats (empirical).
const REPLAY_LEAST: Duration = Duration::from_millis(2);
const REPLAY_MOST: Duration = Duration::from_millis(50);
/// A parked state is stored if at least this part of what may be repeated would be.
const WORTH_STORING: u32 = 4;

impl Task {
    /// A batch of today without changes, which continues the session after number `previous`.
    pub(super) fn batch(&self, previous: Option<u64>) -> Batch {
        Batch { day: Some(self.clock.day()), ..Batch::new(self.key, previous) }
    }

    /// The rules for the next batch.
    pub(super) fn rules(&self, active: &Active) -> EpochRules {
        let keeps_snapshot = self.keeps_snapshot(active);
        EpochRules {
            observations_max: self.observations_per_epoch,
            now: gps_time(self.clock.unix_ms()),
            future_s: self.future_s,
            replay_max: self.replay_max(),
            keeps_snapshot,
            is_new_day: keeps_snapshot && active.kept_day.is_some(),
        }
    }

    /// Whether a snapshot would be the first of its day, and kept for replay.
    pub(super) fn keeps_snapshot(&self, active: &Active) -> bool {
        let days = active.configuration.retention_days.unwrap_or(self.retention_days);
        days != 0 && active.kept_day != Some(self.clock.day())
    }

    /// Notes that a snapshot of today is kept.
    pub(super) fn note_kept(&self, active: &mut Active, is_kept: bool) {
        if is_kept {
            active.kept_day = Some(self.clock.day());
        }
    }

    /// Computing of a session that a restart may repeat. Sessions differ by up to half of it, so
    /// that those which began together are not stored together.
    fn replay_max(&self) -> Duration {
        let sessions = self.counters.in_memory().max(1);
        let threads = self.solvers.threads();
        let share = (RESTART * threads as u32).div_f64(sessions as f64);
        let mut hasher = DefaultHasher::new();
        self.key.hash(&mut hasher);
        let fraction = f64::from(hasher.finish() as u32) / f64::from(u32::MAX);
        share.clamp(REPLAY_LEAST, REPLAY_MOST).mul_f64(0.5 + fraction)
    }

    /// Ends the task: leaves the state to the desk, and stores it if a restart would repeat much.
    pub(super) async fn park(&self, active: Option<Active>) {
        let Some(active) = active else { return };
        let desk = self.desk.upgrade().filter(|desk| !desk.is_draining());
        let is_stored = self.replay_max() < active.committed.unsaved_time * WORTH_STORING;
        if active.unconfirmed.is_some() || (desk.is_none() && !is_stored) {
            return;
        }
        let keeps_snapshot = is_stored && self.keeps_snapshot(&active);
        let Active { committed, configuration, .. } = active;
        let encoding = self.solvers.run(Lane::Restore, {
            let committed = committed.clone();
            move || committed.encoded_content()
        });
        let Ok(Some((seq, content))) = encoding.await else { return };
        let mut parked = ParkedState::new(committed, configuration, (seq, content));
        if is_stored {
            let snapshot = Some(parked.snapshot());
            let batch = Batch { snapshot, keeps_snapshot, ..self.batch(Some(seq)) };
            match self.store.commit(batch).await {
                Ok(()) => parked.note_stored(keeps_snapshot),
                // Nothing is lost, because the epochs are replayed.
                Err(error) => {
                    tracing::warn!(session = %self.id, %error, "a session's state was not stored");
                    return;
                }
            }
        }
        if let Some(desk) = desk {
            desk.keep_parked(&self.id, parked);
        }
    }

    /// Continues with the state that the desk has kept, if there is one.
    pub(super) async fn unpark(&self, active: &mut Option<Active>) {
        let parked = self.parked.lock().unwrap_or_else(PoisonError::into_inner).take();
        let Some(parked) = parked.filter(|_| active.is_none()) else { return };
        let configuration = parked.configuration().clone();
        let decoding = self.solvers.run(Lane::Restore, move || parked.decoded());
        match decoding.await {
            Ok(Ok(state)) => {
                let (committed, raw) = (Arc::new(state), None);
                let (unconfirmed, epoch_time, kept_day) = (None, None, None);
                *active = Some(Active {
                    committed,
                    unconfirmed,
                    configuration,
                    epoch_time,
                    raw,
                    kept_day,
                });
            }
            Ok(Err(error)) => {
                tracing::error!(session = %self.id, %error, "a parked state cannot be read");
            }
            Err(error) => tracing::error!(session = %self.id, %error, "a parked state is lost"),
        }
    }

    /// The state after the last committed epoch, from the store.
    pub(super) async fn restored(
        &self,
        configuration: &ActiveConfiguration,
    ) -> Result<State, SessionError> {
        // Few at a time, so that the first are ready long before the last.
        let _admitted = self.solvers.admitted_restore().await;
        let replay = Replay {
            store: self.store.clone(),
            aiding: self.aiding.clone(),
            solvers: self.solvers.clone(),
            tenant: self.tenant.clone(),
            key: self.key,
            device: self.device.clone(),
            with: ReplayWith::Stored,
            arcs: self.store.arcs(self.key).await?.into(),
            known: Some(Arc::new(configuration.estimation.clone())),
            tolerates_missing: true,
        };
        restored(&replay, &configuration.estimation).await
    }
}
