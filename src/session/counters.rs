//! Counts of all sessions since the start.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use crate::gnss::Status;
use crate::meters::{self, Counter, Family, Histogram, Label};

/// The counters, which all tasks share.
#[derive(Debug)]
pub struct Counters {
    pub(super) meters: SessionMeters,
    /// The members of the families in `meters`, so that they are not looked up for each epoch.
    stages: [Histogram; Stage::ALL.len()],
    epochs: [Counter; Status::ALL.len()],
    /// Sessions with a state in memory.
    pub(super) in_memory: AtomicUsize,
    /// Epochs in all mailboxes.
    pub(super) waiting: Arc<AtomicUsize>,
}

/// Meters of all sessions. Clones share them.
#[derive(Clone, Debug)]
pub(crate) struct SessionMeters {
    /// Number of states that were loaded from the store, of sessions with epochs.
    pub(crate) restores: Counter,
    /// Epochs on which an estimator panicked, and chunks on which a decoder did.
    pub(crate) quarantined: Counter,
    /// Committed epochs, by the status of their first answer.
    pub(crate) epochs: Family<Label, Counter>,
    /// Refused epochs.
    pub(crate) refused: Counter,
    /// Times of each stage (s).
    pub(crate) stages: Family<Label, Histogram, fn() -> Histogram>,
}

/// A stage of a batch of epochs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stage {
    /// A push waits in the mailbox (elapsed time).
    Waiting,
    /// The estimator computes: processor time.
    Solving,
    /// The batch waits for its transaction and becomes durable.
    Committing,
}

impl Stage {
    const ALL: [Self; 3] = [Self::Waiting, Self::Solving, Self::Committing];

    const fn name(self) -> &'static str {
        match self {
            Self::Waiting => "waiting",
            Self::Solving => "solving",
            Self::Committing => "committing",
        }
    }
}

impl Counters {
    pub(super) fn new() -> Self {
        let meters = SessionMeters {
            restores: Counter::default(),
            quarantined: Counter::default(),
            epochs: Family::default(),
            refused: Counter::default(),
            stages: Family::new_with_constructor(meters::times),
        };
        // Created now, so that a count that has not occurred is reported as 0.
        let stage = |stage: Stage| meters.stages.get_or_create(&[("stage", stage.name())]).clone();
        let status =
            |status: Status| meters.epochs.get_or_create(&[("status", status.name())]).clone();
        let (stages, epochs) = (Stage::ALL.map(stage), Status::ALL.map(status));
        Self { meters, stages, epochs, in_memory: AtomicUsize::new(0), waiting: Arc::default() }
    }

    /// Number of states that were loaded from the store, of sessions with epochs.
    pub fn restores(&self) -> u64 {
        self.meters.restores.get()
    }

    /// Number of epochs on which an estimator panicked, and of chunks on which a decoder did.
    pub fn quarantined(&self) -> u64 {
        self.meters.quarantined.get()
    }

    /// Meters for the operator.
    pub(crate) const fn meters(&self) -> &SessionMeters {
        &self.meters
    }

    /// Number of epochs that wait in all mailboxes.
    pub(crate) fn waiting(&self) -> usize {
        self.waiting.load(Ordering::Acquire)
    }

    /// Number of sessions with a state in memory.
    pub(crate) fn in_memory(&self) -> usize {
        self.in_memory.load(Ordering::Relaxed)
    }

    /// Records the time of a stage.
    pub(super) fn record(&self, stage: Stage, elapsed: Duration) {
        self.stages[stage as usize].observe(elapsed.as_secs_f64());
    }

    /// Counts epochs that were answered with a refusal instead of a solution.
    pub(crate) fn count_refused(&self, epochs: usize) {
        self.meters.refused.inc_by(epochs as u64);
    }

    /// Counts a committed epoch.
    pub(super) fn count_epoch(&self, status: Status) {
        let index = Status::ALL.iter().position(|known| *known == status);
        self.epochs[index.expect("all are known")].inc();
    }
}
