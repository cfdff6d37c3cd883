//! Calls of the desk for streams: pushes that do not wait for their answers, and the stored
//! answers that a device has missed.

use tokio::sync::oneshot;

use crate::store::{Revisions, SolutionQuery};

use super::answers::{Answers, Reply};
use super::desk::Sessions;
use super::task::{Message, RawSubmission, Submission};
use super::{
    RawChunk, RawReceived, SequencedEpoch, SessionError, SessionId, SessionInfo, SolutionPage,
    Submitted,
};

/// A push of a stream, before the session's mailbox takes it.
pub struct StreamedPush {
    message: Option<Message>,
    epochs: usize,
}

impl StreamedPush {
    /// Number of its epochs; zero for a chunk, whose epochs are unknown before it is decoded.
    pub(crate) fn known_epochs(&self) -> usize {
        match &self.message {
            Some(Message::Submission(submission)) => submission.epochs.len(),
            _ => 0,
        }
    }

    /// Drops the push, which was not posted, without an answer.
    pub(crate) fn cancel(self) {
        if let Some(message) = self.message {
            message.cancel();
        }
    }
}

impl Sessions {
    /// A push of epochs, whose answer goes to `answers`.
    ///
    /// # Errors
    /// There is no epoch, there are more than in one push, or the tenant has used up a quota.
    pub(crate) fn streamed_epochs(
        &self,
        epochs: Vec<SequencedEpoch>,
        answers: &Answers<Submitted>,
    ) -> Result<StreamedPush, SessionError> {
        self.admit_push(&epochs)?;
        let count = epochs.len();
        let submission = Submission { epochs, permit: None, reply: answers.reply() };
        Ok(StreamedPush { message: Some(Message::Submission(submission)), epochs: count })
    }

    /// A push of a chunk of raw bytes, whose answer goes to `answers`.
    ///
    /// # Errors
    /// The chunk is too large, or the tenant has used up a quota.
    pub(crate) fn streamed_chunk(
        &self,
        chunk: RawChunk,
        answers: &Answers<RawReceived>,
    ) -> Result<StreamedPush, SessionError> {
        let epochs = self.admit_chunk(&chunk)?;
        let submission = RawSubmission { chunk, permit: None, reply: answers.reply() };
        Ok(StreamedPush { message: Some(Message::Raw(Box::new(submission))), epochs })
    }

    /// Puts a push into the session's mailbox. Pushes of consecutive calls are answered in this
    /// order.
    ///
    /// # Errors
    /// The mailbox does not take the push now, or never will. The push stays and may be tried
    /// again.
    pub(crate) async fn post_streamed(
        &self,
        id: &SessionId,
        push: &mut StreamedPush,
    ) -> Result<(), SessionError> {
        let epochs = push.known_epochs();
        self.send(id, &mut push.message, push.epochs).await?;
        self.meter().count_epochs(epochs);
        Ok(())
    }

    /// A session, read after everything in its mailbox is committed. So no push of an earlier,
    /// broken stream is still waiting.
    ///
    /// # Errors
    /// No session has this id, or the store fails.
    pub(crate) async fn settled(&self, id: &SessionId) -> Result<SessionInfo, SessionError> {
        if self.has_waiting(id) {
            let (reply, answer) = oneshot::channel();
            let reply = Reply::Call(reply);
            let last = Message::Submission(Submission { epochs: Vec::new(), permit: None, reply });
            self.send(id, &mut Some(last), 0).await?;
            answer.await.unwrap_or(Err(SessionError::Interrupted))?;
        }
        self.get(id).await
    }

    /// The first `count` stored answers, revision 0, to epochs after number `seq`.
    ///
    /// # Errors
    /// No session has this id, or the store fails.
    pub(crate) async fn answers_after(
        &self,
        id: &SessionId,
        seq: u64,
        count: usize,
    ) -> Result<SolutionPage, SessionError> {
        let query = SolutionQuery {
            from: None,
            to: None,
            status: None,
            revisions: Revisions::First,
            page_size: count,
            page_token: Some(format!("{seq}.0")),
        };
        self.solutions(id, &query).await
    }
}
