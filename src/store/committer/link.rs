//! The committer's connection to the database.

use std::ptr;
use std::sync::atomic::{AtomicBool, AtomicI32, Ordering};
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use sqlx::{ConnectOptions, Connection, PgConnection};
use tokio::sync::Mutex;
use tokio::time::sleep;
use uuid::Uuid;

use crate::store::StoreError;
use crate::store::database::{Database, POSTGRES_DURABLE};
use crate::store::days::{Days, make_day};
use crate::store::deadline::DEADLINE;
use crate::store::health::{DatabaseSetting, SettingRisk};

use super::heads::{Owner, accepted_postgres};
use super::lease_row::{NEXT_FENCE, OWNER, PROBE};
use super::member::{Member, TAKE_SHARED};
use super::origins::{Origins, origin_keys};
use super::sqlite::SqliteThread;
use super::statements::write_postgres;
use super::{Batch, Connect};

const CONNECTING: &str = "connecting to the database";
/// Interval between checks whether the process of an earlier connection has ended.
const PAUSE: Duration = Duration::from_millis(20);
/// Ends the process of an earlier connection. The row exists until its last transaction has ended.
const END_PROCESS: &str = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity \
    WHERE pid = $1 AND application_name = $2";

/// Memory for the values of a statement. Those of a group are few megabytes; beyond the server's 4
/// MB they would go through a file.
const WHOLE_GROUPS: [(&str, &str); 1] = [("work_mem", "64MB")];
/// Longest idle time in a transaction. If the server has lost contact with a node, the node's
/// transaction must not lock rows that other nodes wait for.
const IDLE_LIMIT: [(&str, &str); 1] = [("idle_in_transaction_session_timeout", "4s")];
/// Takes the lease of the schema, which ends with the connection.
const TAKE_LEASE: &str = "SELECT pg_try_advisory_lock(\
    hashtextextended('graphfix lease ' || current_schema(), 0))";
const HOLDER: &str = "SELECT node FROM committer";
/// Time within which the server ends the connection of a service that has died.
const LEASE_PATIENCE: Duration = Duration::from_secs(3);

/// Opens the committer's connections, one after another.
pub(in crate::store) struct Connector {
    database: Database,
    /// See [`crate::store::pool::Pool::Sqlite`].
    turn: Arc<Mutex<()>>,
    /// Name of the connections on a server. No other process uses it.
    name: String,
    /// Name of the node, if this service takes the lease.
    node: Option<Arc<str>>,
    /// This node of a cluster, whose nodes have the lease together.
    member: Option<Arc<Member>>,
    /// The owner of the commits, set by each connection.
    owner: std::sync::Mutex<Owner>,
    /// Process of the last connection on a server; 0 before the first.
    process: AtomicI32,
    origins: Origins,
    days: Arc<Days>,
}

/// A connection that commits.
pub(in crate::store) enum Link {
    Sqlite(SqliteThread),
    Postgres(PgConnection),
}

impl Connector {
    pub(in crate::store) fn new(
        database: Database,
        turn: Arc<Mutex<()>>,
        node: Option<&str>,
    ) -> Self {
        let name = connection_name(&database);
        let (node, process) = (node.map(Into::into), AtomicI32::new(0));
        let (owner, origins) = (std::sync::Mutex::default(), Origins::default());
        let (member, days) = (None, Arc::default());
        Self { database, turn, name, node, member, owner, process, origins, days }
    }

    /// The same connector, for a node of a cluster.
    pub(in crate::store) fn with_member(self, member: Option<Arc<Member>>) -> Self {
        Self { member, ..self }
    }

    /// The days whose partitions exist.
    pub(in crate::store) fn days(&self) -> Arc<Days> {
        self.days.clone()
    }

    /// The settings of the database on which durability and space depend.
    pub(in crate::store) async fn settings(&self) -> Result<Vec<DatabaseSetting>, StoreError> {
        let link = self.connected().await.map_err(StoreError::database(CONNECTING))?;
        let read = async {
            match link {
                Link::Sqlite(thread) => thread.settings().await,
                Link::Postgres(connection) => postgres_settings(connection).await,
            }
        };
        read.await.map_err(StoreError::database("reading the settings of the database"))
    }

    /// Connects without the lease.
    async fn connected(&self) -> Result<Link, sqlx::Error> {
        match &self.database {
            // The probe waits for the lock of an earlier connection.
            Database::Sqlite(options) => {
                SqliteThread::open(options.get_filename()).await.map(Link::Sqlite)
            }
            Database::Postgres(options) => {
                let options = options.clone().application_name(&self.name);
                let limit = [("statement_timeout", DEADLINE.as_millis())];
                let mut options = options.options(limit).options(WHOLE_GROUPS);
                if self.member.is_some() {
                    options = options.options(IDLE_LIMIT);
                }
                let mut connection: PgConnection = options.connect().await?;
                self.end_last_process(&mut connection).await?;
                sqlx::query(POSTGRES_DURABLE).execute(&mut connection).await?;
                let process = sqlx::query_scalar("SELECT pg_backend_pid()");
                let process: i32 = process.fetch_one(&mut connection).await?;
                self.process.store(process, Ordering::Relaxed);
                Ok(Link::Postgres(connection))
            }
        }
    }

    /// Takes the lease, if this node takes one. Returns the holder's name if another has it.
    async fn wait_for_lease(&self, link: &mut Link) -> Result<Option<String>, sqlx::Error> {
        let (Some(_), Link::Postgres(connection)) = (&self.node, link) else { return Ok(None) };
        let began = Instant::now();
        let take = if self.member.is_some() { TAKE_SHARED } else { TAKE_LEASE };
        while !sqlx::query_scalar(take).fetch_one(&mut *connection).await? {
            if LEASE_PATIENCE < began.elapsed() {
                // Err: the holder has not made the table yet.
                let holder = sqlx::query_scalar(HOLDER).fetch_one(&mut *connection).await;
                return Ok(Some(holder.unwrap_or_else(|_| "a node that starts".to_owned())));
            }
            sleep(PAUSE).await;
        }
        Ok(None)
    }

    /// Becomes the owner of the following commits. At the first connection with a lease it takes
    /// the next fence, so that nothing of an earlier holder can be committed any more.
    ///
    /// Returns the name of another node that had the lease since the last connection. This process
    /// must then not commit again, because its memory may be outdated.
    async fn become_owner(&self, link: &mut Link) -> Result<Option<String>, sqlx::Error> {
        if let (Some(member), Link::Postgres(connection)) = (&self.member, &mut *link) {
            let process = self.process.load(Ordering::Relaxed);
            let in_its_way = member.enter(connection, process).await?;
            let node = self.node.as_deref().unwrap_or_default().to_owned();
            *self.owner.lock().unwrap_or_else(PoisonError::into_inner) =
                Owner { node, fence: member.fence(), claims: true };
            return Ok(in_its_way);
        }
        let own = self.owner.lock().unwrap_or_else(PoisonError::into_inner).fence;
        let node = self.node.as_deref().unwrap_or_default();
        let (holder, stored): (String, i64) = match link {
            Link::Sqlite(thread) => thread.owner().await?,
            Link::Postgres(connection) => sqlx::query_as(OWNER).fetch_one(connection).await?,
        };
        let fence = match (&self.node, own) {
            (Some(_), 0) => self.next_fence(link, node).await?,
            (Some(_), own) if own != stored => return Ok(Some(holder)),
            (None, 0) => stored,
            (_, own) => own,
        };
        *self.owner.lock().unwrap_or_else(PoisonError::into_inner) =
            Owner { node: node.to_owned(), fence, claims: false };
        Ok(None)
    }

    async fn next_fence(&self, link: &mut Link, node: &str) -> Result<i64, sqlx::Error> {
        match link {
            Link::Sqlite(thread) => {
                let _turn = self.turn.lock().await;
                thread.next_fence(node).await
            }
            Link::Postgres(connection) => {
                sqlx::query_scalar(NEXT_FENCE).bind(node).fetch_one(connection).await
            }
        }
    }

    /// Checks that no other service has the lease on a server.
    pub(in crate::store) async fn check_lease(&self) -> Result<(), StoreError> {
        let (Some(_), Database::Postgres(_)) = (&self.node, &self.database) else { return Ok(()) };
        let failed = StoreError::database(CONNECTING);
        let holder = async {
            let mut link = self.connected().await?;
            self.wait_for_lease(&mut link).await
        };
        match holder.await.map_err(failed)? {
            None => Ok(()),
            Some(holder) => Err(StoreError::InUse { holder }),
        }
    }

    /// Waits until the process of the last connection has ended, so that its last transaction is
    /// either committed or not.
    async fn end_last_process(&self, connection: &mut PgConnection) -> Result<(), sqlx::Error> {
        let last = self.process.load(Ordering::Relaxed);
        if last == 0 {
            return Ok(());
        }
        loop {
            let end = sqlx::query(END_PROCESS).bind(last).bind(&self.name);
            if end.fetch_optional(&mut *connection).await?.is_none() {
                return Ok(());
            }
            sleep(PAUSE).await;
        }
    }
}

impl Connector {
    /// Commits batches in one transaction, and returns the indices of those that it left out.
    async fn write_postgres(
        &self,
        connection: &mut PgConnection,
        batches: &[&Batch],
        owner: &Owner,
        committing: &AtomicBool,
    ) -> Result<Vec<usize>, sqlx::Error> {
        let mut transaction = connection.begin().await?;
        let renewed = match &self.member {
            None => None,
            Some(member) => member.confirm(&mut transaction).await?,
        };
        let accepted = accepted_postgres(&mut transaction, batches, owner).await?;
        let keys = origin_keys(&self.origins, &mut transaction, &accepted).await?;
        let days = self.days.unknown(accepted.iter().filter_map(|b| b.partition()));
        for day in &days {
            make_day(&mut transaction, *day).await?;
        }
        write_postgres(&mut transaction, &accepted, &keys).await?;
        committing.store(true, Ordering::Relaxed);
        transaction.commit().await?;
        if let Some(member) = &self.member {
            renewed.into_iter().for_each(|renewed| member.note_renewed(renewed));
            member.check()?;
        }
        self.days.learn(days);
        self.origins.learn(keys);
        let is_left_out = |index: &usize| !accepted.iter().any(|a| ptr::eq(*a, batches[*index]));
        match accepted.len() == batches.len() {
            true => Ok(Vec::new()),
            false => Ok((0..batches.len()).filter(is_left_out).collect()),
        }
    }
}

impl Connect for Connector {
    type Link = Link;

    async fn connect(&self) -> Result<Link, StoreError> {
        let failed = StoreError::database(CONNECTING);
        self.days.forget(); // Perhaps a partition is missing.
        let connect = async {
            let mut link = self.connected().await?;
            if let Some(holder) = self.wait_for_lease(&mut link).await? {
                return Ok(Err(StoreError::InUse { holder }));
            }
            let is_first = self.member.as_ref().is_some_and(|member| member.fence() == 0);
            Ok(match self.become_owner(&mut link).await? {
                None => Ok(link),
                Some(holder) if is_first => Err(StoreError::InUse { holder }),
                Some(holder) => Err(StoreError::LeaseLost { holder }),
            })
        };
        connect.await.map_err(failed)?
    }

    async fn probe(&self, link: &mut Link, after_failure: bool) -> Result<(), sqlx::Error> {
        match link {
            Link::Sqlite(thread) => {
                let _turn = self.turn.lock().await;
                thread.probe(after_failure).await
            }
            Link::Postgres(connection) if after_failure => {
                let mut transaction = connection.begin().await?;
                sqlx::query(PROBE).execute(&mut *transaction).await?;
                transaction.commit().await
            }
            Link::Postgres(connection) => match &self.member {
                None => sqlx::query("SELECT 1").execute(connection).await.map(drop),
                Some(member) => {
                    if let Some(renewed) = member.confirm(connection).await? {
                        member.note_renewed(renewed);
                    }
                    Ok(())
                }
            },
        }
    }

    async fn write(
        &self,
        link: &mut Link,
        batches: &[Arc<Batch>],
        committing: &AtomicBool,
    ) -> Result<Vec<usize>, sqlx::Error> {
        let owner = self.owner.lock().unwrap_or_else(PoisonError::into_inner).clone();
        match link {
            Link::Sqlite(thread) => {
                let _turn = self.turn.lock().await;
                thread.write(batches, owner, committing).await
            }
            Link::Postgres(connection) => {
                let batches: Vec<&Batch> = batches.iter().map(|batch| &**batch).collect();
                self.write_postgres(connection, &batches, &owner, committing).await
            }
        }
    }
}

/// A name of at most 63 bytes for the committer's connections. No other process has it.
fn connection_name(database: &Database) -> String {
    let named = match database {
        Database::Postgres(options) => options.get_application_name(),
        Database::Sqlite(_) => None,
    };
    let mark = Uuid::new_v4().simple().to_string();
    let named: String = named.unwrap_or("graphfix").chars().take(30).collect();
    format!("{named} committer {}", &mark[..12])
}

async fn postgres_settings(
    mut connection: PgConnection,
) -> Result<Vec<DatabaseSetting>, sqlx::Error> {
    let mut settings = Vec::new();
    let of_durability = ["synchronous_commit", "fsync", "full_page_writes"];
    let named = of_durability.map(|name| (name, SettingRisk::PowerFailure));
    for (name, risk) in named.into_iter().chain([("autovacuum", SettingRisk::Growth)]) {
        let value = sqlx::query_scalar("SELECT current_setting($1)").bind(name);
        let value: String = value.fetch_one(&mut connection).await?;
        settings.push(DatabaseSetting { name, risk: (value == "off").then_some(risk), value });
    }
    Ok(settings)
}
