//! What the driver of an estimator relative to a base asks of its solver.

use std::fmt::Debug;

use nalgebra::SMatrix;

use crate::gnss::{Ecef, GpsTime, LocalFrame, Reason, SatelliteId, Solution};
use crate::positioning::differencing::SingleDifferences;
use crate::positioning::engine::{Engine, EpochInputs};
use crate::positioning::fgo::KnownPosition;
use crate::positioning::setup::Setup;
use crate::snapshot::Snapshot;

use super::ambiguity::Resolution;
use super::observed::{RtkEpoch, STATE, State};
use super::tracking::Tracking;

/// A solver of differences: a window of epochs, or a filter.
pub(crate) trait RelativeSolver: Clone + Debug + Snapshot {
    /// The estimator that answers while no base can be used.
    type Alone: Engine;
    /// The epochs that may be revised.
    type Past: Clone + Debug + Snapshot;
    /// Scratch of the solver.
    type Scratch: Default + Debug;

    /// Whether its positions without integers are tested against rival positions.
    const TESTS_RIVALS: bool = true;

    /// Whether a chain without ambiguities accompanies the epochs without integers.
    const IS_ACCOMPANIED: bool = false;

    /// A solver before its first epoch.
    fn new() -> Self;

    /// Begins the estimator without a base at the last position with integers.
    fn begin_alone(
        _alone: &mut Self::Alone,
        _known: &KnownPosition,
        _inputs: &EpochInputs<'_>,
        _scratch: &mut <Self::Alone as Engine>::Scratch,
    ) {
    }

    /// An empty list of past epochs; it keeps epochs only if `revises`.
    fn past(revises: bool) -> Self::Past;

    /// Time of the newest epoch; `None` if the solver must restart.
    fn last_time(&self) -> Option<GpsTime>;

    /// The newest state, extrapolated to `time` by its velocity.
    fn predicted(&self, time: GpsTime) -> State;

    /// The local frame of the states.
    fn frame(&self) -> &LocalFrame;

    /// The arcs, held integers and noise scales.
    fn tracking(&mut self) -> &mut Tracking;

    /// Factor on the variance of a position without integers.
    fn float_factor(&mut self) -> f64 {
        self.tracking().receivers.pseudorange_noise.variance_factor()
    }

    /// Drops all states and arcs, so that the solver restarts. The noise scales stay.
    fn clear(&mut self);

    /// Drops all states and arcs, and sets the frame's origin to `start`.
    fn begin(&mut self, start: Ecef, guess: &State);

    /// Drops states, arcs, noise scales and biases, because the base is another one.
    fn forget(&mut self);

    /// Solves an epoch and resolves its integers.
    ///
    /// # Errors
    /// The epoch cannot be solved. The solver has then dropped its states and arcs.
    fn solve(
        &mut self,
        new: NewEpoch<'_>,
        past: &mut Self::Past,
        scratch: &mut Self::Scratch,
    ) -> Result<Resolved, Reason>;

    /// The epoch that was solved last.
    fn epoch<'a>(&'a self, scratch: &'a Self::Scratch) -> &'a RtkEpoch;

    /// Records an answer, and whether it is relative to the base. Revises the epochs that leave the
    /// window.
    fn remember(
        &self,
        _answer: (&Solution, bool),
        _inputs: &EpochInputs<'_>,
        _past: &mut Self::Past,
        _scratch: &mut Self::Scratch,
        _revisions: &mut Vec<Solution>,
    ) {
    }

    /// Revises all epochs for the last time.
    fn answer_all(
        &self,
        _setup: &Setup,
        _past: &mut Self::Past,
        _scratch: &mut Self::Scratch,
        _revisions: &mut Vec<Solution>,
    ) {
    }

    /// Makes the last answer of each epoch final, because the states no longer exist.
    fn leave_all(_past: &mut Self::Past, _revisions: &mut Vec<Solution>) {}

    /// Time of the oldest epoch that may be revised.
    fn oldest(_past: &Self::Past) -> Option<GpsTime> {
        None
    }
}

/// An epoch to be solved.
pub(crate) struct NewEpoch<'a> {
    pub(crate) time: GpsTime,
    /// Its approximate state.
    pub(crate) guess: State,
    pub(crate) differences: &'a SingleDifferences,
    pub(crate) setup: &'a Setup,
    /// Satellites whose arcs ended; the solver appends to the list.
    pub(crate) slipped: &'a mut Vec<SatelliteId>,
}

/// The state of an epoch, and the outcome of the integer search.
pub(crate) struct Resolved {
    pub(crate) state: State,
    pub(crate) covariance: SMatrix<f64, STATE, STATE>,
    /// Whether the state's velocity is known.
    pub(crate) has_velocity: bool,
    pub(crate) resolution: Resolution,
}
