//! A computation on request, in quanta: between two of them others use the solver pool, and a
//! caller that has gone ends it.

use std::sync::Arc;
use std::time::{Duration, Instant};
use std::vec::IntoIter;

use crate::aiding::bases::BaseInput;
use crate::gnss::{Navigation, Solution};
use crate::positioning::{Aiding, EstimatorState, Scratch};
use crate::recording::ApproximatePosition;
use crate::store::StoredSolution;

use super::antenna::corrected;
use super::base_selection::{BaseSelection, BaseSource};
use super::solvers::Solvers;
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
}

impl From<StoredSolution> for Computed {
    fn from(stored: StoredSolution) -> Self {
        let StoredSolution { seq, revision: _, solution, version, configuration_hash } = stored;
        Self { seq, solution, version, configuration_hash }
    }
}

/// A quantum ends after this time or this number of epochs.
const QUANTUM: Duration = Duration::from_millis(10);
const QUANTUM_EPOCHS: usize = 16;

/// Epochs that a new estimator positions.
pub(super) struct Computation {
    estimation: Configuration,
    navigation: Arc<Navigation>,
    source: BaseSource,
    estimator: EstimatorState,
    selection: BaseSelection,
    antenna_position: ApproximatePosition,
    waiting: IntoIter<SequencedEpoch>,
    computed: Vec<Computed>,
    /// Time on the solver pool so far.
    used: Duration,
}

impl Computation {
    /// The computation of `epochs` with what positioning needs beside them.
    pub(super) fn new(
        estimation: Configuration,
        epochs: Vec<SequencedEpoch>,
        navigation: Arc<Navigation>,
        source: BaseSource,
    ) -> Self {
        Self {
            estimator: EstimatorState::new(estimation.options.clone(), false),
            estimation,
            navigation,
            source,
            selection: BaseSelection::default(),
            antenna_position: ApproximatePosition::default(),
            computed: Vec::with_capacity(epochs.len()),
            waiting: epochs.into_iter(),
            used: Duration::ZERO,
        }
    }

    /// Computes all epochs. Dropping the future ends the computation after its present quantum.
    ///
    /// # Errors
    /// The estimator panics, or the epochs need more than `limit` on the solver pool.
    pub(super) async fn run(
        self,
        solvers: &Solvers,
        limit: Duration,
    ) -> Result<Vec<Computed>, SessionError> {
        let mut computation = self;
        while computation.waiting.len() != 0 {
            if limit < computation.used {
                let (done, of) = (computation.computed.len(), computation.waiting.len());
                return Err(SessionError::TooCostly { done, epochs: done + of, limit });
            }
            let quantum = move |scratch: &mut Scratch| {
                computation.advance(scratch);
                computation
            };
            computation = solvers.estimate(quantum).await?;
        }
        Ok(computation.computed)
    }

    /// Computes the epochs of a quantum.
    fn advance(&mut self, scratch: &mut Scratch) {
        let begun = Instant::now();
        for _ in 0..QUANTUM_EPOCHS {
            let Some(epoch) = self.waiting.next() else { break };
            let computed = self.position(epoch, scratch);
            self.computed.push(computed);
            if QUANTUM < begun.elapsed() {
                break;
            }
        }
        self.used += begun.elapsed();
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
        Computed { seq, solution, version: version.clone(), configuration_hash: hash.clone() }
    }
}
