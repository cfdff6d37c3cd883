//! Watches of a session's commits, from any solution on.

use crate::config::OutputOptions;
use crate::store::{Revisions, SolutionQuery, StoredSolution};

use super::configuration::output;
use super::desk::Sessions;
use super::info::oldest_available;
use super::live::Watch;
use super::{SessionError, SessionId};

/// The solutions that a watch has seen. The answers of a session, and their revisions, are
/// committed in the order of their numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WatchCursor {
    /// Revision 0 of epochs through this number; 0 for none.
    pub answers: u64,
    /// Later revisions of epochs through this number; 0 for none.
    pub revisions: u64,
}

/// A page of solutions that a watch has not seen.
#[derive(Clone, Debug, PartialEq)]
pub struct WatchPage {
    /// The solutions: answers first, then revisions.
    pub solutions: Vec<StoredSolution>,
    /// Whether there may be more.
    pub has_more: bool,
    /// Epochs below this number are removed; `None` while all are stored.
    pub oldest_available: Option<u64>,
    /// Whether the session was closed before the page was read.
    pub is_closed: bool,
    /// Frame and heights in which the solutions are reported.
    pub output: OutputOptions,
}

impl WatchCursor {
    /// Notes that a solution is sent; `false` if it was sent before.
    pub(crate) fn see(&mut self, solution: &StoredSolution) -> bool {
        let seen = if solution.revision == 0 { &mut self.answers } else { &mut self.revisions };
        let is_new = *seen < solution.seq;
        *seen = solution.seq.max(*seen);
        is_new
    }
}

impl Sessions {
    /// A watch on the commits of a session from now on, and the cursor after its stored solutions.
    /// Some of the watch's first solutions may already be before that cursor.
    ///
    /// # Errors
    /// No session has this id, or the store fails.
    pub(crate) async fn watch(&self, id: &SessionId) -> Result<(Watch, WatchCursor), SessionError> {
        let key = self.row(id).await?.key;
        let watch = self.live().watch(key);
        let answers = self.row(id).await?.last_seq.unwrap_or(0);
        // Only later epochs still get revisions.
        let revisions = self.store().last_revised(key).await?.unwrap_or(0);
        Ok((watch, WatchCursor { answers, revisions }))
    }

    /// The next answers after a cursor, at most `count`, and as many revisions, if they are wanted.
    ///
    /// # Errors
    /// No session has this id, or the store fails.
    pub(crate) async fn watched(
        &self,
        id: &SessionId,
        cursor: WatchCursor,
        (count, with_revisions): (usize, bool),
    ) -> Result<WatchPage, SessionError> {
        let row = self.row(id).await?;
        let query = |revisions, token| SolutionQuery {
            from: None,
            to: None,
            status: None,
            revisions,
            page_size: count,
            page_token: Some(token),
        };
        let first = query(Revisions::First, format!("{}.0", cursor.answers));
        let answers = self.store().solutions(row.key, &first).await?;
        let mut has_more = answers.next_page_token.is_some();
        let mut solutions = answers.items;
        if with_revisions {
            let later = query(Revisions::Later, format!("{}.{}", cursor.revisions, i32::MAX));
            let revisions = self.store().solutions(row.key, &later).await?;
            has_more |= revisions.next_page_token.is_some();
            solutions.extend(revisions.items);
        }
        let (is_closed, oldest_available) =
            (row.closed_unix_ms.is_some(), oldest_available(row.removed_through));
        let output = output(&row.settings)?;
        Ok(WatchPage { solutions, has_more, oldest_available, is_closed, output })
    }
}
