//! The stored epochs of a session, page by page.

use std::sync::Arc;

use crate::aiding::rover_source;
use crate::gnss::{GpsTime, Navigation};
use crate::store::{SessionKey, Store, StoredEpoch};

use super::desk::Sessions;
use super::{SessionError, SessionId};

/// Epochs that are read at a time.
const PAGE: usize = 128;

/// The stored epochs of a session in a span of time. Epochs that arrive later are not included.
#[derive(Clone)]
pub struct ObservedEpochs {
    store: Store,
    key: SessionKey,
    /// Name of the session.
    pub label: String,
    /// The navigation data in force for the session now.
    pub navigation: Arc<Navigation>,
    span: (Option<GpsTime>, Option<GpsTime>),
    /// Number of the epoch before the next page; `None` before the first.
    after: Option<u64>,
    /// Number of the last epoch; `None` once all are read.
    last: Option<u64>,
}

impl Sessions {
    /// The stored epochs of a session, open or closed, from one time to another.
    ///
    /// # Errors
    /// No session has this id, or the store fails.
    pub async fn observed(
        &self,
        id: &SessionId,
        span: (Option<GpsTime>, Option<GpsTime>),
    ) -> Result<ObservedEpochs, SessionError> {
        let row = self.row(id).await?;
        let numbers = self.store().epoch_numbers(row.key, row.removed_through, span).await?;
        let device = rover_source(&row.tenant, id.as_str());
        Ok(ObservedEpochs {
            store: self.store().clone(),
            key: row.key,
            label: row.settings.label,
            navigation: self.aiding().navigation.current_for(&device).navigation,
            span,
            after: numbers.and_then(|(first, _)| first.checked_sub(1)),
            last: numbers.map(|(_, last)| last),
        })
    }
}

impl ObservedEpochs {
    /// The next epochs, in order of their numbers; `None` at the end.
    ///
    /// # Errors
    /// The store fails.
    pub async fn next(&mut self) -> Result<Option<Vec<StoredEpoch>>, SessionError> {
        let Some(last) = self.last else { return Ok(None) };
        let mut page = self.store.listed_epochs_after(self.key, self.after, PAGE).await?;
        let newest = page.last().map(|stored| stored.solution.seq);
        match newest {
            Some(newest) if newest < last => self.after = Some(newest),
            _ => self.last = None,
        }
        let (from, to) = self.span;
        page.retain(|StoredEpoch { epoch, solution, .. }| {
            solution.seq <= last
                && from.is_none_or(|from| from <= epoch.time)
                && to.is_none_or(|to| epoch.time <= to)
        });
        Ok(Some(page))
    }
}
