//! Sessions that move to another node of the cluster.

use std::sync::atomic::Ordering;
use std::time::Duration;

use crate::store::Claim;

use super::desk::Sessions;
use super::{SessionError, SessionId};

/// A session stays at a node for at least this long, so that a device whose requests arrive at
/// several nodes does not move it each time.
const STAY: Duration = Duration::from_secs(60);

impl Sessions {
    /// Gives up a session of this node because its requests now arrive at another node, which
    /// claims it with the device's next request. Returns whether it was given up. A session with
    /// waiting epochs, or one that started here recently, stays.
    ///
    /// # Errors
    /// The store fails.
    pub(crate) async fn give_up(&self, id: &SessionId) -> Result<bool, SessionError> {
        let _starting = self.starting(id).await;
        {
            let mut tasks = self.tasks();
            if let Some(handle) = tasks.own(id, self.tenant()) {
                let waits = 0 < handle.waiting.load(Ordering::Acquire);
                if waits || handle.started.elapsed() < STAY {
                    return Ok(false);
                }
                // Later commits of its task are left out, because the session then has another
                // fence.
                tasks.handles.remove(id);
            }
        }
        let row = self.row(id).await?;
        match self.store().claim(row.key).await {
            Ok(Claim::Own) => self.store().release(row.key).await.map(|()| true),
            // The session belonged to no live node.
            Ok(Claim::Taken) => Ok(false),
            Err(error) => Err(error),
        }
        .map_err(Into::into)
    }
}
