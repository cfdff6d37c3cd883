//! Meters of the desk for the cluster.

use crate::meters::{Counter, Gauge};

/// Counters and gauges of a node.
#[derive(Clone, Debug, Default)]
pub(crate) struct ClusterMeters {
    /// Nodes that are alive.
    pub(crate) nodes: Gauge,
    /// 1 while this node leads.
    pub(crate) is_leader: Gauge,
    /// Leases of other nodes that this one has ended.
    pub(crate) ended_leases: Counter,
    /// Requests that this node has forwarded to another.
    pub(crate) forwarded: Counter,
    /// Forwarded requests that the other node has not answered.
    pub(crate) unanswered: Counter,
}
