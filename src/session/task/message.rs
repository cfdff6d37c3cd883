//! The messages in a session's mailbox, and the capacity that they take there.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use crate::session::answers::Reply;
use crate::session::{RawChunk, RawReceived, SequencedEpoch, SessionError, Submitted};
use crate::store::{AuditEntry, RawChange};
use crate::traces::TraceSpan;

/// A message in the mailbox.
pub(in crate::session) enum Message {
    /// A push of epochs.
    Submission(Submission),
    /// A chunk of raw bytes.
    Raw(Box<RawSubmission>),
    /// Begins a new arc at this time (ms since 1970-01-01 UTC).
    Reset {
        unix_ms: i64,
        /// The entry of the audit log for the act.
        entry: Option<Box<AuditEntry>>,
        /// Set when the message is sent.
        permit: Option<MailboxPermit>,
        reply: oneshot::Sender<Result<(), SessionError>>,
    },
    /// The last message: closes the session at this time (ms since 1970-01-01 UTC).
    Close {
        unix_ms: i64,
        /// The entry of the audit log for the act.
        entry: Option<Box<AuditEntry>>,
        reply: oneshot::Sender<Result<(), SessionError>>,
    },
}

/// A push in the mailbox.
pub(in crate::session) struct Submission {
    pub(in crate::session) epochs: Vec<SequencedEpoch>,
    /// Set when the message is sent.
    pub(in crate::session) permit: Option<MailboxPermit>,
    pub(in crate::session) reply: Reply<Submitted>,
}

/// A chunk in the mailbox.
pub(in crate::session) struct RawSubmission {
    pub(in crate::session) chunk: RawChunk,
    /// Set when the message is sent.
    pub(in crate::session) permit: Option<MailboxPermit>,
    pub(in crate::session) reply: Reply<RawReceived>,
}

impl Message {
    /// Whether it belongs to a stream that has ended with an error.
    pub(in crate::session) fn is_broken(&self) -> bool {
        match self {
            Self::Submission(submission) => submission.reply.is_broken(),
            Self::Raw(submission) => submission.reply.is_broken(),
            Self::Reset { .. } | Self::Close { .. } => false,
        }
    }

    /// Whether it belongs to a stream.
    pub(in crate::session) fn is_streamed(&self) -> bool {
        match self {
            Self::Submission(submission) => submission.reply.is_streamed(),
            Self::Raw(submission) => submission.reply.is_streamed(),
            Self::Reset { .. } | Self::Close { .. } => false,
        }
    }

    /// Drops its span, because the mailbox has not taken the message.
    pub(in crate::session) fn forget_trace(&mut self) {
        let permit = match self {
            Self::Submission(submission) => submission.permit.as_mut(),
            Self::Raw(submission) => submission.permit.as_mut(),
            Self::Reset { permit, .. } => permit.as_mut(),
            Self::Close { .. } => None,
        };
        if let Some(span) = permit.and_then(|permit| permit.trace.take()) {
            span.forget();
        }
    }

    /// Drops a message of a stream that will not be posted.
    pub(in crate::session) fn cancel(self) {
        match self {
            Self::Submission(submission) => submission.reply.cancel(),
            Self::Raw(submission) => submission.reply.cancel(),
            Self::Reset { .. } | Self::Close { .. } => {}
        }
    }

    /// Time that a push has waited.
    pub(in crate::session) fn waited(&self) -> Option<Duration> {
        let permit = match self {
            Self::Submission(submission) => submission.permit.as_ref(),
            Self::Raw(submission) => submission.permit.as_ref(),
            Self::Reset { .. } | Self::Close { .. } => None,
        };
        permit.map(|permit| permit.since.elapsed())
    }

    /// Attaches the permit that the message occupies while it waits.
    pub(in crate::session) fn set_permit(&mut self, permit: MailboxPermit) {
        match self {
            Self::Submission(submission) => submission.permit = Some(permit),
            Self::Raw(submission) => submission.permit = Some(permit),
            Self::Reset { permit: own, .. } => *own = Some(permit),
            Self::Close { .. } => {}
        }
    }
}

/// Epochs that have arrived to be positioned and committed.
pub(in crate::session) struct Arrived {
    pub(super) epochs: Vec<SequencedEpoch>,
    /// The raw chunk that the epochs come from.
    pub(super) raw: Option<Box<RawChange>>,
    /// See [`Batch::is_patient`](crate::store::Batch::is_patient).
    pub(super) is_patient: bool,
}

/// The capacity that a message's epochs take while they wait. Dropping it frees the capacity.
pub(in crate::session) struct MailboxPermit {
    epochs: usize,
    /// Whether the push belongs to a stream.
    pub(in crate::session) is_streamed: bool,
    since: Instant,
    of_session: Arc<AtomicUsize>,
    of_all: Arc<AtomicUsize>,
    /// The span of the push, if it is traced; it ends with the permit.
    pub(in crate::session) trace: Option<TraceSpan>,
}

impl MailboxPermit {
    pub(in crate::session) fn take(
        epochs: usize,
        of_session: &Arc<AtomicUsize>,
        of_all: &Arc<AtomicUsize>,
    ) -> Self {
        of_session.fetch_add(epochs, Ordering::AcqRel);
        of_all.fetch_add(epochs, Ordering::AcqRel);
        let (of_session, of_all) = (of_session.clone(), of_all.clone());
        let (is_streamed, trace) = (false, None);
        Self { epochs, is_streamed, since: Instant::now(), of_session, of_all, trace }
    }
}

impl MailboxPermit {
    /// Whether a push belongs to a stream, which goes on without its answer.
    pub(super) fn is_of_stream(permit: &Option<Self>) -> bool {
        permit.as_ref().is_some_and(|permit| permit.is_streamed)
    }

    /// Raises the taken capacity to `epochs` epochs, if the chunk has more than it has taken.
    pub(in crate::session) fn raise_to(&mut self, epochs: usize) {
        if let Some(more) = epochs.checked_sub(self.epochs) {
            self.of_session.fetch_add(more, Ordering::AcqRel);
            self.of_all.fetch_add(more, Ordering::AcqRel);
            self.epochs = epochs;
        }
    }
}

impl Drop for MailboxPermit {
    fn drop(&mut self) {
        self.of_session.fetch_sub(self.epochs, Ordering::AcqRel);
        self.of_all.fetch_sub(self.epochs, Ordering::AcqRel);
    }
}
