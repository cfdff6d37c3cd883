//! Why the store refuses or fails.

use std::sync::Arc;

use crate::refusal::Code;

use super::codec::CodecError;

/// Why the store refuses or fails. Cloned to every batch of a transaction that failed.
#[derive(Clone, Debug, thiserror::Error)]
pub enum StoreError {
    /// The URL names no database that Graphfix knows. The URL itself may hold a password and is
    /// not repeated.
    #[error("database URL: {why}")]
    Url {
        /// What is wrong with it.
        why: String,
    },
    /// The database has a schema from a newer Graphfix.
    #[error("the database has schema {found}, this Graphfix knows schemas up to {known}")]
    NewerSchema {
        /// The database's schema.
        found: i64,
        /// The newest schema known here.
        known: i64,
    },
    /// The schema could not be brought up to date.
    #[error("migrating the database: {source}")]
    Migration {
        /// What the database said.
        source: Arc<sqlx::migrate::MigrateError>,
    },
    /// The database failed.
    #[error("{operation}: {source}")]
    Database {
        /// What was being done.
        operation: &'static str,
        /// What the database said.
        source: Arc<sqlx::Error>,
    },
    /// Another writer stored an epoch or solution under this number.
    #[error("an epoch of this batch is already stored by another writer")]
    AlreadyStored,
    /// A stored row cannot be read.
    #[error("a stored {what} cannot be read: {source}")]
    Corrupt {
        /// What kind of row.
        what: &'static str,
        /// Where it fails.
        source: CodecError,
    },
    /// A stored text cannot be read.
    #[error("a stored {what} cannot be read: {why}")]
    CorruptText {
        /// What kind of text.
        what: &'static str,
        /// What is wrong with it.
        why: String,
    },
    /// Navigation data of long ago is no longer kept.
    #[error("navigation data of push {push} is kept no more; it is from push {complete_since} on")]
    NavigationForgotten {
        /// The push asked for.
        push: u64,
        /// The first push since which nothing has been forgotten.
        complete_since: u64,
    },
    /// Epochs of a base, or the base itself, are no longer kept.
    #[error("epochs of base {base} that a solution rests on are kept no more")]
    BaseForgotten {
        /// The store's short name of it.
        base: i64,
    },
    /// A page token that no answer gave.
    #[error("{token:?} is not a page token of this list")]
    PageToken {
        /// What was given.
        token: String,
    },
    /// A page size that is not allowed.
    #[error("a page of {size} is not from 1 to {limit}")]
    PageSize {
        /// What was asked for.
        size: usize,
        /// The largest allowed.
        limit: usize,
    },
    /// The store has been closed.
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
            Self::Migration { .. } => Code::DatabaseMigrationFailed,
            Self::Database { .. } => Code::DatabaseFailed,
            Self::AlreadyStored => Code::WrittenElsewhere,
            Self::Corrupt { .. } | Self::CorruptText { .. } => Code::StoredDataCorrupt,
            Self::NavigationForgotten { .. } => Code::NavigationForgotten,
            Self::BaseForgotten { .. } => Code::BaseForgotten,
            Self::PageToken { .. } => Code::PageTokenInvalid,
            Self::PageSize { .. } => Code::PageSizeInvalid,
            Self::Closed => Code::Draining,
        }
    }
}
