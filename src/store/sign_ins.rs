//! Sign-ins of browsers as rows. A row contains the hash of the cookie, never the cookie.
//!
//! Changes of sign-ins and of keys share one sequence of numbers. So a service that has them in
//! memory reads only the changes.

use super::keys::COUNT_UP;
use super::pool::{reading, writing};
use super::{Store, StoreError};

/// Sign-ins read at a time.
const CHANGES: i64 = 1_000;
/// Time for which an ended sign-in is kept (ms), so that other nodes learn of its end.
const KEPT_MS: i64 = 600_000;

const REMOVE: &str = "DELETE FROM sign_ins WHERE expires_unix_ms < $1";
const INSERT: &str = "INSERT INTO sign_ins (cookie_sha256, api_key, expires_unix_ms, changed) \
    VALUES ($1, $2, $3, $4)";
const END: &str = "UPDATE sign_ins SET ended = 1, changed = $1, expires_unix_ms = \
    CASE WHEN $2 < expires_unix_ms THEN $2 ELSE expires_unix_ms END \
    WHERE cookie_sha256 = $3 AND ended = 0";

/// A sign-in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SignInRow {
    /// SHA-256 of its cookie.
    pub cookie_sha256: [u8; 32],
    /// Id of the key that the browser signed in with.
    pub key: String,
    /// When it ends (ms since 1970-01-01 UTC), unless its key ends before.
    pub expires_unix_ms: i64,
    /// Whether it was ended before it expired.
    pub is_ended: bool,
    /// Number of its last change.
    pub changed: i64,
}

#[derive(sqlx::FromRow)]
struct RawSignIn {
    cookie_sha256: Vec<u8>,
    api_key: String,
    expires_unix_ms: i64,
    ended: i64,
    changed: i64,
}

impl RawSignIn {
    fn parse(self) -> Result<SignInRow, StoreError> {
        let cookie_sha256 = self.cookie_sha256.try_into().map_err(|bytes: Vec<u8>| {
            let why = format!("the hash of a cookie has {} bytes", bytes.len());
            StoreError::CorruptText { what: "sign-in", why }
        })?;
        Ok(SignInRow {
            cookie_sha256,
            key: self.api_key,
            expires_unix_ms: self.expires_unix_ms,
            is_ended: self.ended != 0,
            changed: self.changed,
        })
    }
}

/// Ends sign-ins within a transaction. Each change has its own number, because readers continue
/// after the last number that they have read.
macro_rules! end {
    ($transaction:expr, $hashes:expr, $unix_ms:expr) => {
        for hash in $hashes {
            let number: i64 = sqlx::query_scalar(COUNT_UP).fetch_one(&mut *$transaction).await?;
            let end = sqlx::query(END).bind(number).bind($unix_ms + KEPT_MS).bind(&hash[..]);
            end.execute(&mut *$transaction).await?;
        }
    };
}

impl Store {
    /// Stores a sign-in of the browser with this hash of a cookie, by the key with this id. It ends
    /// the sign-ins `ended` to make room, and removes expired rows.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn begin_sign_in(
        &self,
        (cookie_sha256, key): (&[u8; 32], &str),
        expires_unix_ms: i64,
        ended: &[[u8; 32]],
        unix_ms: i64,
    ) -> Result<(), StoreError> {
        let begun = writing!(&self.pool, pool => {
            let begin = async {
                let mut transaction = pool.begin().await?;
                let number: i64 =
                    sqlx::query_scalar(COUNT_UP).fetch_one(&mut *transaction).await?;
                end!(transaction, ended, unix_ms);
                sqlx::query(REMOVE).bind(unix_ms).execute(&mut *transaction).await?;
                let insert = sqlx::query(INSERT).bind(&cookie_sha256[..]).bind(key);
                let insert = insert.bind(expires_unix_ms).bind(number);
                insert.execute(&mut *transaction).await?;
                transaction.commit().await
            };
            begin.await
        });
        begun.map_err(StoreError::database("storing a sign-in"))
    }

    /// Ends a sign-in.
    ///
    /// # Errors
    /// The database fails.
    pub(crate) async fn end_sign_in(
        &self,
        cookie_sha256: &[u8; 32],
        unix_ms: i64,
    ) -> Result<(), StoreError> {
        let ended = writing!(&self.pool, pool => {
            let end = async {
                let mut transaction = pool.begin().await?;
                end!(transaction, [cookie_sha256], unix_ms);
                transaction.commit().await
            };
            end.await
        });
        ended.map_err(StoreError::database("ending a sign-in"))
    }

    /// Sign-ins that were changed after the change with this number, in the order of their changes.
    /// If there are many, the first of them.
    ///
    /// # Errors
    /// The database fails, or a row is corrupt.
    pub(crate) async fn changed_sign_ins(&self, after: i64) -> Result<Vec<SignInRow>, StoreError> {
        let rows: Result<Vec<RawSignIn>, _> = reading!(&self.key_pool, pool => {
            let sql = "SELECT cookie_sha256, api_key, expires_unix_ms, ended, changed
                       FROM sign_ins WHERE $1 < changed ORDER BY changed LIMIT $2";
            sqlx::query_as(sql).bind(after).bind(CHANGES).fetch_all(pool).await
        });
        let rows = rows.map_err(StoreError::database("reading changed sign-ins"))?;
        rows.into_iter().map(RawSignIn::parse).collect()
    }
}
