//! Snapshots of a session's state, and the end and beginning of its task: parking and restoring.
//!
//! A state is stored after a number of epochs or an amount of computing. So a restart of the
//! service has little to repeat; the more sessions are in memory, the less each may repeat. A
//! session that is parked leaves its encoded state to the desk, which gives it to the next task. If
//! the desk has dropped it, the state is restored from the store.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::{Arc, PoisonError};
use std::time::Duration;

use tokio::time::timeout_at;

use crate::clock::{MS_PER_DAY, day_of, gps_time};
use crate::session::SessionError;
use crate::session::batch::EpochRules;
use crate::session::configurations::ActiveConfiguration;
use crate::session::panics::caught;
use crate::session::parked::{ParkedState, stores_until};
use crate::session::replay::{Replay, ReplayWith, restored};
use crate::session::solvers::Lane;
use crate::session::state::State;
use crate::store::{Arrival, Batch, SessionRow, StoreError};

use super::{Active, Known, Task};

/// After a restart, the sessions that were in memory repeat this much computing, on each thread.
const RESTART: Duration = Duration::from_secs(6);
/// Bounds of the computing that one session repeats. Less is not worth storing a state for; more
/// would be a noticeable delay.
const REPLAY_LEAST: Duration = WORTH_STORING;
const REPLAY_MOST: Duration = Duration::from_millis(50);
/// A state that leaves the memory is stored if repeating its epochs takes longer than this. It is
/// about the cost of storing and reading the state (benches/recovery).
const WORTH_STORING: Duration = Duration::from_millis(1);
/// The session's task itself decodes parked states up to this length (bytes), and encodes those of
/// windows up to `ENCODED_HERE` epochs. This takes some 0.1 ms, and for most of them a change of
/// threads would cost more.
const DECODED_HERE: usize = 256 << 10;
const ENCODED_HERE: usize = 64;

impl Task {
    /// A batch of today without changes, which continues the session after number `previous`.
    pub(super) fn batch(&self, previous: Option<u64>) -> Batch {
        Batch { arrival: Some(self.arrival()), ..Batch::new(self.key, previous) }
    }

    /// The present day. The service's own retention divides the log, not that of a session.
    fn arrival(&self) -> Arrival {
        Arrival::on(day_of(self.arrival_ms()), self.retention_days)
    }

    /// The time at which what is stored now arrives (ms since 1970-01-01 UTC).
    pub(super) fn arrival_ms(&self) -> i64 {
        self.store.arrival_time(self.clock.unix_ms())
    }

    /// The rules for the next batch.
    pub(super) fn rules(&self, active: &Active) -> EpochRules {
        let keeps_snapshot = self.keeps_snapshot(active);
        EpochRules {
            observations_max: self.observations_per_epoch,
            now: gps_time(self.arrival_ms()),
            arrival: self.arrival(),
            future_s: self.future_s,
            replay_max: self.replay_max(),
            keeps_snapshot,
            is_new_day: keeps_snapshot && active.kept_day.is_some(),
        }
    }

    /// The day for which a snapshot is kept, since 1970-01-01. It begins at a time of day of the
    /// session's own, so that not all sessions store their states after midnight.
    pub(super) fn kept_day(&self) -> i64 {
        let begin_ms = (self.fraction() * MS_PER_DAY as f64) as i64;
        day_of(self.arrival_ms() - begin_ms)
    }

    /// Whether a snapshot would be the first of its day, and kept for replay.
    pub(super) fn keeps_snapshot(&self, active: &Active) -> bool {
        let days = active.configuration.retention_days.unwrap_or(self.retention_days);
        days != 0 && active.kept_day != Some(self.kept_day())
    }

    /// Notes that a snapshot of the session's day is kept.
    pub(super) fn note_kept(&self, active: &mut Active, is_kept: bool) {
        if is_kept {
            active.kept_day = Some(self.kept_day());
        }
    }

    /// Computing of this session that a restart may repeat. The limits of sessions differ by up to
    /// half, so that sessions which began together do not store their states together.
    fn replay_max(&self) -> Duration {
        let sessions = self.counters.in_memory().max(1);
        let threads = self.solvers.threads();
        let share = (RESTART * threads as u32).div_f64(sessions as f64);
        share.clamp(REPLAY_LEAST, REPLAY_MOST).mul_f64(0.5 + self.fraction())
    }

    /// A number from 0 to 1 that differs from session to session.
    fn fraction(&self) -> f64 {
        let mut hasher = DefaultHasher::new();
        self.key.hash(&mut hasher);
        f64::from(hasher.finish() as u32) / f64::from(u32::MAX)
    }

    /// Ends the task. It leaves the state to the desk, and stores the states that the desk drops to
    /// make room. If the desk is stopping, it stores its own state instead.
    pub(super) async fn park(&self, active: Option<Active>) {
        let active = active.filter(|active| active.unconfirmed.is_none());
        let desk = self.desk.upgrade();
        let stops = desk.as_ref().map_or_else(|| Some(stores_until()), |desk| desk.stops());
        let Some(desk) = desk.filter(|_| stops.is_none()) else {
            if let (Some(active), Some(until)) = (active, stops) {
                // Err: nothing is lost, because the epochs are replayed.
                timeout_at(until.into(), self.store_at_stop(active)).await.ok();
            }
            return;
        };
        let parked = match active {
            Some(active) => self.encoded(active).await,
            None => None,
        };
        for dropped in desk.keep_parked(&self.id, &self.outdated, parked) {
            self.store_dropped(dropped).await;
        }
    }

    /// The encoded state of a session that is parked. A short window is encoded on this thread.
    async fn encoded(&self, active: Active) -> Option<ParkedState> {
        let Active { committed, configuration, epoch_time, kept_day, .. } = active;
        let (key, tenant) = (self.key, self.tenant.clone());
        let is_short = committed.window_epochs() <= ENCODED_HERE;
        let buffer = self.solvers.memory().buffer();
        let known = (epoch_time, kept_day);
        let encode =
            move || ParkedState::of((key, &tenant), &committed, configuration, known, buffer);
        match is_short {
            true => encode(),
            false => self.solvers.run(Lane::Restore, encode).await.ok().flatten(),
        }
    }

    /// Stores the state before the service stops, if storing it is quicker than repeating the
    /// epochs.
    async fn store_at_stop(&self, active: Active) {
        if active.committed.unsaved_time < WORTH_STORING {
            return;
        }
        let _admitted = self.solvers.admitted_storing().await;
        let keeps_snapshot = self.keeps_snapshot(&active);
        let previous = active.last_seq();
        let encoding = self.solvers.run(Lane::Restore, move || active.committed.encoded());
        let Ok(snapshot) = encoding.await else { return };
        let batch = Batch { snapshot, keeps_snapshot, ..self.batch(previous) };
        self.store_state(batch).await;
    }

    /// Stores a parked state that leaves the memory, if storing is quicker than repeating the
    /// epochs.
    async fn store_dropped(&self, state: ParkedState) {
        if state.unsaved_time() < WORTH_STORING {
            return;
        }
        let (key, previous) = (state.key, Some(state.seq));
        let snapshot = Some(state.into_snapshot());
        self.store_state(Batch { snapshot, ..Batch::new(key, previous) }).await;
    }

    async fn store_state(&self, batch: Batch) {
        match self.store.commit(batch).await {
            // Ok; or the session has committed further epochs meanwhile.
            Ok(()) | Err(StoreError::AlreadyStored) => {}
            // Nothing is lost, because the epochs are replayed.
            Err(error) => {
                tracing::warn!(session = %self.id, %error, "a session's state was not stored");
            }
        }
    }

    /// Takes what is already known of the session when the task begins: its parked state or its
    /// row.
    pub(super) async fn begin(&self, active: &mut Option<Active>) -> Option<Box<SessionRow>> {
        let known = self.known.lock().unwrap_or_else(PoisonError::into_inner).take();
        match known.filter(|_| active.is_none())? {
            Known::Row(row) => Some(row),
            Known::State(state) => {
                *active = self.unparked(*state).await;
                None
            }
        }
    }

    /// The session in memory, from the state with which it was parked.
    async fn unparked(&self, parked: ParkedState) -> Option<Active> {
        let configuration = parked.configuration().clone();
        let (epoch_time, kept_day) = (parked.epoch_time, parked.kept_day);
        let decoded = match parked.length() <= DECODED_HERE {
            true => caught(|| parked.decoded()),
            false => {
                let decoding = self.solvers.run(Lane::Restore, || parked.decoded());
                decoding.await.map_err(|error| error.to_string())
            }
        };
        let (unconfirmed, raw) = (None, None);
        match decoded {
            Ok((Ok(state), buffer)) => {
                self.solvers.memory().recycle_buffer(buffer);
                let committed = Arc::new(state);
                Some(Active { committed, unconfirmed, configuration, epoch_time, raw, kept_day })
            }
            Ok((Err(error), _)) => {
                tracing::error!(session = %self.id, %error, "a parked state cannot be read");
                None
            }
            Err(error) => {
                tracing::error!(session = %self.id, error, "a parked state is lost");
                None
            }
        }
    }

    /// The state after the last committed epoch, from the store.
    pub(super) async fn restored(
        &self,
        configuration: &ActiveConfiguration,
    ) -> Result<State, SessionError> {
        // Only few at a time, so that the first sessions are ready long before the last.
        let _admitted = self.solvers.admitted_restore().await;
        let stored = self.store.stored_state(self.key).await?;
        let arcs = match stored.has_arcs {
            true => self.store.arcs(self.key).await?,
            false => Vec::new(),
        };
        let replay = Replay {
            store: self.store.clone(),
            aiding: self.aiding.clone(),
            solvers: self.solvers.clone(),
            tenant: self.tenant.clone(),
            key: self.key,
            device: self.device.clone(),
            with: ReplayWith::Stored,
            arcs: arcs.into(),
            known: Some(Arc::new(configuration.estimation.clone())),
            tolerates_missing: true,
        };
        restored(&replay, stored, &configuration.estimation).await
    }
}
