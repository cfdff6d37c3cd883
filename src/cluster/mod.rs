//! The cluster as a node sees it: which nodes are alive, which leads, and what the others change.
//!
//! Several nodes share a database on Postgres. A session belongs to one of them. Data that must
//! have one writer, such as the bases, are written by the leader. The rules are in the store
//! (`store::nodes`). Each second this desk reads the nodes, ends the leases of nodes that no longer
//! renew them, and takes the lead if the leader is not alive. It also reads what other nodes have
//! stored. The correctness of commits does not depend on how often it does this.

mod following;
mod meters;

use std::mem;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::sleep;

use crate::aiding::{AidingDesk, AidingError};
use crate::store::{CommitterState, NODE_LEASE, NodeRow, Store, StoreError};

pub(crate) use meters::ClusterMeters;

/// Interval at which the nodes are read from the store.
const INTERVAL: Duration = Duration::from_secs(1);

/// The nodes that are alive.
#[derive(Clone, Debug, Default)]
struct Members {
    nodes: Vec<NodeRow>,
    /// Fence of the leader, alive or not.
    leader: i64,
}

/// The desk for the cluster. All clones share it.
#[derive(Clone)]
pub struct Cluster(Arc<Desk>);

struct Desk {
    store: Store,
    own: i64,
    members: watch::Sender<Members>,
    is_leader: watch::Sender<bool>,
    meters: ClusterMeters,
    tasks: Mutex<JoinSet<()>>,
}

impl Cluster {
    /// Opens the desk of a node; `None` for a service without a cluster. When it returns, the first
    /// node of a cluster leads.
    ///
    /// # Errors
    /// The store fails.
    pub async fn open(store: &Store, aiding: &AidingDesk) -> Result<Option<Self>, AidingError> {
        let Some(own) = store.fence() else { return Ok(None) };
        let desk = Arc::new(Desk {
            store: store.clone(),
            own,
            members: watch::Sender::default(),
            is_leader: watch::Sender::new(false),
            meters: ClusterMeters::default(),
            tasks: Mutex::default(),
        });
        desk.look(aiding, false).await?;
        let mut tasks = JoinSet::new();
        tasks.spawn(look_each_second(desk.clone(), aiding.clone()));
        tasks.spawn(following::follow(store.clone(), aiding.clone()));
        *desk.tasks.lock().unwrap_or_else(PoisonError::into_inner) = tasks;
        Ok(Some(Self(desk)))
    }

    /// Whether this node leads.
    pub(crate) fn is_leader(&self) -> bool {
        *self.0.is_leader.borrow()
    }

    /// Waits until this node leads. It then leads until it ends.
    pub(crate) async fn until_leader(&self) {
        // Err: the desk no longer exists.
        self.0.is_leader.subscribe().wait_for(|is_leader| *is_leader).await.ok();
    }

    /// The leader, if it is alive.
    pub(crate) fn leader(&self) -> Option<NodeRow> {
        let members = self.0.members.borrow();
        members.nodes.iter().find(|node| node.fence == members.leader).cloned()
    }

    /// The live nodes.
    pub(crate) fn nodes(&self) -> Vec<NodeRow> {
        self.0.members.borrow().nodes.clone()
    }

    /// The live node with this fence, if it is another node.
    pub(crate) fn other(&self, fence: i64) -> Option<NodeRow> {
        let members = self.0.members.borrow();
        let is_it = |node: &&NodeRow| node.fence == fence && fence != self.0.own;
        members.nodes.iter().find(is_it).cloned()
    }

    /// The other node to which a session belongs, if one is alive.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn owner(&self, session: &str) -> Result<Option<NodeRow>, StoreError> {
        let owner = self.0.store.owner_of_session(session).await?;
        let Some(fence) = owner.filter(|fence| *fence != self.0.own) else { return Ok(None) };
        if self.other(fence).is_none() {
            // The owner may have started since the last read.
            let members = self.0.read().await?;
            self.0.members.send_replace(members);
        }
        Ok(self.other(fence))
    }

    /// This node, as the others know it.
    pub(crate) fn own(&self) -> Option<NodeRow> {
        self.0.members.borrow().nodes.iter().find(|node| node.fence == self.0.own).cloned()
    }

    /// Whether a request comes from another live node: `secret` must be that node's secret.
    pub(crate) fn is_of_node(&self, fence: i64, secret: &str) -> bool {
        self.other(fence).is_some_and(|node| is_same(node.secret.as_bytes(), secret.as_bytes()))
    }

    /// Waits until a node is no longer alive.
    pub(crate) async fn wait_for_end(&self, fence: i64) {
        let mut members = self.0.members.subscribe();
        let is_gone = |members: &Members| !members.nodes.iter().any(|node| node.fence == fence);
        // Err: the desk no longer exists.
        members.wait_for(is_gone).await.ok();
    }

    /// Meters of this desk.
    pub(crate) fn meters(&self) -> &ClusterMeters {
        &self.0.meters
    }

    /// Runs a task until the desk is closed.
    pub(crate) fn run(&self, task: impl Future<Output = ()> + Send + 'static) {
        self.0.tasks.lock().unwrap_or_else(PoisonError::into_inner).spawn(task);
    }

    /// Ends the tasks.
    pub(crate) async fn close(&self) {
        let mut tasks =
            mem::take(&mut *self.0.tasks.lock().unwrap_or_else(PoisonError::into_inner));
        tasks.shutdown().await;
    }
}

/// Compares secrets in a time that does not depend on their content.
fn is_same(one: &[u8], other: &[u8]) -> bool {
    let differs = |(one, other): (&u8, &u8)| one ^ other;
    one.len() == other.len() && one.iter().zip(other).map(differs).fold(0, |all, d| all | d) == 0
}

async fn look_each_second(desk: Arc<Desk>, aiding: AidingDesk) {
    let mut since = Instant::now();
    loop {
        sleep(INTERVAL).await;
        if desk.store.committer_health().state != CommitterState::Working {
            since = Instant::now();
        }
        // After an outage of the database each node has time to renew its lease.
        let ends = NODE_LEASE < since.elapsed();
        if let Err(error) = desk.look(&aiding, ends).await {
            since = Instant::now();
            tracing::warn!(%error, "the nodes of the cluster are not known");
        }
    }
}

impl Desk {
    /// Reads which nodes are alive and which one leads. With `ends`, it first ends the leases of
    /// other nodes that have expired. Afterwards it takes the lead from a node that is not alive.
    async fn look(&self, aiding: &AidingDesk, ends: bool) -> Result<(), AidingError> {
        if ends {
            for node in self.store.end_leases().await? {
                self.meters.ended_leases.inc();
                tracing::warn!(node, "another node has not renewed its lease; it is ended");
            }
        }
        let mut members = self.read().await?;
        let is_alive = |fence| members.nodes.iter().any(|node| node.fence == fence);
        if !is_alive(members.leader) && self.store.take_lead(members.leader).await? {
            members = self.read().await?;
        }
        if members.leader == self.own && !self.store.is_leader() {
            // Everything that the former leader has stored must be known first.
            aiding.follow().await?;
            aiding.calibrate_bases().await?;
            self.store.become_leader();
            self.is_leader.send_replace(true);
            tracing::info!(node = self.store.node(), "this node leads the cluster");
        }
        self.meters.nodes.set(members.nodes.len() as i64);
        self.meters.is_leader.set(i64::from(self.store.is_leader()));
        self.members.send_replace(members);
        Ok(())
    }

    async fn read(&self) -> Result<Members, StoreError> {
        let (nodes, leader) = self.store.nodes().await?;
        Ok(Members { nodes, leader })
    }
}
