//! Closes and deletes sessions.

use tokio::sync::oneshot;

use crate::store::{Act, AuditEntry, Author};

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
        self.close_by(id, None).await
    }

    /// Like [`Self::close`], as an act of `author`.
    ///
    /// # Errors
    /// As for [`Self::close`].
    pub(crate) async fn close_by(
        &self,
        id: &SessionId,
        author: Option<&Author>,
    ) -> Result<SessionInfo, SessionError> {
        let entry = author.map(|author| self.entry(author, "Sessions.Close", id, String::new()));
        let (desk, session) = (self.clone(), id.clone());
        // In its own task, so that the session is closed even if the caller disconnects.
        let closing = tokio::spawn(async move { desk.close_whole(&session, entry).await });
        closing.await.unwrap_or(Err(SessionError::Interrupted))?;
        self.get(id).await
    }

    /// Deletes a session with everything that it has stored. An open session is closed first.
    /// Returns the session as it was. It is not found from then on; its space is freed in the
    /// background.
    ///
    /// # Errors
    /// No session has this id, the service is stopping, or the store fails. The session may then
    /// be closed.
    pub async fn delete(&self, id: &SessionId) -> Result<SessionInfo, SessionError> {
        self.delete_by(id, None).await
    }

    /// Like [`Self::delete`], as an act of `author`.
    ///
    /// # Errors
    /// As for [`Self::delete`].
    pub(crate) async fn delete_by(
        &self,
        id: &SessionId,
        author: Option<&Author>,
    ) -> Result<SessionInfo, SessionError> {
        let (info, row) = (self.close_by(id, author).await?, self.row(id).await?);
        let change = format!("label {:?}", info.label);
        let entry = author.map(|author| self.entry(author, "Sessions.Delete", id, change));
        self.store().delete_session(row.key, self.unix_ms(), entry.as_deref()).await?;
        self.deleted().notify_one();
        Ok(info)
    }

    /// The entry in the audit log of an act on a session of the tenant.
    pub(super) fn entry(
        &self,
        author: &Author,
        call: &'static str,
        id: &SessionId,
        change: String,
    ) -> Box<AuditEntry> {
        let act = Act { call, tenant: self.tenant(), object: id.as_str(), change };
        Box::new(author.does(act, self.store().arrival_time(self.unix_ms())))
    }

    async fn close_whole(
        &self,
        id: &SessionId,
        entry: Option<Box<AuditEntry>>,
    ) -> Result<(), SessionError> {
        let _starting = self.starting(id).await;
        let row = self.row(id).await?;
        let key = row.key;
        if row.closed_unix_ms.is_some() {
            // The answer to the commit that closed it may have been lost.
            self.live().publish_closed(key);
            return Ok(());
        }
        if !self.runs(id) {
            let row = self.claimed(row, id).await?;
            self.start(id, row, Start::Closing)?;
        }
        // Removed first, so that no message follows the message that closes.
        let handle = self.tasks().handles.remove(id).ok_or(SessionError::Draining)?;
        let (reply, answer) = oneshot::channel();
        let unix_ms = self.store().arrival_time(self.unix_ms());
        let last = Message::Close { unix_ms, entry, reply };
        handle.mailbox.send(last).await.map_err(|_| SessionError::Interrupted)?;
        drop(handle);
        let closed = answer.await.unwrap_or(Err(SessionError::Interrupted));
        closed.inspect_err(|_| self.confirm_later(id, key))
    }
}
