//! Failures of SQLite as errors of `sqlx`, so that the committer treats both databases alike.

use std::borrow::Cow;
use std::error::Error;
use std::fmt;

use rusqlite::ffi;
use sqlx::error::{DatabaseError, ErrorKind};

/// A failure that SQLite reports.
#[derive(Debug)]
struct SqliteFailure {
    /// Extended result code.
    code: i32,
    message: String,
}

/// The failure as an error of `sqlx`.
pub(super) fn failed(error: rusqlite::Error) -> sqlx::Error {
    match error {
        rusqlite::Error::SqliteFailure(failure, message) => {
            let message = message.unwrap_or_else(|| failure.to_string());
            let failure = SqliteFailure { code: failure.extended_code, message };
            sqlx::Error::Database(Box::new(failure))
        }
        other => sqlx::Error::Decode(Box::new(other)),
    }
}

impl fmt::Display for SqliteFailure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "(code: {}) {}", self.code, self.message)
    }
}

impl Error for SqliteFailure {}

impl DatabaseError for SqliteFailure {
    fn message(&self) -> &str {
        &self.message
    }

    fn code(&self) -> Option<Cow<'_, str>> {
        Some(self.code.to_string().into())
    }

    fn kind(&self) -> ErrorKind {
        match self.code {
            ffi::SQLITE_CONSTRAINT_UNIQUE | ffi::SQLITE_CONSTRAINT_PRIMARYKEY => {
                ErrorKind::UniqueViolation
            }
            ffi::SQLITE_CONSTRAINT_FOREIGNKEY => ErrorKind::ForeignKeyViolation,
            ffi::SQLITE_CONSTRAINT_NOTNULL => ErrorKind::NotNullViolation,
            ffi::SQLITE_CONSTRAINT_CHECK => ErrorKind::CheckViolation,
            _ => ErrorKind::Other,
        }
    }

    fn as_error(&self) -> &(dyn Error + Send + Sync + 'static) {
        self
    }

    fn as_error_mut(&mut self) -> &mut (dyn Error + Send + Sync + 'static) {
        self
    }

    fn into_error(self: Box<Self>) -> Box<dyn Error + Send + Sync + 'static> {
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A repeated key is distinguished from other failures, for either kind of key.
    #[test]
    fn a_repeated_key_is_a_unique_violation() {
        let connection = rusqlite::Connection::open_in_memory().unwrap();
        let schema = "CREATE TABLE t (a INTEGER PRIMARY KEY, b INTEGER NOT NULL UNIQUE)";
        connection.execute_batch(schema).unwrap();
        connection.execute_batch("INSERT INTO t VALUES (1, 1)").unwrap();
        let kind = |sql: &str| {
            let error = failed(connection.execute_batch(sql).unwrap_err());
            error.as_database_error().expect("SQLite reports it").kind()
        };
        assert_eq!(kind("INSERT INTO t VALUES (1, 2)"), ErrorKind::UniqueViolation);
        assert_eq!(kind("INSERT INTO t VALUES (2, 1)"), ErrorKind::UniqueViolation);
        assert_eq!(kind("INSERT INTO t VALUES (2, NULL)"), ErrorKind::NotNullViolation);
        assert_eq!(kind("INSERT INTO absent VALUES (1)"), ErrorKind::Other);
        let text = failed(connection.execute_batch("x").unwrap_err()).to_string();
        assert_eq!(text, "error returned from database: (code: 1) near \"x\": syntax error");
    }
}
