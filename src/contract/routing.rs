//! Which node of a cluster answers a request.
//!
//! A call that writes to a session belongs to the node that owns the session. A call that writes
//! bases or navigation data, or asks for the health of their sources, belongs to the leader. Every
//! node answers all other calls.

use crate::cluster::Cluster;
use crate::refusal::Code;
use crate::session::{SessionError, SessionId};
use crate::store::NodeRow;

use super::access::{Call, Credential, Pass};
use super::nodes::Nodes;
use super::{Refusal, Service};

/// Calls of the node that owns the session, by their paths on gRPC.
const OF_OWNER: [&str; 8] = [
    "Sessions/Update",
    "Sessions/Reset",
    "Sessions/Close",
    "Sessions/Delete",
    "Positioning/PushEpochs",
    "Positioning/PushRaw",
    "Positioning/Stream",
    "Positioning/StreamRaw",
];
/// Services whose calls all belong to the leader.
const OF_LEADER: [&str; 2] = ["Bases/", "Navigation/"];
/// Calls that may name a base that the leader has just created.
const NAMES_BASES: [&str; 2] = ["Sessions/Create", "Sessions/Update"];

impl Service {
    /// The other node that must answer a request; `None` if this one answers it. `session` is the
    /// id in the request.
    ///
    /// # Errors
    /// The database fails, or the cluster has no leader now.
    pub(crate) async fn node_for(
        &self,
        call: &Call,
        session: Option<&str>,
    ) -> Result<Option<NodeRow>, Refusal> {
        let Some(Nodes { cluster, .. }) = self.nodes() else { return Ok(None) };
        if NAMES_BASES.contains(&call.grpc) {
            self.bases().follow().await?;
        }
        if OF_LEADER.iter().any(|service| call.grpc.starts_with(service)) {
            return leader(cluster);
        }
        let id = session.and_then(SessionId::parse).filter(|_| OF_OWNER.contains(&call.grpc));
        match id {
            // If the task of the session runs here, this node owns it; no question to the database.
            Some(id) if !self.sessions().runs(&id) => {
                let owner = cluster.owner(id.as_str()).await;
                owner.map_err(|error| SessionError::from(error).into())
            }
            _ => Ok(None),
        }
    }

    /// Gives up the session of a request that another node has forwarded, so that the session moves
    /// to the node at which the device's requests arrive. Returns whether it was given up.
    ///
    /// # Errors
    /// There is no such session, or the database fails.
    pub(crate) async fn give_up(
        &self,
        call: &Call,
        session: Option<&str>,
        pass: Option<&Pass>,
    ) -> Result<bool, Refusal> {
        let is_push = call.grpc.starts_with("Positioning/") && OF_OWNER.contains(&call.grpc);
        match session.and_then(SessionId::parse).filter(|_| is_push).zip(pass) {
            Some((id, pass)) => Ok(self.sessions().of(pass.tenant()).give_up(&id).await?),
            None => Ok(false),
        }
    }

    /// Whether a request has a key, the id of a key (`forwarded`) or a sign-in that is not known
    /// here, because the command line or another node may have made it just now.
    pub(crate) fn may_be_new(&self, credential: Credential<'_>, forwarded: Option<&str>) -> bool {
        let (keys, is_of_cluster) = (self.keys(), self.nodes().is_some());
        match (credential, forwarded) {
            (_, Some(key)) => is_of_cluster && !key.is_empty() && !keys.has_id(key),
            (Credential::Key(key), None) => keys.are_needed() && keys.known(key).is_none(),
            (Credential::Cookie(cookie, _), None) => {
                is_of_cluster && keys.signed_in(cookie).is_none()
            }
            (Credential::None, None) => false,
        }
    }

    /// Reads the keys and sign-ins that others have made or ended until now.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn catch_up(&self) -> Result<(), Refusal> {
        Ok(self.keys().catch_up().await?)
    }

    /// The sender of a request that another node has checked and forwarded with the id of the
    /// sender's key; the id is empty if no key was needed.
    ///
    /// # Errors
    /// No key in force has this id here.
    pub(crate) fn pass_of(&self, key: &str) -> Result<Pass, Refusal> {
        Ok(self.keys().admit_by_id(key)?)
    }

    /// Whether the live node with this fence has this secret.
    pub(crate) fn is_of_node(&self, fence: i64, secret: &str) -> bool {
        self.nodes().is_some_and(|nodes| nodes.cluster.is_of_node(fence, secret))
    }
}

/// The leader, if it is another node.
fn leader(cluster: &Cluster) -> Result<Option<NodeRow>, Refusal> {
    if cluster.is_leader() {
        return Ok(None);
    }
    let leader = cluster.leader().and_then(|leader| cluster.other(leader.fence));
    let none = || Refusal::new(Code::NodeUnreachable, "no node leads the cluster at the moment");
    leader.map(Some).ok_or_else(none)
}
