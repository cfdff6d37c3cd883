//! What the desk for the cluster counts.

use crate::meters::{Counter, Gauge};

/// Counters and gauges of a node.
#[derive(Clone, Debug, Default)]
pub(crate) struct ClusterMeters {
    /// Nodes that are alive.
    pub(crate) nodes: Gauge,
    /// 1 while this node leads.
    pub(crate) leads: Gauge,
    /// Leases of other nodes that this one has ended.
    pub(crate) ended_leases: Counter,
    /// Requests that this node has sent on to another.
    pub(crate) forwarded: Counter,
    /// Of these, those that the other node has not answered.
    pub(crate) unanswered: Counter,
}
