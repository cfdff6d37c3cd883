//! The other nodes of a cluster.

use crate::cluster::Cluster;
pub(crate) use crate::store::NodeRow as OtherNode;
use crate::tls::ClientTls;

/// The cluster, and the client that reaches its nodes.
#[derive(Clone)]
pub(crate) struct Nodes {
    pub(crate) cluster: Cluster,
    pub(crate) tls: ClientTls,
}
