//! A computation on request, in quanta. Between two quanta others use the solver pool. When the
//! caller disconnects, the computation ends.

use std::sync::Arc;
use std::time::Duration;
use std::vec::IntoIter;

use crate::aiding::bases::BaseInput;
use crate::clock::Stopwatch;
use crate::config::OutputOptions;
use crate::gnss::{Navigation, Solution};
use crate::positioning::{Aiding, EstimatorState, Scratch};
use crate::recording::ApproximatePosition;
use crate::store::StoredSolution;

use super::antenna::corrected;
use super::base_selection::{BaseSelection, BaseSource};
use super::solvers::{Lane, Progress, Solvers};
use super::state::Configuration;
use super::{SequencedEpoch, SessionError};

/// A solution that is not stored.
#[derive(Clone, Debug, PartialEq)]
pub struct Computed {
    /// Number of the epoch.
    pub seq: u64,
    /// The solution.
    pub solution: Solution,
    /// Version of the program that computed it.
    pub version: Arc<str>,
    /// Hash of the configuration in force.
    pub configuration_hash: Arc<str>,
    /// Frame and heights in which the position is reported.
    pub output: OutputOptions,
}

impl Computed {
    /// A stored solution, reported with `output`.
    pub(super) fn of_stored(stored: StoredSolution, output: OutputOptions) -> Self {
        let StoredSolution { seq, revision: _, solution, version, configuration_hash } = stored;
        Self { seq, solution, version, configuration_hash, output }
    }
}

/// Epochs that a new estimator positions, and its progress.
pub(super) struct Computation {
    estimation: Configuration,
    navigation: Arc<Navigation>,
    source: BaseSource,
    estimator: EstimatorState,
    selection: BaseSelection,
    antenna_position: ApproximatePosition,
    waiting: IntoIter<SequencedEpoch>,
    computed: Vec<Computed>,
    /// Processor time used on the solver pool so far, and its limit.
    used: Duration,
    limit: Duration,
}

impl Computation {
    /// The computation of `epochs` with the aiding data they need, within `limit` on the solver
    /// pool.
    pub(super) fn new(
        estimation: Configuration,
        epochs: Vec<SequencedEpoch>,
        navigation: Arc<Navigation>,
        source: BaseSource,
        limit: Duration,
    ) -> Self {
        Self {
            estimator: EstimatorState::prepared(&estimation.options, false),
            estimation,
            navigation,
            source,
            selection: BaseSelection::default(),
            antenna_position: ApproximatePosition::default(),
            computed: Vec::with_capacity(epochs.len()),
            waiting: epochs.into_iter(),
            used: Duration::ZERO,
            limit,
        }
    }

    /// Computes all epochs. Dropping the future ends the computation after its present quantum.
    ///
    /// # Errors
    /// The estimator panics, or the epochs need more than `limit` on the solver pool.
    pub(super) async fn run(self, solvers: &Solvers) -> Result<Vec<Computed>, SessionError> {
        let Self { computed, waiting, limit, .. } =
            solvers.in_quanta(Lane::OnDemand, self, Self::advance).await?;
        match (waiting.len(), computed.len()) {
            (0, _) => Ok(computed),
            (left, done) => Err(SessionError::TooCostly { done, epochs: done + left, limit }),
        }
    }

    /// Computes the next epoch, unless the computation has used its time.
    fn advance(&mut self, scratch: &mut Scratch) -> Progress {
        if self.limit < self.used {
            return Progress::Done;
        }
        let stopwatch = Stopwatch::started();
        if let Some(epoch) = self.waiting.next() {
            let computed = self.position(epoch, scratch);
            self.computed.push(computed);
        }
        self.used += stopwatch.elapsed();
        if self.waiting.len() == 0 { Progress::Done } else { Progress::Remaining }
    }

    fn position(
        &mut self,
        SequencedEpoch { seq, mut epoch }: SequencedEpoch,
        scratch: &mut Scratch,
    ) -> Computed {
        let Self { estimation, navigation, source, selection, .. } = self;
        let Configuration { version, hash, options, antenna } = estimation;
        let mut input = selection.next(source, &epoch, navigation, options);
        if let Some(antenna) = antenna {
            let (rover, base) = (&mut self.antenna_position, input.as_ref());
            (epoch, input) = corrected(antenna, rover, &epoch, navigation, base);
        }
        let base = input.as_ref().and_then(BaseInput::aiding);
        let aiding = Aiding { navigation, base };
        let solution = self.estimator.advance(&epoch, &aiding, scratch);
        selection.update(input.as_ref(), &solution);
        let (version, configuration_hash) = (version.clone(), hash.clone());
        Computed { seq, solution, version, configuration_hash, output: options.output }
    }
}
