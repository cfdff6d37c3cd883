//! The databases that store and sessions are tested on: each test on both, in a place of its own.
//!
//! `GRAPHFIX_TEST_POSTGRES` names a Postgres server; where it is set the server must answer, else
//! tests on Postgres are noted as skipped, as data sets are that are not there.

use std::future::Future;

use graphfix::store::{Revisions, SolutionQuery, Store};
use sqlx::{AssertSqlSafe, Connection, PgConnection, SqliteConnection};
use tempfile::TempDir;
use uuid::Uuid;

use super::data;

/// All that a session has, revisions included, on one page.
pub(crate) fn whole_session() -> SolutionQuery {
    SolutionQuery {
        from: None,
        to: None,
        status: None,
        revisions: Revisions::All,
        page_size: 10_000,
        page_token: None,
    }
}

/// An empty database for one test.
pub(crate) struct Database {
    pub(crate) url: String,
    /// Removed with its file at the end of the test.
    _folder: Option<TempDir>,
}

impl Database {
    pub(crate) fn sqlite() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let url = format!("sqlite://{}", folder.path().join("graphfix.db").display());
        Self { url, _folder: Some(folder) }
    }

    /// Opens the store, as a service does at its start.
    pub(crate) async fn store(&self) -> Store {
        Store::open(&self.url).await.unwrap()
    }

    /// Runs SQL behind the store's back.
    pub(crate) async fn execute(&self, sql: &str) {
        let sql = AssertSqlSafe(sql);
        if self.url.starts_with("sqlite") {
            let mut connection = SqliteConnection::connect(&self.url).await.unwrap();
            sqlx::query(sql).execute(&mut connection).await.unwrap();
        } else {
            let mut connection = PgConnection::connect(&self.url).await.unwrap();
            sqlx::query(sql).execute(&mut connection).await.unwrap();
        }
    }
}

/// Runs a test in a schema of its own on Postgres, if there is one.
pub(crate) async fn on_postgres<F: Future<Output = ()>>(test: impl FnOnce(Database) -> F) {
    let Ok(server) = std::env::var("GRAPHFIX_TEST_POSTGRES") else {
        data::note_missing("PostgreSQL");
        return;
    };
    let schema = format!("test_{}", Uuid::new_v4().simple());
    let mut connection = PgConnection::connect(&server).await.unwrap();
    let create = AssertSqlSafe(format!("CREATE SCHEMA {schema}"));
    sqlx::query(create).execute(&mut connection).await.unwrap();
    let separator = if server.contains('?') { '&' } else { '?' };
    let url = format!("{server}{separator}options[search_path]={schema}");
    test(Database { url, _folder: None }).await;
    let drop = AssertSqlSafe(format!("DROP SCHEMA {schema} CASCADE"));
    sqlx::query(drop).execute(&mut connection).await.unwrap();
}

/// Declares tests that run on both databases.
macro_rules! on_both_databases {
    ($($test:ident),+ $(,)?) => {
        mod sqlite {
            $(#[tokio::test] async fn $test() {
                super::$test($crate::support::database::Database::sqlite()).await;
            })+
        }
        mod postgres {
            $(#[tokio::test] async fn $test() {
                $crate::support::database::on_postgres(super::$test).await;
            })+
        }
    };
}
pub(crate) use on_both_databases;
