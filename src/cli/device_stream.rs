//! A device's stream of one session. It sends within the credit and keeps each message until it is
//! durable. It opens another stream when one has ended.

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

/// Largest number of messages in the queue between the device and its connection.
const WAITING: usize = 512;
/// Largest number of messages that wait for credit. A device with so many reads no more epochs.
const AHEAD: usize = 8;
/// A silent device sends an empty message after this fraction of the service's idle time.
const KEEP_OPEN: f64 = 0.3;
/// Header that names the session to a load balancer.
const SESSION: &str = "x-graphfix-session";

/// The device's side of the streams of one session, one after another.
pub(super) struct DeviceStream<C: Cargo> {
    connection: Connection,
    cargo: C,
    session: String,
    answers: v1::Answers,
    /// Messages that are neither durable nor refused yet, in the order of sending.
    kept: VecDeque<Kept<C::Request>>,
    open: Option<Open<C>>,
    /// An answer that was received and that `next` has not returned yet.
    ready: Option<Acknowledged>,
    /// Number of the last answered epoch, 0 before the first. On the next stream the service sends
    /// the later answers again.
    answered: u64,
    retry: Retry,
    breaks: usize,
}

/// A message that is not durable yet.
struct Kept<R> {
    request: R,
    amount: Amount,
    /// The message is settled when the service has stored or refused epochs, or stored bytes, up
    /// to this number.
    through: u64,
    /// Whether `through` exceeds that of the message before. A receiver's last one may not.
    is_new: bool,
    /// When the message was due.
    due: Instant,
}

/// An open stream.
struct Open<C: Cargo> {
    /// `None` once the device has closed its side.
    sender: Option<mpsc::Sender<C::Request>>,
    answers: Streaming<C::Response>,
    credit: Amount,
    sent: Amount,
    /// Number of messages in `kept` that this stream has sent.
    carried: usize,
    idle: Duration,
    last_sent: Instant,
    /// Delay before the next stream, once the service has announced the end of this one.
    pause: Option<Duration>,
}

/// What an answer acknowledges.
#[derive(Debug, Default)]
pub(super) struct Acknowledged {
    pub(super) results: Vec<v1::StreamResult>,
    /// For each message, the time from when it was due to its acknowledgement.
    pub(super) delays: Vec<Duration>,
}

/// The result of [`DeviceStream::next`].
pub(super) enum Next {
    Acknowledged(Acknowledged),
    /// The time `due` has come before an answer.
    Due,
}

impl<C: Cargo> DeviceStream<C> {
    /// The streams of a session. The first stream opens in [`Self::open`], or when the device
    /// waits. `answered` is the number of the last epoch whose answer the device has, 0 if it has
    /// none.
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
    /// Those of [`Self::next`].
    pub(super) async fn open(&mut self) -> Result<(), Failure> {
        if self.open.is_none() { self.reopen().await } else { Ok(()) }
    }

    /// Whether everything that was sent is durable or refused.
    pub(super) fn is_settled(&self) -> bool {
        self.kept.is_empty() && self.ready.is_none()
    }

    /// Whether few messages wait for credit, so that the device should send more.
    pub(super) fn has_room(&self) -> bool {
        let carried = self.open.as_ref().map_or(0, |open| open.carried);
        self.kept.len() - carried < AHEAD
    }

    /// Sends a message of `count` epochs or chunks as soon as the credit allows it. The message was
    /// due at `due`. It is durable when the service has stored epochs, or bytes, up to `through`.
    pub(super) fn send(&mut self, request: C::Request, count: u64, through: u64, due: Instant) {
        let amount = Amount { count, bytes: request.encoded_len() as u64 };
        let is_new = self.kept.back().is_none_or(|last| last.through < through);
        self.kept.push_back(Kept { request, amount, through, is_new, due });
        self.transmit();
    }

    /// The next answer, or [`Next::Due`] at `due` if no answer comes before. After a break the
    /// device first opens another stream, however long this takes.
    ///
    /// # Errors
    /// The service refuses the stream, or does not come back.
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
    /// Those of [`Self::next`].
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

    /// Waits until everything is durable or refused, closes the device's side, and reads the last
    /// answers. Returns how many streams ended before.
    ///
    /// # Errors
    /// Those of [`Self::next`].
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

    /// Sends the kept messages that the credit allows.
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

    /// Refuses to go on if the first message exceeds the credit of a new stream: the service would
    /// never take it.
    fn check_credit(&self) -> Result<(), Failure> {
        let (Some(open), Some(first)) = (&self.open, self.kept.front()) else { return Ok(()) };
        if open.pause.is_some() || first.amount.is_within(open.credit) {
            return Ok(());
        }
        let Amount { count, bytes } = open.credit;
        let message = format!("the service takes {count} {} and {bytes} bytes at a time", C::UNIT);
        let remedy = match first.amount.count <= count {
            true => "raise limits.stream_bytes there",
            false => "raise limits.stream_epochs and limits.mailbox_epochs there",
        };
        Err(Failure::new(Code::CreditExceeded, message, remedy))
    }

    /// Takes an answer: drops the settled messages, and sends what the credit allows.
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

    /// Waits after the service has ended the stream without an error, as it does before it stops.
    async fn after_end(&mut self) {
        self.breaks += 1;
        let pause = self.open.take().and_then(|open| open.pause);
        sleep(pause.unwrap_or_default()).await;
    }

    /// Waits after the stream has ended with an error.
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
        // Also if the message was not sent: the credit is used up then, so an answer will come.
        self.last_sent = Instant::now();
    }
}

/// Waits until `due`, or for ever without a time.
async fn at(due: Option<Instant>) {
    match due {
        Some(due) => sleep_until(due).await,
        None => pending().await,
    }
}
