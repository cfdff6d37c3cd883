//! Sessions whose rows are read again, because the database may still commit an update or a closing
//! of them that failed.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use super::SessionId;

/// Interval of these reads.
pub(super) const LOOK_INTERVAL: Duration = Duration::from_secs(1);
/// Number of reads that the database answers. A commit that it received before the failure ends
/// before, unless its disk takes longer.
const LOOKS: usize = 30;
/// Number of reads with those that fail.
const LOOKS_MAX: usize = 600;

/// Reads since the last change that failed.
#[derive(Clone, Copy, Default)]
struct Looks {
    answered: usize,
    all: usize,
}

/// The sessions with such a change. One task reads the row of each.
#[derive(Default)]
pub(super) struct UpdatesToConfirm(Mutex<HashMap<SessionId, Looks>>);

impl UpdatesToConfirm {
    /// Notes a change that failed. Returns whether no task reads the row of this session yet; one
    /// that does begins to count again.
    pub(super) fn note(&self, session: &SessionId) -> bool {
        let mut sessions = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        sessions.insert(session.clone(), Looks::default()).is_none()
    }

    /// Counts a read. Returns whether others follow; otherwise the session is forgotten.
    pub(super) fn count(&self, session: &SessionId, is_answered: bool) -> bool {
        let mut sessions = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(looks) = sessions.get_mut(session) else { return false };
        looks.answered += usize::from(is_answered);
        looks.all += 1;
        let continues = looks.answered < LOOKS && looks.all < LOOKS_MAX;
        if !continues {
            sessions.remove(session);
        }
        continues
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_task_reads_the_settings_of_a_session() {
        let (updates, id) = (UpdatesToConfirm::default(), SessionId::random());
        assert!(updates.note(&id));
        for _ in 1..LOOKS {
            assert!(updates.count(&id, true));
        }
        assert!(!updates.note(&id), "a task reads them");
        assert!(updates.note(&SessionId::random()), "of another session");
        for _ in 1..LOOKS {
            assert!(updates.count(&id, true), "counted from the last failure on");
        }
        assert!(!updates.count(&id, true));
        assert!(updates.note(&id), "the task has ended");
    }

    #[test]
    fn reads_end_while_the_database_fails() {
        let (updates, id) = (UpdatesToConfirm::default(), SessionId::random());
        updates.note(&id);
        for _ in 1..LOOKS_MAX {
            assert!(updates.count(&id, false));
        }
        assert!(!updates.count(&id, false));
        assert!(updates.0.lock().unwrap().is_empty());
    }
}
