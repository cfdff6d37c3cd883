//! The nodes of a cluster on one Postgres: which are alive, which one leads, who owns a session.
//!
//! A session belongs to the node whose fence is in its head, while `nodes` has that fence. A node
//! claims a session that belongs to no live node. From then on the former owner can commit nothing
//! to it. This module removes a lease that has ended, and ends the connection that committed under
//! it, so that no open transaction of that node locks a row.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use sqlx::PgPool;
use sqlx::postgres::PgListener;

use super::committer::{LEASE, Member};
use super::deadline::{DEADLINE, within};
use super::notices::Notices;
use super::pool::Pool;
use super::{SessionKey, Store, StoreError};

/// How long a lease lasts after it was renewed.
pub(crate) const NODE_LEASE: Duration = LEASE;

const ALIVE: &str = "SELECT fence, name, address, secret FROM nodes ORDER BY name";
const LEADER: &str = "SELECT fence FROM leader";
/// A statement that has waited for the lock of a row reads the row again before it decides.
const END_LEASES: &str = "DELETE FROM nodes WHERE fence <> $1 AND expires_at < clock_timestamp() \
    RETURNING name, process";
/// Ends a server process, if it still belongs to a committer.
const END_PROCESS: &str = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity \
    WHERE pid = $1 AND datname = current_database() AND application_name LIKE '% committer %'";
const LEAD: &str = "UPDATE leader SET fence = $1 WHERE fence = $2 \
    AND NOT EXISTS (SELECT 1 FROM nodes WHERE nodes.fence = $2) \
    AND EXISTS (SELECT 1 FROM nodes WHERE nodes.fence = $1)";
const LEAVE: &str = "DELETE FROM nodes WHERE fence = $1";
const OWNER: &str = "SELECT h.fence, n.name FROM session_heads h \
    LEFT JOIN nodes n ON n.fence = h.fence WHERE h.session = $1";
const OWNER_BY_ID: &str = "SELECT h.fence FROM sessions s \
    JOIN session_heads h ON h.session = s.key WHERE s.id = $1";
/// Claims a session that belongs to no live node, if its fence is still the one that was read.
const CLAIM: &str = "UPDATE session_heads SET owner = $1, fence = $2 \
    WHERE session = $3 AND fence = $4 \
    AND NOT EXISTS (SELECT 1 FROM nodes WHERE nodes.fence = $4) \
    AND EXISTS (SELECT 1 FROM nodes WHERE nodes.fence = $2)";
const RELEASE: &str = "UPDATE session_heads SET fence = 0 WHERE session = $1 AND fence = $2";
const SET_JOB_FOLDER: &str = "UPDATE nodes SET job_folder = $1 WHERE fence = $2";
const WITH_JOBS: &str = "SELECT fence, name, address, secret FROM nodes \
    WHERE fence <> $1 AND job_folder IS NOT NULL ORDER BY name";
const CLAIMING: &str = "claiming a session";
const READING: &str = "reading the nodes of the cluster";

/// A node that is alive.
#[derive(Clone, Debug, PartialEq, Eq, sqlx::FromRow)]
pub struct NodeRow {
    /// The number of its lease. No other lease ever has this number.
    pub fence: i64,
    /// Its name.
    pub name: String,
    /// Where other nodes reach it.
    pub address: String,
    /// Proves to other nodes that a request comes from this node.
    pub secret: String,
}

/// Result of a successful claim of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Claim {
    /// It already belonged to this node.
    Own,
    /// It belongs to this node from now on. Anything in memory about it is outdated.
    Taken,
}

impl Store {
    /// The number of this node's lease; `None` without a cluster.
    pub(crate) fn fence(&self) -> Option<i64> {
        self.member.as_deref().map(Member::fence)
    }

    /// Whether this service does the writes of a leader: it leads, or there is no cluster.
    pub(crate) fn is_leader(&self) -> bool {
        self.member.as_deref().is_none_or(|member| member.is_leader.load(Ordering::Acquire))
    }

    /// Makes this node the leader, as far as the process knows.
    pub(crate) fn become_leader(&self) {
        if let Some(member) = &self.member {
            member.is_leader.store(true, Ordering::Release);
        }
    }

    /// Whether other nodes may write to the same database.
    pub(crate) fn is_of_cluster(&self) -> bool {
        self.cluster().is_some()
    }

    /// The member's pool; `None` without a cluster.
    fn cluster(&self) -> Option<(&PgPool, &Arc<Member>)> {
        match (&self.pool, &self.member) {
            (Pool::Postgres { pool, .. }, Some(member)) => Some((pool, member)),
            _ => None,
        }
    }

    /// The nodes that are alive, in order of their names, and the fence of the leader.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn nodes(&self) -> Result<(Vec<NodeRow>, i64), StoreError> {
        let Some((pool, _)) = self.cluster() else { return Ok((Vec::new(), 0)) };
        let nodes = within(DEADLINE, sqlx::query_as(ALIVE).fetch_all(pool)).await;
        let leader = within(DEADLINE, sqlx::query_scalar(LEADER).fetch_one(pool)).await;
        let failed = || StoreError::database(READING);
        Ok((nodes.map_err(failed())?, leader.map_err(failed())?))
    }

    /// Removes the nodes whose lease has ended, and ends their committers' connections. Returns
    /// their names.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn end_leases(&self) -> Result<Vec<String>, StoreError> {
        let Some((pool, member)) = self.cluster() else { return Ok(Vec::new()) };
        let ending = async {
            // One transaction: if a process cannot be ended, its node is still there to be tried
            // again.
            let mut transaction = pool.begin().await?;
            let end = sqlx::query_as(END_LEASES).bind(member.fence());
            let ended: Vec<(String, i32)> = end.fetch_all(&mut *transaction).await?;
            for (_, process) in &ended {
                sqlx::query(END_PROCESS).bind(process).execute(&mut *transaction).await?;
            }
            transaction.commit().await?;
            Ok(ended.into_iter().map(|(name, _)| name).collect())
        };
        let ended = within(DEADLINE, ending).await;
        ended.map_err(StoreError::database("ending the leases of other nodes"))
    }

    /// Takes the lead from the node with the fence `former`, if that node is not alive. Returns
    /// whether it has taken it.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn take_lead(&self, former: i64) -> Result<bool, StoreError> {
        let Some((pool, member)) = self.cluster() else { return Ok(false) };
        let lead = sqlx::query(LEAD).bind(member.fence()).bind(former).execute(pool);
        let taken = within(DEADLINE, lead).await;
        Ok(taken.map_err(StoreError::database("taking the lead"))?.rows_affected() == 1)
    }

    /// Stores which folder of jobs this node has, by its identity, or that it has none. Returns the
    /// other live nodes that have a folder; without a cluster the list is empty.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn note_job_folder(
        &self,
        id: Option<&str>,
    ) -> Result<Vec<NodeRow>, StoreError> {
        let Some((pool, member)) = self.cluster() else { return Ok(Vec::new()) };
        let noting = async {
            let set = sqlx::query(SET_JOB_FOLDER).bind(id).bind(member.fence());
            set.execute(pool).await?;
            sqlx::query_as(WITH_JOBS).bind(member.fence()).fetch_all(pool).await
        };
        let noted = within(DEADLINE, noting).await;
        noted.map_err(StoreError::database("noting which folder of jobs a node has"))
    }

    /// Removes this node, after its last commit.
    pub(super) async fn leave(&self) {
        let Some((pool, member)) = self.cluster() else { return };
        let leave = sqlx::query(LEAVE).bind(member.fence()).execute(pool);
        if let Err(error) = within(DEADLINE, leave).await {
            tracing::warn!(%error, "the lease of this node ends by its time");
        }
    }

    /// Claims a session for this node, if it belongs to no other live node.
    ///
    /// # Errors
    /// It belongs to another node, or the database fails.
    pub(crate) async fn claim(&self, session: SessionKey) -> Result<Claim, StoreError> {
        let Some((pool, member)) = self.cluster() else { return Ok(Claim::Own) };
        let failed = || StoreError::database(CLAIMING);
        let owner = sqlx::query_as(OWNER).bind(session.0).fetch_one(pool);
        let owner: (i64, Option<String>) = within(DEADLINE, owner).await.map_err(failed())?;
        let own = member.fence();
        let elsewhere = |node: Option<String>| StoreError::Elsewhere {
            node: node.unwrap_or_else(|| "that claims it now".to_owned()),
        };
        match owner {
            (fence, Some(_)) if fence == own => Ok(Claim::Own),
            (_, Some(node)) => Err(elsewhere(Some(node))),
            (former, None) => {
                let claim = sqlx::query(CLAIM).bind(self.node()).bind(own);
                let claim = claim.bind(session.0).bind(former).execute(pool);
                match within(DEADLINE, claim).await.map_err(failed())?.rows_affected() {
                    1 => Ok(Claim::Taken),
                    _ => Err(elsewhere(None)),
                }
            }
        }
    }

    /// Gives up a session of this node, after its last commit.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn release(&self, session: SessionKey) -> Result<(), StoreError> {
        let Some((pool, member)) = self.cluster() else { return Ok(()) };
        let release = sqlx::query(RELEASE).bind(session.0).bind(member.fence()).execute(pool);
        let released = within(DEADLINE, release).await;
        released.map(drop).map_err(StoreError::database("giving up a session"))
    }

    /// The fence of the last owner of the session with this id; `None` if nobody has owned it.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn owner_of_session(&self, id: &str) -> Result<Option<i64>, StoreError> {
        let Some((pool, _)) = self.cluster() else { return Ok(None) };
        let owner = sqlx::query_scalar(OWNER_BY_ID).bind(id).fetch_optional(pool);
        within(DEADLINE, owner)
            .await
            .map_err(StoreError::database("reading the owner of a session"))
    }

    /// Notices of the changes that other nodes make from now on; `None` without a cluster.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn notices(&self) -> Result<Option<Notices>, StoreError> {
        let Some((pool, _)) = self.cluster() else { return Ok(None) };
        let listening = async {
            let schema: String =
                sqlx::query_scalar("SELECT current_schema()").fetch_one(pool).await?;
            let mut listener = PgListener::connect_with(pool).await?;
            listener.listen(&format!("graphfix_{schema}")).await?;
            Ok(Notices::of(listener))
        };
        let listening = within(DEADLINE, listening).await;
        listening.map(Some).map_err(StoreError::database("listening to other nodes"))
    }
}
