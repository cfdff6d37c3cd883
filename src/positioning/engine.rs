//! What every mode is: state as plain data, and the memory it computes in apart from it.

use std::fmt::Debug;

use crate::config::PositioningOptions;
use crate::gnss::{Epoch, GpsTime, Navigation, Solution};
use crate::snapshot::Snapshot;

use super::aiding::BaseAiding;
use super::setup::Setup;

/// One epoch with everything it is solved from.
#[derive(Clone, Copy, Debug)]
pub(super) struct EpochInputs<'a> {
    pub(super) epoch: &'a Epoch,
    pub(super) navigation: &'a Navigation,
    /// The base, for modes relative to one.
    pub(super) base: Option<BaseAiding<'a>>,
    pub(super) setup: &'a Setup,
}

impl<'a> EpochInputs<'a> {
    /// What the user asked for.
    pub(super) fn options(&self) -> &'a PositioningOptions {
        &self.setup.options
    }
}

/// The state of one mode, and how an epoch moves it on.
///
/// The state is all that the next answers depend on besides options and navigation data: copies and
/// snapshots of it go on with the same bits.
pub(super) trait Engine: Clone + Debug + Snapshot {
    /// Memory to compute in. No answer depends on what an earlier epoch left in it.
    type Scratch: Default + Debug;

    /// The state before the first epoch; with `revises`, a mode with a window answers epochs again
    /// as they leave it.
    fn new(setup: &Setup, revises: bool) -> Self;

    /// Whether a state that was read from a snapshot fits the options.
    fn fits(&self, _setup: &Setup) -> bool {
        true
    }

    /// Solves one epoch. Later answers to earlier epochs are appended to `revisions`.
    fn advance(
        &mut self,
        inputs: &EpochInputs<'_>,
        scratch: &mut Self::Scratch,
        revisions: &mut Vec<Solution>,
    ) -> Solution;

    /// Answers every epoch again that the window still holds; no epoch may follow.
    fn finish(
        &mut self,
        _setup: &Setup,
        _scratch: &mut Self::Scratch,
        _revisions: &mut Vec<Solution>,
    ) {
    }

    /// Time of the oldest epoch that may still be answered again.
    fn oldest_unrevised(&self) -> Option<GpsTime> {
        None
    }
}
