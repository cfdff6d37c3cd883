//! Closes and deletes sessions.

use tokio::sync::oneshot;

use super::desk::Sessions;
use super::task::Message;
use super::tasks::Start;
use super::{SessionError, SessionId, SessionInfo};

impl Sessions {
    /// Closes a session. It takes no more epochs, and its stored solutions stay readable. Waiting
    /// epochs are still positioned and stored, and the epochs in the window get their last
    /// revision.
    ///
    /// # Errors
    /// No session has this id, the service is stopping, or the store fails. The session then stays
    /// open.
    pub async fn close(&self, id: &SessionId) -> Result<SessionInfo, SessionError> {
        let (desk, session) = (self.clone(), id.clone());
        // In its own task, so that the session is closed even if the caller disconnects.
        let closing = tokio::spawn(async move { desk.close_whole(&session).await });
        closing.await.unwrap_or(Err(SessionError::Interrupted))?;
        self.get(id).await
    }

    /// Deletes a session with all that it has stored; closes it before, if it is open. Returns it
    /// as it was. From then on it is not found; its space is freed in the background.
    ///
    /// # Errors
    /// No session has this id, the service is stopping, or the store fails; it may then be closed.
    pub async fn delete(&self, id: &SessionId) -> Result<SessionInfo, SessionError> {
        let (info, row) = (self.close(id).await?, self.row(id).await?);
        self.store().delete_session(row.key, self.unix_ms()).await?;
        self.deleted().notify_one();
        Ok(info)
    }

    async fn close_whole(&self, id: &SessionId) -> Result<(), SessionError> {
        let _starting = self.starting(id).lock().await;
        let row = self.row(id).await?;
        if row.closed_unix_ms.is_some() {
            return Ok(());
        }
        if !self.tasks().handles.contains_key(id) {
            self.start(id, &row, Start::Closing)?;
        }
        // Removed first, so that no message follows the closing one.
        let handle = self.tasks().handles.remove(id).ok_or(SessionError::Draining)?;
        let (reply, answer) = oneshot::channel();
        let last = Message::Close { unix_ms: self.unix_ms(), reply };
        handle.mailbox.send(last).await.map_err(|_| SessionError::Interrupted)?;
        drop(handle);
        answer.await.unwrap_or(Err(SessionError::Interrupted))
    }
}
