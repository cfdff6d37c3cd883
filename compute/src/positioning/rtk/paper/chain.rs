//! The epochs in the graph.

use nalgebra::{Matrix3, SMatrix, Vector3};

use crate::config::GraphOptions;
use crate::gnss::{GpsTime, LocalFrame};
use crate::graph::{
    Covariances, Elimination, EliminationError, Estimate, OptimizerOptions, Prior, System,
    Workspace, optimize,
};
use crate::positioning::rtk::observed::RtkEpoch;
use crate::positioning::rtk::tracking::Tracking;
use crate::positioning::starts::{START_M, WINDOW_EPOCHS_MIN, start_frame};
use crate::snapshot::state_fields;

use super::epoch::{PaperEpoch, Rows, STATE, State};

/// The epochs in the graph, their estimate, and the prior of the marginalised ones.
#[derive(Debug)]
pub(crate) struct PaperChain {
    pub(crate) frame: LocalFrame,
    pub(crate) epochs: Vec<PaperEpoch>,
    pub(crate) estimate: Estimate<STATE>,
    pub(crate) prior: Prior<STATE>,
    /// Local velocity by the newest epoch's Doppler (m/s).
    pub(crate) velocity_m_s: Option<Vector3<f64>>,
    /// Satellites and Doppler of the newest epoch, for its answer.
    pub(crate) newest: RtkEpoch,
    /// Without arcs: nothing goes from one epoch to the next.
    pub(crate) tracking: Tracking,
}

state_fields!(PaperChain { frame, epochs, estimate, prior, velocity_m_s, newest, tracking }
    checked by is_whole);

impl PaperChain {
    pub(crate) fn empty() -> Self {
        Self {
            frame: start_frame(),
            epochs: Vec::new(),
            estimate: Estimate::new(),
            prior: Prior::none(),
            velocity_m_s: None,
            newest: RtkEpoch::default(),
            tracking: Tracking::new(),
        }
    }

    fn is_whole(&self) -> bool {
        self.epochs.len() == self.estimate.states.len() && self.estimate.border.is_empty()
    }

    /// The newest position, extrapolated to `time` by the velocity (m).
    pub(crate) fn expected(&self, time: GpsTime) -> State {
        let (Some(last), Some(state)) = (self.epochs.last(), self.estimate.states.last()) else {
            return State::zeros();
        };
        state + self.velocity_m_s.unwrap_or_default() * (time - last.time)
    }

    /// Whether the oldest epoch leaves.
    pub(crate) fn is_over(&self, options: &GraphOptions) -> bool {
        let (Some(first), Some(last)) = (self.epochs.first(), self.epochs.last()) else {
            return false;
        };
        let count = self.epochs.len();
        options.window_epochs_max < count
            || (WINDOW_EPOCHS_MIN < count && options.window_s < last.time - first.time)
    }

    /// Marginalises the oldest epoch into the prior.
    pub(crate) fn forget_oldest(
        &mut self,
        (system, elimination): &mut (System<STATE>, Elimination<STATE>),
    ) -> Result<PaperEpoch, EliminationError> {
        system.reset(2, 0);
        self.prior.add_to(0, &self.estimate, system);
        self.epochs[0].add_to(0, &self.estimate, system);
        self.epochs[1].add_tie_to(0, &self.estimate, system);
        self.prior.marginalize(system, &self.estimate, |_| true, elimination)?;
        self.estimate.states.remove(0);
        Ok(self.epochs.remove(0))
    }
}

/// Prior of the first position: it has the accuracy of a single-point position.
pub(crate) fn starting_prior() -> Prior<STATE> {
    let information = SMatrix::identity() * START_M.powi(-2);
    Prior::on_state(State::zeros(), information)
}

/// Moves the estimate to the minimum of (25), and returns the covariance of each position (m²).
///
/// # Errors
/// The epochs do not determine their positions.
pub(crate) fn solved(
    mut rows: Rows<'_>,
    estimate: &mut Estimate<STATE>,
    options: &OptimizerOptions,
    workspace: &mut Workspace<STATE>,
) -> Result<Vec<Matrix3<f64>>, EliminationError> {
    optimize(&mut rows, estimate, options, workspace)?;
    let mut covariances = Vec::new();
    Covariances::new().all_states(&workspace.elimination, &mut covariances);
    Ok(covariances)
}
