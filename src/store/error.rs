//! Why the store refuses or fails.

use std::sync::Arc;

use crate::refusal::Code;
use crate::secrets::SecretsError;

use super::codec::CodecError;

/// Why the store refuses or fails. Each batch of a failed transaction gets a copy.
#[derive(Clone, Debug, thiserror::Error)]
pub enum StoreError {
    /// The URL is not of a supported database. It is not repeated, because it may contain a
    /// password.
    #[error("database URL: {why}")]
    Url {
        /// What is wrong with it.
        why: String,
    },
    /// A newer Graphfix wrote the database.
    #[error("the database has schema {found}, this Graphfix knows schemas up to {known}")]
    NewerSchema {
        /// Version of the database's schema.
        found: i64,
        /// The newest version that this Graphfix knows.
        known: i64,
    },
    /// An older Graphfix wrote the database, and it is opened for reading only.
    #[error("the database has schema {found}, and this Graphfix reads schema {known}")]
    OlderSchema {
        /// Version of the database's schema.
        found: i64,
        /// The version that this Graphfix reads.
        known: i64,
    },
    /// Another service has the lease of the database.
    #[error("another service uses the database: {holder}")]
    InUse {
        /// The name of its node.
        holder: String,
    },
    /// Another service had the lease of the database meanwhile.
    #[error(
        "another service had the database meanwhile, so this one may know less than is stored and \
         must start again: {holder}"
    )]
    LeaseLost {
        /// The name of its node.
        holder: String,
    },
    /// The lease of the database cannot be taken.
    #[error("the lock file of the database: {why}")]
    Lease {
        /// What is wrong with the lock file.
        why: String,
    },
    /// Nodes of a cluster need a database on Postgres.
    #[error("the nodes of a cluster share a database on Postgres, and this one is a file")]
    ClusterOfFile,
    /// The session belongs to another node.
    #[error("the session is of node {node}")]
    Elsewhere {
        /// Name of that node.
        node: String,
    },
    /// The schema could not be brought up to date.
    #[error("migrating the database: {source}")]
    Migration {
        /// Message of the database.
        source: Arc<sqlx::migrate::MigrateError>,
    },
    /// The database failed.
    #[error("{operation}: {source}")]
    Database {
        /// The operation that failed.
        operation: &'static str,
        /// Message of the database.
        source: Arc<sqlx::Error>,
    },
    /// The database failed while it confirmed a commit, so the changes may be stored or not.
    #[error("committing epochs and solutions was not confirmed: {source}")]
    Unconfirmed {
        /// Message of the database.
        source: Arc<sqlx::Error>,
    },
    /// The database has failed, and has not answered since. Nothing was tried.
    #[error("the database does not answer: {why}")]
    Down {
        /// Message of the failure.
        why: Arc<str>,
    },
    /// Another writer stored an epoch or solution under this number.
    #[error("an epoch of this batch is already stored by another writer")]
    AlreadyStored,
    /// A stored row cannot be decoded.
    #[error("a stored {what} cannot be read: {source}")]
    Corrupt {
        /// Kind of the row.
        what: &'static str,
        /// Error of the decoder.
        source: CodecError,
    },
    /// A stored text cannot be decoded.
    #[error("a stored {what} cannot be read: {why}")]
    CorruptText {
        /// Kind of the text.
        what: &'static str,
        /// What is wrong with it.
        why: String,
    },
    /// Navigation data of this push are no longer stored.
    #[error(
        "navigation data of push {push} are no longer stored; they are complete from push \
         {complete_since} on"
    )]
    NavigationForgotten {
        /// Number of the push.
        push: u64,
        /// Number of the first push whose navigation data are complete.
        complete_since: u64,
    },
    /// Epochs of a base, or the base itself, are no longer stored.
    #[error("epochs of base {base} that a solution depends on are no longer stored")]
    BaseForgotten {
        /// Primary key of the base.
        base: i64,
    },
    /// Another node leads the cluster.
    #[error("another node leads the cluster, and only the leader writes to bases")]
    NotLeader,
    /// A base that a session is to use has been deleted meanwhile.
    #[error("there is no base {id:?}")]
    BaseDeleted {
        /// Id of the base.
        id: Arc<str>,
    },
    /// A stored secret cannot be read.
    #[error(transparent)]
    Secrets(#[from] SecretsError),
    /// The page token does not come from an answer to this call.
    #[error("{token:?} is not a page token of this list")]
    PageToken {
        /// The token as given.
        token: String,
    },
    /// The page size is out of range.
    #[error("a page of {size} is not from 1 to {limit}")]
    PageSize {
        /// The size as given.
        size: usize,
        /// The largest size allowed.
        limit: usize,
    },
    /// The store is closed.
    #[error("the store is closed")]
    Closed,
}

impl StoreError {
    pub(super) fn database(operation: &'static str) -> impl FnOnce(sqlx::Error) -> Self {
        move |source| Self::Database { operation, source: Arc::new(source) }
    }

    pub(super) fn corrupt(what: &'static str) -> impl FnOnce(CodecError) -> Self {
        move |source| Self::Corrupt { what, source }
    }

    /// The stable code.
    pub const fn code(&self) -> Code {
        match self {
            Self::Url { .. } => Code::DatabaseUrlInvalid,
            Self::NewerSchema { .. } => Code::DatabaseSchemaNewer,
            Self::OlderSchema { .. } => Code::DatabaseSchemaOlder,
            Self::InUse { .. } => Code::DatabaseInUse,
            Self::LeaseLost { .. } => Code::LeaseLost,
            Self::ClusterOfFile => Code::ClusterNeedsPostgres,
            Self::Elsewhere { .. } => Code::SessionElsewhere,
            Self::Migration { .. } => Code::DatabaseMigrationFailed,
            Self::Database { .. }
            | Self::Unconfirmed { .. }
            | Self::Down { .. }
            | Self::Lease { .. } => Code::DatabaseFailed,
            Self::AlreadyStored | Self::NotLeader => Code::WrittenElsewhere,
            Self::Corrupt { .. } | Self::CorruptText { .. } => Code::StoredDataCorrupt,
            Self::NavigationForgotten { .. } => Code::NavigationForgotten,
            Self::BaseForgotten { .. } => Code::BaseForgotten,
            Self::BaseDeleted { .. } => Code::BaseNotFound,
            Self::Secrets(error) => error.code(),
            Self::PageToken { .. } => Code::PageTokenInvalid,
            Self::PageSize { .. } => Code::PageSizeInvalid,
            Self::Closed => Code::Draining,
        }
    }
}
