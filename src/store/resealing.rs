//! Stored secrets that are not encrypted with the key in force: those from before there was a key,
//! and those under a former key.

use sqlx::FromRow;

use crate::secrets::{SecretsError, StoredSecret};

use super::audit::{AuditEntry, note};
use super::feeds::password_owner;
use super::jobs::webhook_owner;
use super::pool::{reading, writing};
use super::{Store, StoreError};

/// Secrets that are written in one transaction.
const STEP: i64 = 500;

const PASSWORDS: &str = "SELECT base AS owner, password AS text, password_key AS key
    FROM base_feeds WHERE password <> '' AND COALESCE(password_key, '') <> $1
    ORDER BY base LIMIT $2";
const WEBHOOKS: &str = "SELECT id AS owner, webhook_secret AS text, webhook_secret_key AS key
    FROM jobs WHERE webhook_secret <> '' AND COALESCE(webhook_secret_key, '') <> $1
    ORDER BY id LIMIT $2";
/// Counts the stored secrets by the id of their key, which is empty for plain text.
const BY_KEY: &str = "SELECT id, COUNT(*) FROM (
        SELECT COALESCE(password_key, '') AS id FROM base_feeds WHERE password <> ''
        UNION ALL
        SELECT COALESCE(webhook_secret_key, '') FROM jobs WHERE webhook_secret <> '') AS stored
    GROUP BY id ORDER BY id";

/// A secret with its owner: the key of a base, or the id of a job.
#[derive(FromRow)]
struct RawSecret<O> {
    owner: O,
    text: String,
    key: Option<String>,
}

/// Number of secrets that are stored under a key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SecretsUnder {
    /// Id of the key; `None` for secrets that are not encrypted.
    pub key: Option<String>,
    /// Their number.
    pub secrets: u64,
}

impl Store {
    /// The keys under which secrets are stored.
    ///
    /// # Errors
    /// The database fails.
    pub async fn secrets_by_key(&self) -> Result<Vec<SecretsUnder>, StoreError> {
        let rows: Result<Vec<(String, i64)>, _> = reading!(&self.pool, pool => {
            sqlx::query_as(BY_KEY).fetch_all(pool).await
        });
        let rows = rows.map_err(StoreError::database("counting secrets"))?;
        let under = |(id, count): (String, i64)| SecretsUnder {
            key: Some(id).filter(|id| !id.is_empty()),
            secrets: count as u64,
        };
        Ok(rows.into_iter().map(under).collect())
    }

    /// Encrypts all stored secrets with the key in force, if there is one. Returns the number of
    /// secrets that it changed.
    ///
    /// # Errors
    /// A secret has an unknown key or was tampered with, or the database fails.
    pub async fn reseal(&self) -> Result<u64, StoreError> {
        let Some(key) = self.secrets.key_id() else {
            let unknown = self.secrets_by_key().await?.into_iter().find_map(|under| under.key);
            return unknown.map_or(Ok(0), |key| Err(SecretsError::KeyUnknown { key }.into()));
        };
        let mut resealed = 0;
        loop {
            let (passwords, webhooks) = self.other_secrets(key).await?;
            let passwords = self.resealed(passwords, |base| password_owner(*base))?;
            let webhooks = self.resealed(webhooks, |job| webhook_owner(job))?;
            let step = passwords.len() + webhooks.len();
            if step == 0 {
                return Ok(resealed);
            }
            self.write_secrets(&passwords, &webhooks).await?;
            resealed += step as u64;
        }
    }

    /// Some secrets that are not encrypted with this key.
    async fn other_secrets(
        &self,
        key: &str,
    ) -> Result<(Vec<RawSecret<i64>>, Vec<RawSecret<String>>), StoreError> {
        let passwords: Result<Vec<_>, _> = reading!(&self.pool, pool => {
            sqlx::query_as(PASSWORDS).bind(key).bind(STEP).fetch_all(pool).await
        });
        let webhooks: Result<Vec<_>, _> = reading!(&self.pool, pool => {
            sqlx::query_as(WEBHOOKS).bind(key).bind(STEP).fetch_all(pool).await
        });
        let failed = "reading secrets";
        let passwords = passwords.map_err(StoreError::database(failed))?;
        Ok((passwords, webhooks.map_err(StoreError::database(failed))?))
    }

    fn resealed<O>(
        &self,
        secrets: Vec<RawSecret<O>>,
        owner_of: impl Fn(&O) -> String,
    ) -> Result<Vec<(O, StoredSecret)>, StoreError> {
        let reseal = |RawSecret { owner, text, key }| {
            let name = owner_of(&owner);
            let secret = self.secrets.unseal(&name, &StoredSecret { text, key })?;
            Ok((owner, self.secrets.seal(&name, &secret)))
        };
        secrets.into_iter().map(reseal).collect()
    }

    async fn write_secrets(
        &self,
        passwords: &[(i64, StoredSecret)],
        webhooks: &[(String, StoredSecret)],
    ) -> Result<(), StoreError> {
        let written: Result<(), sqlx::Error> = writing!(&self.pool, pool => {
            let write = async {
                let mut transaction = pool.begin().await?;
                for (base, StoredSecret { text, key }) in passwords {
                    let sql = "UPDATE base_feeds SET password = $2, password_key = $3
                               WHERE base = $1";
                    let update = sqlx::query(sql).bind(base).bind(text).bind(key);
                    update.execute(&mut *transaction).await?;
                }
                for (job, StoredSecret { text, key }) in webhooks {
                    let sql = "UPDATE jobs SET webhook_secret = $2, webhook_secret_key = $3
                               WHERE id = $1";
                    let update = sqlx::query(sql).bind(job).bind(text).bind(key);
                    update.execute(&mut *transaction).await?;
                }
                transaction.commit().await
            };
            write.await
        });
        written.map_err(StoreError::database("encrypting secrets"))
    }

    /// Gives up the secrets under a key, with this entry in the audit log. Their casters are then
    /// asked without a password, and their webhooks get no further message. Returns their number.
    ///
    /// # Errors
    /// The database fails.
    pub async fn forget_secrets(&self, key: &str, entry: &AuditEntry) -> Result<u64, StoreError> {
        let forgotten: Result<u64, sqlx::Error> = writing!(&self.pool, pool => {
            let forget = async {
                let mut transaction = pool.begin().await?;
                let sql = "UPDATE base_feeds SET password = '', password_key = NULL
                           WHERE password_key = $1";
                let bases = sqlx::query(sql).bind(key).execute(&mut *transaction).await?;
                let sql = "UPDATE jobs SET webhook_secret = '', webhook_secret_key = NULL,
                                  webhook_due_unix_ms = NULL,
                                  webhook_state = CASE WHEN webhook_state = 'WAITING'
                                                  THEN 'FAILED' ELSE webhook_state END
                           WHERE webhook_secret_key = $1";
                let jobs = sqlx::query(sql).bind(key).execute(&mut *transaction).await?;
                let forgotten = bases.rows_affected() + jobs.rows_affected();
                if forgotten == 0 {
                    return Ok(0); // No act for the audit log.
                }
                note!(self, transaction, entry);
                transaction.commit().await?;
                Ok(forgotten)
            };
            forget.await
        });
        forgotten.map_err(StoreError::database("giving secrets up"))
    }
}
