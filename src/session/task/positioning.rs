//! Epochs that are being positioned, one after another, on the solver pool.

use std::sync::Arc;
use std::vec::IntoIter;

use crate::clock::gps_time;
use crate::positioning::Scratch;
use crate::session::base_selection::BaseSource;
use crate::session::batch::{BatchAiding, EpochRules, SolvedBatch};
use crate::session::replay::ActiveConfiguration;
use crate::session::solvers::{Lane, MemoryPool, Progress};
use crate::session::state::State;
use crate::session::{SequencedEpoch, SessionError};

use super::Task;

impl Task {
    /// Positions a batch on the solver pool, starting from a copy of `committed`.
    pub(super) async fn position(
        &self,
        committed: Arc<State>,
        configuration: &Arc<ActiveConfiguration>,
        epochs: Vec<SequencedEpoch>,
    ) -> Result<SolvedBatch, SessionError> {
        let aiding = self.aiding_for(configuration, &epochs);
        let rules = EpochRules {
            observations_max: self.observations_per_epoch,
            now: gps_time(self.clock.unix_ms()),
            future_s: self.future_s,
        };
        let memory = self.solvers.memory().clone();
        let configuration = configuration.clone();
        let progress = Positioned::Nothing { committed, memory };
        let waiting = epochs.into_iter();
        let work = Positioning { progress, waiting, aiding, configuration, rules };
        let done = self.solvers.in_quanta(Lane::RealTime, work, Positioning::step).await?;
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
        let source = BaseSource::new(&self.aiding.bases, &configuration.bases, span, options);
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
}

/// What is positioned so far.
enum Positioned {
    /// Nothing. The first step copies the committed state, so that no network thread does.
    Nothing { committed: Arc<State>, memory: MemoryPool },
    /// These epochs.
    Epochs(Box<SolvedBatch>),
}

impl Positioning {
    /// Positions the next epoch.
    fn step(&mut self, scratch: &mut Scratch) -> Progress {
        if let Positioned::Nothing { committed, memory } = &self.progress {
            let batch = SolvedBatch::new(memory.copy_of(committed));
            self.progress = Positioned::Epochs(Box::new(batch));
        }
        let Positioned::Epochs(batch) = &mut self.progress else { return Progress::Remaining };
        if let Some(epoch) = self.waiting.next() {
            let (aiding, estimation) = (&self.aiding, &self.configuration.estimation);
            batch.position(epoch, aiding, estimation, &self.rules, scratch);
        }
        if self.waiting.len() != 0 {
            return Progress::Remaining;
        }
        batch.finish();
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
