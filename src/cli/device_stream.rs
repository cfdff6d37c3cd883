//! A device's stream of one session: sends within the credit, keeps what is not durable yet, and
//! opens another stream where one ended.

use std::collections::VecDeque;
use std::future::pending;
use std::time::Duration;

use prost::Message;
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep, sleep_until};
use tokio_stream::wrappers::ReceiverStream;
use tonic::metadata::MetadataValue;
use tonic::{Request, Status, Streaming};

use crate::contract::v1;
use crate::refusal::Code;

use super::Failure;
use super::cargo::{Amount, Answer, Cargo, Opening};
use super::connection::{Connection, Retry};

/// Messages between the device and its connection, at most.
const WAITING: usize = 512;
/// Messages that wait for credit, at most, before a device reads on.
const AHEAD: usize = 8;
/// Part of the service's patience after which a silent device sends a message without content.
const KEEP_OPEN: f64 = 0.3;
/// Header that names the session to a balancer.
const SESSION: &str = "x-graphfix-session";

/// The device's side of the streams of one session, one after another.
pub(super) struct DeviceStream<C: Cargo> {
    connection: Connection,
    cargo: C,
    session: String,
    answers: v1::Answers,
    /// What is neither durable nor refused yet, in the order in which it is sent.
    kept: VecDeque<Kept<C::Request>>,
    open: Option<Open<C>>,
    /// An answer that has been received and not been returned.
    ready: Option<Acknowledged>,
    /// Number of the last answered epoch, 0 before the first. The answers after it are sent again
    /// on the next stream.
    answered: u64,
    retry: Retry,
    breaks: usize,
}

/// A message that is not durable yet.
struct Kept<R> {
    request: R,
    amount: Amount,
    /// It is settled once the service has stored or refused epochs, or stored bytes, up to this
    /// number.
    through: u64,
    /// Whether it has more than the messages before: the end of a receiver's stream may have not.
    is_new: bool,
    /// When it was due.
    due: Instant,
}

/// An open stream.
struct Open<C: Cargo> {
    /// `None` once the device has closed its side.
    sender: Option<mpsc::Sender<C::Request>>,
    answers: Streaming<C::Response>,
    credit: Amount,
    sent: Amount,
    /// Number of kept messages that this stream has carried.
    carried: usize,
    idle: Duration,
    last_sent: Instant,
    /// Delay before the next stream, if the service stops.
    pause: Option<Duration>,
}

/// What an answer acknowledges.
#[derive(Debug, Default)]
pub(super) struct Acknowledged {
    pub(super) results: Vec<v1::StreamResult>,
    /// Times from when each message was due to its acknowledgement.
    pub(super) delays: Vec<Duration>,
}

/// What [`DeviceStream::next`] waited for.
pub(super) enum Next {
    Acknowledged(Acknowledged),
    /// The time has come.
    Due,
}

impl<C: Cargo> DeviceStream<C> {
    /// The streams of a session; the first opens by [`Self::open`], or when something is sent.
    /// `answered` is the number of the last epoch whose answer the device has, 0 if it has none.
    pub(super) fn new(
        (connection, cargo): (&Connection, C),
        session: &str,
        answers: v1::Answers,
        answered: u64,
    ) -> Self {
        Self {
            connection: connection.clone(),
            cargo,
            session: session.to_owned(),
            answers,
            kept: VecDeque::new(),
            open: None,
            ready: None,
            answered,
            retry: connection.retry(),
            breaks: 0,
        }
    }

    /// Opens the first stream.
    ///
    /// # Errors
    /// As of [`Self::next`].
    pub(super) async fn open(&mut self) -> Result<(), Failure> {
        if self.open.is_none() { self.reopen().await } else { Ok(()) }
    }

    /// Whether everything that was sent is durable or refused.
    pub(super) fn is_settled(&self) -> bool {
        self.kept.is_empty() && self.ready.is_none()
    }

    /// Whether the service is not far behind, so that more should be sent.
    pub(super) fn has_room(&self) -> bool {
        let carried = self.open.as_ref().map_or(0, |open| open.carried);
        self.kept.len() - carried < AHEAD
    }

    /// Sends a message of `count` epochs or chunks, which was due at `due`, as soon as the credit
    /// allows it. It is durable when the service has stored epochs, or bytes, up to `through`.
    pub(super) fn send(&mut self, request: C::Request, count: u64, through: u64, due: Instant) {
        let amount = Amount { count, bytes: request.encoded_len() as u64 };
        let is_new = self.kept.back().is_none_or(|last| last.through < through);
        self.kept.push_back(Kept { request, amount, through, is_new, due });
        self.transmit();
    }

    /// The next answer, or [`Next::Due`] at `due` if none comes before. After a break it first
    /// opens another stream, however long this takes.
    ///
    /// # Errors
    /// The service refuses the stream, or does not answer again.
    pub(super) async fn next(&mut self, due: Option<Instant>) -> Result<Next, Failure> {
        loop {
            if self.open.is_none() && !self.kept.is_empty() {
                self.reopen().await?;
            }
            if let Some(acknowledged) = self.ready.take() {
                return Ok(Next::Acknowledged(acknowledged));
            }
            let Some(open) = &mut self.open else {
                at(due).await;
                return Ok(Next::Due);
            };
            let silent_until = open.last_sent + open.idle.mul_f64(KEEP_OPEN);
            tokio::select! {
                answer = open.answers.message() => match answer {
                    Ok(Some(response)) => {
                        let acknowledged = self.take(C::read(response), false);
                        return Ok(Next::Acknowledged(acknowledged));
                    }
                    Ok(None) => self.after_end().await,
                    Err(status) => self.after_break(&status).await?,
                },
                () = at(due) => return Ok(Next::Due),
                () = sleep_until(silent_until) => open.keep_open(),
            }
        }
    }

    /// Waits until everything is durable or refused, and hands each answer to `count`.
    ///
    /// # Errors
    /// As of [`Self::next`].
    pub(super) async fn settle(
        &mut self,
        mut count: impl FnMut(Acknowledged),
    ) -> Result<(), Failure> {
        while !self.is_settled() {
            if let Next::Acknowledged(acknowledged) = self.next(None).await? {
                count(acknowledged);
            }
        }
        Ok(())
    }

    /// Waits until everything is durable or refused, closes this side, and reads the last answers.
    /// Returns how many streams ended before.
    ///
    /// # Errors
    /// As of [`Self::next`].
    pub(super) async fn close(
        mut self,
        mut count: impl FnMut(Acknowledged),
    ) -> Result<usize, Failure> {
        self.settle(&mut count).await?;
        let breaks = self.breaks;
        if let Some(open) = &mut self.open {
            open.sender = None;
        }
        // Err: everything is settled, so a break at the end loses nothing.
        while let Some(open) = &mut self.open
            && let Ok(Some(response)) = open.answers.message().await
        {
            count(self.take(C::read(response), false));
        }
        Ok(breaks)
    }

    /// Sends what the credit allows.
    fn transmit(&mut self) {
        let Some(open) = &mut self.open else { return };
        while let Some(kept) = self.kept.get(open.carried) {
            if !open.try_send(&kept.request, kept.amount) {
                return;
            }
            open.carried += 1;
        }
    }

    /// Opens another stream, and reads its first answer.
    async fn reopen(&mut self) -> Result<(), Failure> {
        loop {
            match self.try_open().await {
                Ok(answer) => {
                    self.ready = Some(self.take(answer, true));
                    return self.check_credit();
                }
                Err(status) => self.retry.wait(&status).await?,
            }
        }
    }

    async fn try_open(&mut self) -> Result<Answer, Status> {
        let opening =
            Opening { session: &self.session, answers: self.answers, acknowledged: self.answered };
        let (sender, messages) = mpsc::channel(WAITING);
        let first = self.cargo.opening(opening);
        sender.try_send(first).map_err(|_| Status::internal("a new channel is full"))?;
        let mut request = Request::new(ReceiverStream::new(messages));
        let session = MetadataValue::try_from(&*self.session);
        let session = session.map_err(|_| Status::invalid_argument("not a session's id"))?;
        request.metadata_mut().insert(SESSION, session);
        let mut client = self.connection.positioning();
        let mut answers = C::open(&mut client, request).await?.into_inner();
        let first = answers.message().await?;
        let first = first.ok_or_else(|| Status::unavailable("the stream ended at once"))?;
        let answer = C::read(first);
        self.open = Some(Open {
            sender: Some(sender),
            answers,
            credit: answer.credit,
            sent: Amount::default(),
            carried: 0,
            idle: Duration::from_secs_f64(answer.idle_s.unwrap_or(60.0).clamp(0.1, 86_400.0)),
            last_sent: Instant::now(),
            pause: None,
        });
        Ok(answer)
    }

    /// A message that exceeds the credit of a new stream could never be sent.
    fn check_credit(&self) -> Result<(), Failure> {
        let (Some(open), Some(first)) = (&self.open, self.kept.front()) else { return Ok(()) };
        if open.pause.is_some() || first.amount.is_within(open.credit) {
            return Ok(());
        }
        let Amount { count, bytes } = open.credit;
        let message = format!("the service takes {count} epochs and {bytes} bytes at a time");
        Err(Failure::new(Code::CreditExceeded, message, "raise limits.stream_bytes there"))
    }

    /// Drops what is settled, and sends what the credit allows.
    fn take(&mut self, answer: Answer, is_first: bool) -> Acknowledged {
        let now = Instant::now();
        let mut acknowledged = Acknowledged { results: answer.results, ..Default::default() };
        self.retry = self.connection.retry();
        let mut carried = self.open.as_ref().map_or(0, |open| open.carried);
        while let Some(kept) = self.kept.pop_front_if(|kept| {
            let is_known = if is_first { kept.is_new } else { 0 < carried };
            is_known && Some(kept.through) <= answer.through
        }) {
            acknowledged.delays.push(now - kept.due);
            carried = carried.saturating_sub(1);
        }
        let stored = acknowledged.results.iter().filter(|result| result.refusal.is_none());
        self.answered = stored.map(|result| result.seq).fold(self.answered, u64::max);
        if let Some(open) = &mut self.open {
            (open.carried, open.credit) = (carried, answer.credit);
            if let Some(ending) = answer.ending {
                let pause_s = ending.retry_after_s.clamp(0.0, 60.0);
                open.pause = Some(Duration::from_secs_f64(pause_s));
                open.sender = None;
            }
        }
        self.transmit();
        acknowledged
    }

    /// The service has ended the stream, as one that stops does.
    async fn after_end(&mut self) {
        self.breaks += 1;
        let pause = self.open.take().and_then(|open| open.pause);
        sleep(pause.unwrap_or_default()).await;
    }

    /// The stream has ended with an error.
    async fn after_break(&mut self, status: &Status) -> Result<(), Failure> {
        self.breaks += 1;
        match self.open.take().and_then(|open| open.pause) {
            Some(pause) => sleep(pause).await,
            None => self.retry.wait(status).await?,
        }
        Ok(())
    }
}

impl<C: Cargo> Open<C> {
    /// Sends a message if the credit and the connection allow it. Returns whether they do.
    fn try_send(&mut self, request: &C::Request, amount: Amount) -> bool {
        let sent = self.sent.plus(amount);
        let Some(sender) = self.sender.as_ref().filter(|_| sent.is_within(self.credit)) else {
            return false;
        };
        if sender.try_send(request.clone()).is_err() {
            return false;
        }
        (self.sent, self.last_sent) = (sent, Instant::now());
        true
    }

    /// Sends a message without content.
    fn keep_open(&mut self) {
        let empty = C::Request::default();
        self.try_send(&empty, Amount { count: 0, bytes: empty.encoded_len() as u64 });
        // Also if it was not sent: then the credit is used up, and answers are due.
        self.last_sent = Instant::now();
    }
}

/// Waits until then, or for ever.
async fn at(due: Option<Instant>) {
    match due {
        Some(due) => sleep_until(due).await,
        None => pending().await,
    }
}
