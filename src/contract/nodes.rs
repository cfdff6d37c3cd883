//! The other nodes of a cluster.

use crate::cluster::Cluster;
pub(crate) use crate::store::NodeRow as OtherNode;
use crate::tls::ClientTls;

/// The cluster, and how its nodes are reached.
#[derive(Clone)]
pub(crate) struct Nodes {
    pub(crate) cluster: Cluster,
    pub(crate) tls: ClientTls,
}
