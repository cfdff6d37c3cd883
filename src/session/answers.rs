//! The answers to the pushes of a stream. Many pushes may wait for their answers, and the session's
//! task answers them in their order.
//!
//! After the first error the session takes no further push of the stream. Otherwise the epochs
//! after a failed commit would be stored without those of that commit, and the device would not
//! send the missing ones again.

use std::mem;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};

use futures::task::AtomicWaker;
use tokio::sync::oneshot;

use super::SessionError;

/// The answers to the pushes of one stream, at most as many as the stream's credit allows pushes.
#[derive(Debug)]
pub struct Answers<T>(Arc<Shared<T>>);

#[derive(Debug)]
struct Shared<T> {
    waiting: Mutex<Vec<Result<T, SessionError>>>,
    reader: AtomicWaker,
    /// An error was sent as an answer.
    is_broken: AtomicBool,
}

/// Destination of the answer to a message. If it is dropped without an answer, the receiver gets
/// the error that the session's task has ended.
#[derive(Debug)]
pub(super) enum Reply<T> {
    /// To the one call that waits for it.
    Call(oneshot::Sender<Result<T, SessionError>>),
    /// To a stream.
    Stream(StreamReply<T>),
}

/// The reply to one push of a stream.
#[derive(Debug)]
pub(super) struct StreamReply<T> {
    shared: Arc<Shared<T>>,
    is_sent: bool,
}

impl<T> Answers<T> {
    /// An empty queue of answers.
    pub(crate) fn new() -> Self {
        let (waiting, reader, is_broken) = (Mutex::default(), AtomicWaker::new(), false.into());
        Self(Arc::new(Shared { waiting, reader, is_broken }))
    }

    /// All answers that have arrived, in the order of the pushes; at least one. An error is always
    /// the last.
    pub(crate) fn poll(&self, context: &mut Context<'_>) -> Poll<Vec<Result<T, SessionError>>> {
        self.0.reader.register(context.waker());
        let arrived = mem::take(&mut *self.0.waiting());
        if arrived.is_empty() { Poll::Pending } else { Poll::Ready(arrived) }
    }

    /// The reply to a push.
    pub(super) fn reply(&self) -> Reply<T> {
        Reply::Stream(StreamReply { shared: self.0.clone(), is_sent: false })
    }
}

impl<T> Reply<T> {
    /// Whether the answer goes to a stream.
    pub(super) const fn is_streamed(&self) -> bool {
        matches!(self, Self::Stream(_))
    }
}

impl<T> Shared<T> {
    fn waiting(&self) -> MutexGuard<'_, Vec<Result<T, SessionError>>> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn push(&self, answer: Result<T, SessionError>) {
        let is_error = answer.is_err();
        {
            let mut waiting = self.waiting();
            if self.is_broken.load(Ordering::Acquire) {
                return;
            }
            waiting.push(answer);
            self.is_broken.fetch_or(is_error, Ordering::AcqRel);
        }
        self.reader.wake();
    }
}

impl<T> Reply<T> {
    /// Sends the answer. It is lost if the client has disconnected.
    pub(super) fn send(self, answer: Result<T, SessionError>) {
        match self {
            Self::Call(caller) => _ = caller.send(answer),
            Self::Stream(mut reply) => {
                reply.is_sent = true;
                reply.shared.push(answer);
            }
        }
    }

    /// Drops the reply without an answer, because the push was never posted.
    pub(super) fn cancel(self) {
        if let Self::Stream(mut reply) = self {
            reply.is_sent = true;
        }
    }

    /// Whether the push belongs to a stream that takes nothing more.
    pub(super) fn is_broken(&self) -> bool {
        match self {
            Self::Call(_) => false,
            Self::Stream(reply) => reply.shared.is_broken.load(Ordering::Acquire),
        }
    }
}

impl<T> Drop for StreamReply<T> {
    fn drop(&mut self) {
        if !self.is_sent {
            self.shared.push(Err(SessionError::Interrupted));
        }
    }
}

#[cfg(test)]
mod tests {
    use futures::task::noop_waker_ref;

    use super::*;

    fn arrived(answers: &Answers<u32>) -> Vec<Result<u32, &'static str>> {
        let mut context = Context::from_waker(noop_waker_ref());
        let Poll::Ready(arrived) = answers.poll(&mut context) else { return Vec::new() };
        let code = |error: SessionError| error.code().name();
        arrived.into_iter().map(|answer| answer.map_err(code)).collect()
    }

    #[test]
    fn answers_that_arrived_come_together() {
        let answers = Answers::new();
        answers.reply().send(Ok(1));
        answers.reply().send(Ok(2));
        assert_eq!(arrived(&answers), [Ok(1), Ok(2)]);
        assert_eq!(arrived(&answers), []);
    }

    #[test]
    fn nothing_follows_an_error() {
        let answers = Answers::new();
        let [failed, later, last] = [answers.reply(), answers.reply(), answers.reply()];
        failed.send(Err(SessionError::Draining));
        assert!(later.is_broken());
        later.send(Ok(2));
        drop(last);
        assert_eq!(arrived(&answers), [Err("DRAINING")]);
        assert_eq!(arrived(&answers), []);
    }

    #[test]
    fn a_lost_reply_is_an_error() {
        let answers = Answers::<u32>::new();
        drop(answers.reply());
        assert_eq!(arrived(&answers), [Err("INTERRUPTED")]);
    }
}
