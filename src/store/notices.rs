//! Notices by which a node of a cluster informs the others of what it has stored.

use sqlx::postgres::PgListener;

use super::StoreError;

/// What other nodes have changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Change {
    /// Navigation data.
    Navigation,
    /// Base stations, or their epochs.
    Bases,
}

impl Change {
    /// The text of the notice.
    pub(super) const fn text(self) -> &'static str {
        match self {
            Self::Navigation => "navigation",
            Self::Bases => "bases",
        }
    }
}

/// Notices of the changes that other nodes make.
pub(crate) struct Notices(PgListener);

impl Notices {
    /// The notices that arrive at a connection.
    pub(super) const fn of(listener: PgListener) -> Self {
        Self(listener)
    }

    /// The next notice; `None` if some may have been lost.
    ///
    /// # Errors
    /// The connection failed.
    pub(crate) async fn next(&mut self) -> Result<Option<Change>, StoreError> {
        let failed = StoreError::database("waiting for notices of other nodes");
        let notice = self.0.try_recv().await.map_err(failed)?;
        let known = [Change::Navigation, Change::Bases];
        let is_it = |change: &Change| notice.as_ref().is_some_and(|n| n.payload() == change.text());
        Ok(known.into_iter().find(is_it))
    }
}

/// Notifies the other nodes of a change when the transaction is committed. Does nothing without a
/// cluster.
macro_rules! notify {
    ($store:expr, $transaction:expr, $change:expr) => {
        if $store.fence().is_some() {
            sqlx::query("SELECT pg_notify('graphfix_' || current_schema(), $1)")
                .bind($change.text())
                .execute(&mut *$transaction)
                .await?;
        }
    };
}
pub(super) use notify;
