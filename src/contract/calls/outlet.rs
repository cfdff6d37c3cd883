//! The channel between a watch and its reader: the task of the watch sends messages, and the
//! reader's side of the connection takes them.
//!
//! A few messages wait for the reader. If the reader takes none of them for some time, the task
//! ends and frees its memory. The reader then gets the waiting messages, and after them a refusal
//! that tells how to continue. When the reader's key ends, waiting messages are not sent.

use std::pin::Pin;
use std::time::Duration;

use futures::StreamExt;
use futures::stream::{self, BoxStream};
use tokio::sync::{mpsc, oneshot};
use tokio::time::timeout;

use crate::contract::{Caller, Lease, Refusal};
use crate::keys::KeyError;
use crate::refusal::Code;

/// Most messages that wait for a reader.
const WAITING: usize = 4;

/// The sending side, for the task of a watch.
pub(super) struct Outlet<T> {
    sender: mpsc::Sender<T>,
    /// Time within which the reader must take a message.
    patience: Duration,
}

/// The two ends of a watch.
pub(super) fn outlet<T: Send + 'static>(caller: &Caller) -> (Outlet<T>, Reader<T>) {
    let (sender, messages) = mpsc::channel(WAITING);
    let patience = Duration::from_secs(caller.limits().body_silence_s);
    let lease = Lease::current();
    let key_ended = lease.as_ref().and_then(Lease::pass).map(|pass| Box::pin(pass.ended()) as _);
    (Outlet { sender, patience }, Reader { messages, ended: None, key_ended })
}

impl<T> Outlet<T> {
    /// Sends a message.
    ///
    /// # Errors
    /// The reader has taken none for too long.
    pub(super) async fn send(&self, message: T) -> Result<(), Refusal> {
        match timeout(self.patience, self.sender.send(message)).await {
            // Err: the reader has disconnected, which ends the watch at its next wait.
            Ok(sent) => {
                sent.ok();
                Ok(())
            }
            Err(_) => {
                let message = format!("no message was read for {} s", self.patience.as_secs());
                Err(Refusal::new(Code::WatchTooSlow, message))
            }
        }
    }

    /// Waits until the reader disconnects.
    pub(super) async fn closed(&self) {
        self.sender.closed().await;
    }

    /// Whether the reader has disconnected.
    pub(super) fn is_closed(&self) -> bool {
        self.sender.is_closed()
    }
}

/// The receiving side, for the reader.
pub(super) struct Reader<T> {
    messages: mpsc::Receiver<T>,
    /// The refusal with which the watch has ended.
    ended: Option<oneshot::Receiver<Refusal>>,
    /// Completes when the reader's key ends.
    key_ended: Option<Pin<Box<dyn Future<Output = KeyError> + Send>>>,
}

impl<T: Send + 'static> Reader<T> {
    /// Runs `watching` in a task until it ends. The stream has its messages, and after them the
    /// refusal with which it has ended.
    pub(super) fn read(
        mut self,
        watching: impl Future<Output = Result<(), Refusal>> + Send + 'static,
    ) -> BoxStream<'static, Result<T, Refusal>> {
        let (end, ended) = oneshot::channel();
        self.ended = Some(ended);
        tokio::spawn(async move {
            if let Err(refusal) = watching.await {
                end.send(refusal).ok(); // Err: the reader has gone.
            }
        });
        let next = |mut reader: Self| async move { Some((reader.next().await?, reader)) };
        stream::unfold(self, next).boxed()
    }

    /// The next message, unless the reader's key ends.
    async fn next(&mut self) -> Option<Result<T, Refusal>> {
        let key_ended = async {
            match &mut self.key_ended {
                Some(ended) => ended.await,
                None => std::future::pending().await,
            }
        };
        let message = tokio::select! {
            biased;
            error = key_ended => Err(error),
            message = self.messages.recv() => Ok(message),
        };
        match message {
            Ok(Some(message)) => return Some(Ok(message)),
            Ok(None) => {}
            Err(error) => {
                (self.key_ended, self.ended) = (None, None);
                self.messages.close();
                while self.messages.try_recv().is_ok() {}
                return Some(Err(error.into()));
            }
        }
        // Err: the watch has ended without a refusal.
        let refusal = self.ended.take()?.await.ok()?;
        Some(Err(refusal))
    }
}
