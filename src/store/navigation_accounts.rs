//! Accounts by which superseded navigation data are counted and forgotten.
//!
//! Each account has the same limit, so what one tenant uploads removes nothing that the sessions of
//! others are replayed with.

use super::pool::reading;
use super::{Store, StoreError};

/// Prefix of the sources that own their data. Such data serve only their owner.
pub(crate) const OWNER_PREFIX: &str = "device ";
/// Prefix of the sources that are tenants. The name of the tenant follows.
pub(crate) const TENANT_PREFIX: &str = "device tenant ";
/// Account of the data that serve all sessions. All replays need them.
pub(super) const OF_ALL: &str = "";
/// Account of the operator's devices, whose number is not limited.
const OF_DEVICES: &str = "device";

/// The account of the data of a source, or of an owner of data.
pub(crate) fn account_of(source: &str) -> &str {
    if source.starts_with(TENANT_PREFIX) {
        source
    } else if source.starts_with(OWNER_PREFIX) {
        OF_DEVICES
    } else {
        OF_ALL
    }
}

/// Selects the push that ended the newest row of an account beyond the limit.
pub(super) const SURPLUS: [&str; 2] = [
    "SELECT until FROM ephemerides WHERE account = $1 AND until IS NOT NULL
     ORDER BY until DESC LIMIT 1 OFFSET $2",
    "SELECT until FROM navigation_records WHERE account = $1 AND until IS NOT NULL
     ORDER BY until DESC LIMIT 1 OFFSET $2",
];
/// Deletes all data that ended at this push or before. Without those that serve all, no session can
/// be replayed there.
pub(super) const FORGET_ALL: [&str; 3] = [
    "DELETE FROM ephemerides WHERE until <= $1",
    "DELETE FROM navigation_records WHERE until <= $1",
    "UPDATE navigation_pushes SET complete_since = $1",
];
/// Deletes the data of an account that ended at this push or before.
pub(super) const FORGET_OF_ACCOUNT: [&str; 3] = [
    "DELETE FROM ephemerides WHERE until <= $1 AND account = $2",
    "DELETE FROM navigation_records WHERE until <= $1 AND account = $2",
    "INSERT INTO navigation_accounts (complete_since, account) VALUES ($1, $2)
     ON CONFLICT (account) DO UPDATE SET complete_since = excluded.complete_since",
];

/// Deletes the superseded data of an account beyond a limit, within a transaction.
macro_rules! forget_superseded {
    ($transaction:expr, $account:expr, $limit:expr) => {
        let mut surplus: Option<i64> = None;
        for sql in $crate::store::navigation_accounts::SURPLUS {
            let end = sqlx::query_scalar(sql).bind($account).bind($limit as i64);
            let end: Option<i64> = end.fetch_optional(&mut *$transaction).await?;
            surplus = surplus.max(end);
        }
        if let Some(end) = surplus {
            if $account == $crate::store::navigation_accounts::OF_ALL {
                for sql in $crate::store::navigation_accounts::FORGET_ALL {
                    sqlx::query(sql).bind(end).execute(&mut *$transaction).await?;
                }
            } else {
                for sql in $crate::store::navigation_accounts::FORGET_OF_ACCOUNT {
                    let forget = sqlx::query(sql).bind(end).bind($account);
                    forget.execute(&mut *$transaction).await?;
                }
            }
        }
    };
}
pub(super) use forget_superseded;

/// Since which pushes the stored navigation data are complete.
pub(super) struct Completeness {
    /// Number of the last push.
    pub(super) newest: u64,
    of_all: u64,
    /// Accounts that have forgotten more, each with its first complete push.
    accounts: Vec<(String, u64)>,
}

impl Completeness {
    /// The first push after which the data for sessions of an account are complete.
    pub(super) fn since(&self, account: &str) -> u64 {
        let own = self.accounts.iter().find(|(of, _)| of == account);
        own.map_or(self.of_all, |(_, since)| self.of_all.max(*since))
    }

    /// The accounts whose own data after a push are incomplete.
    pub(super) fn incomplete_at(&self, push: u64) -> Vec<String> {
        let incomplete = self.accounts.iter().filter(|(_, since)| push < *since);
        incomplete.map(|(account, _)| account.clone()).collect()
    }
}

/// Last push, first complete push of the data that serve all, an account, and its first one.
type CompletenessRow = (i64, i64, Option<String>, Option<i64>);

impl Store {
    pub(super) async fn navigation_completeness(&self) -> Result<Completeness, StoreError> {
        let rows: Result<Vec<CompletenessRow>, _> = reading!(&self.pool, pool => {
            let sql = "SELECT p.newest, p.complete_since, a.account, a.complete_since
                       FROM navigation_pushes p LEFT JOIN navigation_accounts a
                       ON p.complete_since < a.complete_since";
            sqlx::query_as(sql).fetch_all(pool).await
        });
        let rows = rows.map_err(StoreError::database("reading the pushes of navigation data"))?;
        let (newest, of_all) = rows.first().map_or((0, 0), |row| (row.0 as u64, row.1 as u64));
        let account = |(_, _, account, since): CompletenessRow| Some((account?, since? as u64));
        let accounts = rows.into_iter().filter_map(account).collect();
        Ok(Completeness { newest, of_all, accounts })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tenant_has_an_account_and_the_operators_devices_have_one() {
        assert_eq!(account_of("device tenant acme"), "device tenant acme");
        assert_eq!(account_of("device 0f3a"), OF_DEVICES);
        for of_all in ["", "device", "upload", "agreed", "https://archive.example/brdc.rnx"] {
            assert_eq!(account_of(of_all), OF_ALL);
        }
    }
}
