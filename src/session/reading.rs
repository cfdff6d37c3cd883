//! Reads of the desk from the store, and the removal of expired rows.

use std::time::Duration;

use crate::clock::MS_PER_DAY;
use crate::store::{Bounds, Page, SessionFilter, SessionHead, SolutionQuery, StoreError};

use super::configuration::output;
use super::desk::Sessions;
use super::info::oldest_available;
use super::solvers::BatchLane;
use super::{SessionError, SessionId, SessionInfo, SolutionPage};

impl Sessions {
    /// A session, open or closed.
    ///
    /// # Errors
    /// No session has this id, or the store fails.
    pub async fn get(&self, id: &SessionId) -> Result<SessionInfo, SessionError> {
        self.info(id.clone(), self.row(id).await?)
    }

    /// The lane of the solver pool for batch jobs.
    pub fn batch_lane(&self) -> BatchLane {
        self.solvers().batch_lane(self.meters().clone())
    }

    /// A page of 1 to 1000 sessions.
    ///
    /// # Errors
    /// The page token or size is invalid, or the store fails.
    pub async fn list(
        &self,
        filter: &SessionFilter,
        page_size: usize,
        page_token: Option<&str>,
    ) -> Result<Page<SessionInfo>, SessionError> {
        let page = self.store().sessions(self.tenant(), filter, page_size, page_token).await?;
        page.try_map(|row| {
            let id = SessionId::parse(&row.id).ok_or_else(|| StoreError::CorruptText {
                what: "session id",
                why: format!("{:?} is not the id of a session", row.id),
            })?;
            self.info(id, row)
        })
    }

    /// A page of 1 to 10 000 heads, with the clock of the service; with an area only those whose
    /// latest position lies in it.
    ///
    /// # Errors
    /// The page token or size is invalid, or the store fails.
    pub async fn heads(
        &self,
        filter: &SessionFilter,
        area: Option<&Bounds>,
        page_size: usize,
        page_token: Option<&str>,
    ) -> Result<(Page<SessionHead>, i64), SessionError> {
        let page = self.store().heads(self.tenant(), filter, area, page_size, page_token).await?;
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
        let output = output(&row.settings)?;
        let page = self.store().solutions(row.key, query).await?;
        let oldest_available = oldest_available(row.removed_through);
        Ok(SolutionPage { page, oldest_available, output, bases: row.settings.base })
    }

    /// Removes the epochs that are older than their session's retention. Returns when they are
    /// removed. The desk does this every hour.
    ///
    /// # Errors
    /// The store fails.
    pub async fn remove_expired(&self) -> Result<(), SessionError> {
        Ok(self.expiry().remove().await?)
    }

    /// Time by which the system clock is ahead of the time by which ages are counted, if it is more
    /// than a day. Epochs are kept longer by this time.
    pub fn clock_ahead(&self) -> Option<Duration> {
        self.expiry().clock_ahead()
    }

    /// Time by which the system clock is behind the time by which ages are counted, if it is more
    /// than a day. What arrives has the counted time.
    pub fn clock_behind(&self) -> Option<Duration> {
        let behind_ms = self.store().clock_behind_ms(self.unix_ms());
        (MS_PER_DAY < behind_ms).then(|| Duration::from_millis(behind_ms as u64))
    }
}
