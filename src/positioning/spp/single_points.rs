//! Mode `spp`: every epoch by itself.

use crate::gnss::{Ecef, Solution};
use crate::positioning::engine::{Engine, EpochInputs};
use crate::positioning::setup::Setup;
use crate::snapshot::state_fields;

use super::SinglePoint;

/// The last position, from which the next epoch is solved.
#[derive(Debug)]
pub(crate) struct SinglePoints {
    start: Option<Ecef>,
}

state_fields!(SinglePoints { start });

impl Engine for SinglePoints {
    type Scratch = SinglePoint;

    fn new(_setup: &Setup, _revises: bool) -> Self {
        Self { start: None }
    }

    fn advance(
        &mut self,
        inputs: &EpochInputs<'_>,
        scratch: &mut SinglePoint,
        _revisions: &mut Vec<Solution>,
    ) -> Solution {
        let solution = scratch.solve(inputs, self.start);
        self.start = solution.estimate.as_ref().map(|estimate| estimate.position);
        solution
    }
}
