//! The databases of the store's and sessions' tests: each test runs on both, with its own database
//! or schema.
//!
//! `GRAPHFIX_TEST_POSTGRES` names a Postgres server. If it is set the server must answer; otherwise
//! tests on Postgres are noted as skipped, like those without their data set.

use std::future::Future;
use std::path::Path;

use graphfix::store::{Revisions, SolutionQuery, Store};
use sqlx::{Connection, PgConnection, SqliteConnection};
use tempfile::TempDir;
use uuid::Uuid;

use super::data;

/// All solutions of a session, revisions included, on one page.
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

pub(crate) fn sqlite_url(file: &Path) -> String {
    format!("sqlite://{}", file.display())
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
        let url = sqlite_url(&folder.path().join("graphfix.db"));
        Self { url, _folder: Some(folder) }
    }

    /// Opens the store, as a service does at its start.
    pub(crate) async fn store(&self) -> Store {
        Store::open(&self.url).await.unwrap()
    }

    /// Runs SQL directly on the database, without the store.
    pub(crate) async fn execute(&self, sql: &str) {
        if self.url.starts_with("sqlite") {
            let mut connection = SqliteConnection::connect(&self.url).await.unwrap();
            sqlx::query(sql).execute(&mut connection).await.unwrap();
        } else {
            let mut connection = PgConnection::connect(&self.url).await.unwrap();
            sqlx::query(sql).execute(&mut connection).await.unwrap();
        }
    }

    /// Bytes of the pages in use and of all pages, indices included; on Postgres both are those of
    /// epochs and revisions.
    pub(crate) async fn bytes(&self) -> (i64, i64) {
        if self.url.starts_with("sqlite") {
            let mut connection = SqliteConnection::connect(&self.url).await.unwrap();
            let mut number = async |sql: &'static str| -> i64 {
                sqlx::query_scalar(sql).fetch_one(&mut connection).await.unwrap()
            };
            let (pages, free) =
                (number("PRAGMA page_count").await, number("PRAGMA freelist_count").await);
            let page = number("PRAGMA page_size").await;
            ((pages - free) * page, pages * page)
        } else {
            let mut connection = PgConnection::connect(&self.url).await.unwrap();
            let sql = "SELECT SUM(pg_total_relation_size(inhrelid))::bigint FROM pg_inherits \
                       JOIN pg_class ON pg_class.oid = inhparent \
                       WHERE relname IN ('epochs', 'revisions') \
                       AND relnamespace = current_schema()::regnamespace";
            let bytes = sqlx::query_scalar(sql).fetch_one(&mut connection).await.unwrap();
            (bytes, bytes)
        }
    }

    /// The text that a statement selects; empty if it is NULL.
    pub(crate) async fn text(&self, sql: &str) -> String {
        let text: Option<String> = if self.url.starts_with("sqlite") {
            let mut connection = SqliteConnection::connect(&self.url).await.unwrap();
            sqlx::query_scalar(sql).fetch_one(&mut connection).await.unwrap()
        } else {
            let mut connection = PgConnection::connect(&self.url).await.unwrap();
            sqlx::query_scalar(sql).fetch_one(&mut connection).await.unwrap()
        };
        text.unwrap_or_default()
    }

    /// Number of rows of a table.
    pub(crate) async fn count(&self, table: &str) -> i64 {
        let sql = &format!("SELECT COUNT(*) FROM {table}");
        if self.url.starts_with("sqlite") {
            let mut connection = SqliteConnection::connect(&self.url).await.unwrap();
            sqlx::query_scalar(sql).fetch_one(&mut connection).await.unwrap()
        } else {
            let mut connection = PgConnection::connect(&self.url).await.unwrap();
            sqlx::query_scalar(sql).fetch_one(&mut connection).await.unwrap()
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
    let create = format!("CREATE SCHEMA {schema}");
    sqlx::query(&create).execute(&mut connection).await.unwrap();
    let separator = if server.contains('?') { '&' } else { '?' };
    let url = format!("{server}{separator}options[search_path]={schema}");
    test(Database { url, _folder: None }).await;
    let drop = format!("DROP SCHEMA {schema} CASCADE");
    sqlx::query(&drop).execute(&mut connection).await.unwrap();
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
