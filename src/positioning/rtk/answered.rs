//! What is kept of an epoch until its last answer.

use crate::gnss::Solution;
use crate::positioning::differencing::DifferenceGroup;
use crate::snapshot::snapshot_fields;

/// An epoch with its answer so far.
#[derive(Clone, Debug)]
pub(super) struct Answered {
    pub(super) solution: Solution,
    /// Whether it is or was a state of the graph.
    pub(super) is_in_graph: bool,
    /// Era of its integers.
    pub(super) era: u32,
    /// Arcs it named whose ambiguities may be integers.
    pub(super) named: Vec<Named>,
}

/// An arc as an epoch named it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Named {
    pub(super) serial: u64,
    /// Border variable then.
    pub(super) variable: usize,
    pub(super) group: DifferenceGroup,
}

snapshot_fields!(Named { serial, variable, group });
snapshot_fields!(Answered { solution, is_in_graph, era, named });
