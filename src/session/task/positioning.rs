//! Epochs that are being positioned, one after another, on the solver pool.

use std::sync::Arc;
use std::time::{Duration, Instant};
use std::vec::IntoIter;

use crate::clock::Stopwatch;
use crate::positioning::Scratch;
use crate::session::base_selection::BaseSource;
use crate::session::batch::{BatchAiding, EpochRules, SolvedBatch};
use crate::session::configurations::ActiveConfiguration;
use crate::session::counters::Stage;
use crate::session::solvers::{Lane, MemoryPool, Progress};
use crate::session::state::State;
use crate::session::{SequencedEpoch, SessionError};
use crate::traces::Work;

use super::{Active, Task};

/// Batches up to this expected time are positioned by the session's task itself. Using a thread of
/// the pool costs two changes of threads, some 20 µs of processor time.
const HERE_MAX: Duration = Duration::from_micros(500);

impl Task {
    /// Positions a batch, starting from a copy of the committed state. It runs on this thread if it
    /// is expected to be short, otherwise on the solver pool.
    pub(super) async fn position(
        &self,
        current: &mut Active,
        rules: EpochRules,
        epochs: Vec<SequencedEpoch>,
    ) -> Result<SolvedBatch, SessionError> {
        let Active { committed, configuration, epoch_time, .. } = current;
        let committed = committed.clone();
        let aiding = self.aiding_for(configuration, &epochs);
        let memory = self.solvers.memory().clone();
        let configuration = configuration.clone();
        let progress = Positioned::Nothing { committed, memory };
        let count = u32::try_from(epochs.len()).unwrap_or(u32::MAX);
        let waiting = epochs.into_iter();
        let used = Duration::ZERO;
        let work = Positioning { progress, waiting, aiding, configuration, rules, used };
        let is_short = epoch_time.is_some_and(|each| each.saturating_mul(count) <= HERE_MAX);
        let begun = Instant::now();
        let done = match is_short {
            true => self.solvers.run_here(|scratch| work.completed(scratch))?,
            false => self.solvers.in_quanta(Lane::RealTime, work, Positioning::step).await?,
        };
        self.counters.record(Stage::Solving, done.used);
        self.stages.note(Work::Solve, begun);
        let each = done.used / count.max(1);
        // The estimate follows a longer time at once, and a shorter one slowly.
        *epoch_time = Some(epoch_time.map_or(each, |before| each.max(before * 7 / 8)));
        Ok(done.batch().expect("work that is done has a batch"))
    }

    /// The aiding data for these epochs: everything known now.
    fn aiding_for(
        &self,
        configuration: &ActiveConfiguration,
        epochs: &[SequencedEpoch],
    ) -> BatchAiding {
        let times = || epochs.iter().map(|sequenced| sequenced.epoch.time);
        let span = times().min().zip(times().max());
        let options = &configuration.estimation.options;
        let source =
            BaseSource::new(&self.aiding.bases, &self.tenant, &configuration.bases, span, options);
        BatchAiding { navigation: self.aiding.navigation.current_for(&self.device), source }
    }
}

/// Epochs that are being positioned.
struct Positioning {
    progress: Positioned,
    waiting: IntoIter<SequencedEpoch>,
    aiding: BatchAiding,
    configuration: Arc<ActiveConfiguration>,
    rules: EpochRules,
    /// Processor time of the steps so far.
    used: Duration,
}

/// The result so far.
enum Positioned {
    /// Nothing. The first step copies the committed state, so that no network thread does.
    Nothing { committed: Arc<State>, memory: MemoryPool },
    /// These epochs.
    Epochs(Box<SolvedBatch>),
}

impl Positioning {
    /// Positions the next epoch.
    fn step(&mut self, scratch: &mut Scratch) -> Progress {
        self.advance(1, scratch)
    }

    /// Positions all epochs. Returns the processor time with them.
    fn completed(mut self, scratch: &mut Scratch) -> (Self, Duration) {
        self.advance(usize::MAX, scratch);
        let used = self.used;
        (self, used)
    }

    /// Positions the next epochs, at most `count`. Their time is measured together, because two
    /// reads of a thread's clock take a tenth of the time of a short epoch.
    fn advance(&mut self, count: usize, scratch: &mut Scratch) -> Progress {
        let stopwatch = Stopwatch::started();
        if let Positioned::Nothing { committed, memory } = &self.progress {
            let batch = SolvedBatch::new(memory.copy_of(committed));
            self.progress = Positioned::Epochs(Box::new(batch));
        }
        let Positioned::Epochs(batch) = &mut self.progress else { return Progress::Remaining };
        let (aiding, estimation) = (&self.aiding, &self.configuration.estimation);
        let before = batch.rows.len();
        for epoch in self.waiting.by_ref().take(count) {
            batch.position(epoch, aiding, estimation, &self.rules, scratch);
        }
        let used = stopwatch.elapsed();
        self.used += used;
        if before < batch.rows.len() {
            batch.state.unsaved_time += used;
        }
        if self.waiting.len() != 0 {
            return Progress::Remaining;
        }
        batch.finish(&self.rules);
        if batch.snapshot.is_some() {
            self.used += stopwatch.elapsed() - used;
        }
        Progress::Done
    }

    /// The epochs, once all are positioned.
    fn batch(self) -> Option<SolvedBatch> {
        match self.progress {
            Positioned::Nothing { .. } => None,
            Positioned::Epochs(batch) => Some(*batch),
        }
    }
}
