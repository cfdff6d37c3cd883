//! A session answered from all its epochs at once.

use std::sync::Arc;

use crate::aiding::bases::BaseInput;
use crate::gnss::Solution;
use crate::positioning::{Aiding, Batch};
use crate::recording::ApproximatePosition;
use crate::session::antenna::corrected;
use crate::session::base_selection::BaseSelection;
use crate::session::replay::{Step, StepBase};
use crate::session::state::Configuration;
use crate::store::BaseKey;

/// The epochs of a session, with one configuration. Each arc is estimated by itself.
pub(super) struct WholeSession {
    configuration: Configuration,
    batch: Batch,
    selection: BaseSelection,
    antenna_position: ApproximatePosition,
    arcs: Arc<[u64]>,
    /// Number of the last epoch.
    last: Option<u64>,
}

impl WholeSession {
    pub(super) fn new(configuration: Configuration, arcs: Arc<[u64]>) -> Self {
        Self {
            batch: Batch::new((*configuration.options).clone()),
            configuration,
            selection: BaseSelection::default(),
            antenna_position: ApproximatePosition::default(),
            arcs,
            last: None,
        }
    }

    /// Adds an epoch. Returns the answers of the epochs before it, if it begins a new arc, or if
    /// the base's antenna has another calibration from this epoch on.
    pub(super) fn push(&mut self, step: Step) -> Vec<Solution> {
        let begins_arc = self.last.is_some_and(|last| step.is_first_after(last, &self.arcs));
        let mut ended = if begins_arc { self.end_arc() } else { Vec::new() };
        let Step { seq, mut epoch, navigation, base, .. } = step;
        let (navigation, options) = (&navigation.navigation, &self.configuration.options);
        let mut input = match base {
            StepBase::None => None,
            StepBase::Given(input) => Some(input),
            StepBase::Selected(source) => self.selection.next(&source, &epoch, navigation, options),
        };
        let is_corrected = self.configuration.antenna.is_some();
        if is_corrected && input.as_ref().is_some_and(BaseInput::is_recalibrated) {
            ended.extend(self.end_arc());
        }
        if let Some(antenna) = &self.configuration.antenna {
            let position = &mut self.antenna_position;
            (epoch, input) = corrected(antenna, position, &epoch, navigation, input.as_ref());
        }
        let base = input.as_ref().and_then(BaseInput::aiding);
        self.batch.push(&epoch, &Aiding { navigation, base });
        self.selection.received(input.as_ref());
        self.last = Some(seq);
        ended
    }

    /// The base of the last epoch that had one.
    pub(super) const fn base(&self) -> Option<BaseKey> {
        self.selection.base
    }

    /// Ends the arc, and returns its answers. The next epoch begins another arc.
    pub(super) fn end_arc(&mut self) -> Vec<Solution> {
        let next = Batch::new((*self.configuration.options).clone());
        self.selection = BaseSelection::default();
        std::mem::replace(&mut self.batch, next).finish()
    }
}
