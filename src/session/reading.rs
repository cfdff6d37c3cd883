//! What the desk reads from the store, and how it removes what is expired.

use crate::store::{Page, SessionHead, SolutionQuery, StoreError};

use super::desk::Sessions;
use super::info::oldest_available;
use super::removal::remove_expired;
use super::{SessionError, SessionId, SessionInfo, SolutionPage};

impl Sessions {
    /// A session, open or closed.
    ///
    /// # Errors
    /// No session has this id, or the store fails.
    pub async fn get(&self, id: &SessionId) -> Result<SessionInfo, SessionError> {
        self.info(id.clone(), self.row(id).await?)
    }

    /// A page of 1 to 1000 sessions, the newest first.
    ///
    /// # Errors
    /// The page token or size is invalid, or the store fails.
    pub async fn list(
        &self,
        page_size: usize,
        page_token: Option<&str>,
    ) -> Result<Page<SessionInfo>, SessionError> {
        let page = self.store().sessions(page_size, page_token).await?;
        page.try_map(|row| {
            let id = SessionId::parse(&row.id).ok_or_else(|| StoreError::CorruptText {
                what: "session id",
                why: format!("{:?} is not the id of a session", row.id),
            })?;
            self.info(id, row)
        })
    }

    /// A page of 1 to 10 000 heads, the newest session first, with the clock of the service.
    ///
    /// # Errors
    /// The page token or size is invalid, or the store fails.
    pub async fn heads(
        &self,
        page_size: usize,
        page_token: Option<&str>,
    ) -> Result<(Page<SessionHead>, i64), SessionError> {
        let page = self.store().heads(page_size, page_token).await?;
        Ok((page, self.clock().unix_ms()))
    }

    /// Stored solutions of a session, open or closed, in order of epoch number and revision.
    ///
    /// # Errors
    /// No session has this id, the page token or size is invalid, or the store fails.
    pub async fn solutions(
        &self,
        id: &SessionId,
        query: &SolutionQuery,
    ) -> Result<SolutionPage, SessionError> {
        let row = self.row(id).await?;
        let page = self.store().solutions(row.key, query).await?;
        Ok(SolutionPage { page, oldest_available: oldest_available(row.removed_through) })
    }

    /// Removes the epochs that are older than their session's retention, and returns when it has.
    /// The desk does so every hour.
    ///
    /// # Errors
    /// The store fails.
    pub async fn remove_expired(&self) -> Result<(), SessionError> {
        Ok(remove_expired(self.store(), self.clock(), self.limits().retention_days).await?)
    }
}
