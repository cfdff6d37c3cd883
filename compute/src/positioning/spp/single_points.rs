//! Mode `spp`: every epoch is solved independently.

use crate::gnss::{Ecef, Solution};
use crate::positioning::engine::{Engine, EpochInputs};
use crate::positioning::setup::Setup;
use crate::snapshot::state_fields;

use super::{SinglePoint, SystemBiases};

/// The last position, where the solution of the next epoch starts, and the differences between the
/// clocks of the constellations, which support epochs of few satellites.
#[derive(Debug)]
pub(crate) struct SinglePoints {
    start: Option<Ecef>,
    biases: SystemBiases,
}

state_fields!(SinglePoints { start, biases });

impl Engine for SinglePoints {
    type Scratch = SinglePoint;

    fn new(_setup: &Setup, _revises: bool) -> Self {
        Self { start: None, biases: SystemBiases::default() }
    }

    fn advance(
        &mut self,
        inputs: &EpochInputs<'_>,
        scratch: &mut SinglePoint,
        _revisions: &mut Vec<Solution>,
    ) -> Solution {
        let solution = scratch.solve_with(inputs, self.start, &mut self.biases);
        self.start = solution.estimate.as_ref().map(|estimate| estimate.position);
        solution
    }
}
