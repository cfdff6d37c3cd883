//! The record of an epoch that may be revised.

use crate::gnss::Solution;
use crate::positioning::rtk::observed::ArcReference;
use crate::snapshot::snapshot_fields;

/// An epoch with its latest answer.
#[derive(Clone, Debug)]
pub(crate) struct EpochRecord {
    pub(crate) solution: Solution,
    /// Whether it is or was a state of the graph.
    pub(crate) is_in_graph: bool,
    /// Period in which its integers were held.
    pub(crate) period: u32,
    /// The arcs it used whose ambiguities may be integers.
    pub(crate) arcs: Vec<ArcReference>,
}

snapshot_fields!(EpochRecord { solution, is_in_graph, period, arcs });
