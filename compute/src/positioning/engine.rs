//! The interface of every mode: its state is plain data, and its scratch is separate.

use std::fmt::Debug;

use crate::config::PositioningOptions;
use crate::gnss::{Epoch, GpsTime, Navigation, Solution};
use crate::snapshot::Snapshot;

use super::aiding::BaseAiding;
use super::measurements::{CorrectedRanges, ReceiverBands};
use super::setup::Setup;

/// One epoch with all inputs of its solution.
#[derive(Clone, Copy, Debug)]
pub(super) struct EpochInputs<'a> {
    pub(super) epoch: &'a Epoch,
    pub(super) navigation: &'a Navigation,
    /// The base, for modes relative to one.
    pub(super) base: Option<BaseAiding<'a>>,
    /// The pseudoranges that a base corrected, for an estimator that takes no others.
    pub(super) corrected: Option<&'a CorrectedRanges>,
    pub(super) setup: &'a Setup,
    /// The delay between the receiver's bands, as far as it is known, this epoch included.
    pub(super) bands: ReceiverBands,
}

impl<'a> EpochInputs<'a> {
    /// The user's options.
    pub(super) fn options(&self) -> &'a PositioningOptions {
        &self.setup.options
    }
}

/// The state of one mode, and how an epoch advances it.
///
/// Besides options and navigation data the next answers depend on the state only: copies and
/// snapshots of it continue with the same bits.
pub(super) trait Engine: Clone + Debug + Snapshot {
    /// Scratch. No answer depends on its content.
    type Scratch: Default + Debug;

    /// The state before the first epoch. With `revises`, a mode with a window revises epochs when
    /// they leave it.
    fn new(setup: &Setup, revises: bool) -> Self;

    /// Whether a state that was read from a snapshot fits the options.
    fn fits(&self, _setup: &Setup) -> bool {
        true
    }

    /// Solves one epoch. Revisions of earlier epochs are appended to `revisions`.
    fn advance(
        &mut self,
        inputs: &EpochInputs<'_>,
        scratch: &mut Self::Scratch,
        revisions: &mut Vec<Solution>,
    ) -> Solution;

    /// Revises every epoch that is still in the window; no epoch may follow.
    fn finish(
        &mut self,
        _setup: &Setup,
        _scratch: &mut Self::Scratch,
        _revisions: &mut Vec<Solution>,
    ) {
    }

    /// Time of the oldest epoch that may still be revised.
    fn oldest_unrevised(&self) -> Option<GpsTime> {
        None
    }
}
