//! The phases of a stream, the same for epochs and raw bytes: opening, missed answers, messages and
//! answers, end.

use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use futures::{Stream, StreamExt};
use tokio::time::{Instant, Sleep, sleep_until, timeout};

use crate::contract::places::Place;
use crate::contract::{Caller, Lease, Presenter, Refusal, v1};
use crate::keys::{KeyError, Pass};
use crate::refusal::{Class, Code};
use crate::session::{Answers, SessionError, SessionId, SessionInfo, SolutionPage, StreamedPush};
use crate::store::StoredSolution;

use super::ledger::{Amount, Ledger};

/// Time without an answer after which the service sends an empty one, so that no proxy closes the
/// stream as idle.
const KEEPALIVE: Duration = Duration::from_secs(25);
/// Time between the announcement of the end and the end.
const GRACE: Duration = Duration::from_secs(2);
/// Stored answers that are read at a time.
const PAGE: usize = 32;
/// Memory of a stored answer, as a message and encoded (bytes).
const ANSWER_BYTES: usize = 8 << 10;

/// The content of a stream: epochs or raw bytes.
pub(super) trait Carried: Sized + Send + Sync + 'static {
    type Request: prost::Message + Send;
    type Response: Default + Send;
    type Answer: Send + 'static;

    /// Reads the first message.
    fn open(request: Self::Request) -> Result<Opening<Self>, Refusal>;
    /// Checks the opening against the session, and answers it.
    fn opened(&mut self, info: &SessionInfo, idle_s: f64) -> Result<Self::Response, Refusal>;
    /// The push of a message; `None` without content.
    fn push(
        &self,
        caller: &Caller,
        request: Self::Request,
        answers: &Answers<Self::Answer>,
    ) -> Result<Option<Push>, Refusal>;
    /// Number of epochs or chunks in a message.
    fn count(request: &Self::Request) -> u64;
    /// Number of epochs in a message; zero for a chunk, whose epochs are not known yet.
    fn known_epochs(request: &Self::Request) -> usize;
    /// Adds an answer to a response.
    fn answer(&mut self, caller: &Caller, answer: Self::Answer, response: &mut Self::Response);
    /// Adds a stored answer that the device has missed.
    fn missed(
        &self,
        solution: &StoredSolution,
        presenter: &Presenter<'_>,
        response: &mut Self::Response,
    );
    /// Completes a response with the durable numbers and the credit.
    fn complete(&self, response: &mut Self::Response, credit: Amount);
    /// Adds the announcement of the end.
    fn end(response: &mut Self::Response, ending: v1::StreamEnding);
}

/// The content of the first message.
pub(super) struct Opening<C> {
    pub(super) session: SessionId,
    pub(super) carried: C,
    /// The device asks for the answers to stored epochs after this number.
    pub(super) after: Option<u64>,
}

/// A push with the memory that it uses until it is answered (bytes).
pub(super) struct Push {
    pub(super) push: StreamedPush,
    pub(super) memory: usize,
}

/// The phase of a stream.
enum Phase {
    Opening,
    /// Sends stored answers after one number, through another.
    Missed {
        after: u64,
        through: u64,
    },
    Open,
    Ended,
}

/// A push that waits because the session's mailbox is full.
struct WaitingPush {
    push: StreamedPush,
    until: Instant,
}

/// The next event of a stream.
enum Event<C: Carried, E> {
    Message(Result<C::Request, E>),
    HalfClosed,
    Answers(Vec<Result<C::Answer, SessionError>>),
    KeyEnded(KeyError),
    Draining,
    Time,
}

/// A stream of one session.
pub(super) struct Flow<C: Carried, I, E> {
    caller: Caller,
    messages: I,
    phase: Phase,
    /// The session and the content, set by the opening.
    opened: Option<(SessionId, C)>,
    answers: Answers<C::Answer>,
    ledger: Ledger,
    /// Whether further messages are read.
    is_reading: bool,
    waiting_push: Option<WaitingPush>,
    /// Why the stream ends once everything is answered; `None` if the device closes its side.
    fault: Option<E>,
    drained: Option<Pin<Box<dyn Future<Output = ()> + Send>>>,
    /// The sender of the stream. `key_ended` completes when the sender's key ends.
    pass: Option<Pass>,
    key_ended: Option<Pin<Box<dyn Future<Output = KeyError> + Send>>>,
    /// When the stream ends, once the end is announced.
    end: Option<Instant>,
    /// When the last message arrived, and when the last answer was sent.
    last_received: Instant,
    answered: Instant,
    timer: Pin<Box<Sleep>>,
    /// The lease of the request, which its log names.
    lease: Option<Lease>,
    _place: Option<Place>,
}

impl<C, I, E> Flow<C, I, E>
where
    C: Carried,
    I: Stream<Item = Result<C::Request, E>> + Send + Unpin + 'static,
    E: From<Refusal> + Send + 'static,
{
    /// The answers to `messages`.
    pub(super) fn answers(
        caller: &Caller,
        messages: I,
    ) -> impl Stream<Item = Result<C::Response, E>> + Send + use<C, I, E> {
        let limits = caller.limits();
        let count = limits.stream_epochs.min(limits.mailbox_epochs) as u64;
        let window = Amount { count, bytes: limits.stream_bytes as u64 };
        let now = Instant::now();
        let lease = Lease::current();
        let pass = lease.as_ref().and_then(Lease::pass).cloned();
        let flow = Self {
            messages,
            phase: Phase::Opening,
            opened: None,
            answers: Answers::new(),
            ledger: Ledger::new(window, lease.clone()),
            is_reading: true,
            waiting_push: None,
            fault: None,
            drained: Some(Box::pin(caller.drained())),
            key_ended: pass.as_ref().map(|pass| Box::pin(pass.ended()) as _),
            pass,
            end: None,
            last_received: now,
            answered: now,
            timer: Box::pin(sleep_until(now + KEEPALIVE)),
            caller: caller.clone(),
            lease,
            _place: None,
        };
        futures::stream::unfold(flow, |mut flow| async move {
            let next = match flow.lease.clone() {
                Some(lease) => lease.scope(flow.next()).await,
                None => flow.next().await,
            };
            Some((next?, flow))
        })
    }

    async fn next(&mut self) -> Option<Result<C::Response, E>> {
        let next = match self.phase {
            Phase::Opening => Some(self.open().await),
            Phase::Missed { after, through } => Some(self.missed(after, through).await),
            Phase::Open => match self.ledger.keep_page(0) {
                Ok(()) => self.flow().await,
                Err(refusal) => Some(Err(refusal.into())),
            },
            Phase::Ended => return None,
        };
        // Checked here, too, because the stream may not have waited for its events.
        let ended = self.pass.as_ref().and_then(|pass| pass.check().err());
        match ended.map_or(next, |error| Some(Err(Refusal::from(error).into()))) {
            Some(Ok(response)) => {
                self.answered = Instant::now();
                Some(Ok(response))
            }
            ended => {
                self.phase = Phase::Ended;
                ended
            }
        }
    }

    /// Reads the first message and answers it.
    async fn open(&mut self) -> Result<C::Response, E> {
        let patience = Duration::from_secs(self.caller.limits().head_s);
        let first = timeout(patience, self.messages.next()).await;
        let missing = |message: &str| Refusal::new(Code::InvalidField, message).at("opening");
        let request = match first {
            Err(_) => return Err(missing("no opening arrived in time").into()),
            Ok(None) => return Err(missing("the stream ended before its opening").into()),
            Ok(Some(first)) => first?,
        };
        if self.caller.is_draining() {
            return Err(Refusal::from(SessionError::Draining).into());
        }
        let Opening { session, mut carried, after } = C::open(request)?;
        self._place = Some(self.caller.stream_place()?);
        let info = self.caller.sessions().settled(&session).await.map_err(Refusal::from)?;
        if info.closed_unix_ms.is_some() {
            let closed = SessionError::Closed { id: session.to_string() };
            return Err(Refusal::from(closed).into());
        }
        let mut response = carried.opened(&info, self.caller.limits().stream_idle_s as f64)?;
        carried.complete(&mut response, self.ledger.credit());
        self.phase = match after.zip(info.durable_through) {
            Some((after, through)) if after < through => Phase::Missed { after, through },
            _ => Phase::Open,
        };
        self.last_received = Instant::now();
        self.opened = Some((session, carried));
        Ok(response)
    }

    /// A page of the stored answers that the device has missed.
    async fn missed(&mut self, after: u64, through: u64) -> Result<C::Response, E> {
        let (id, carried) = self.opened.as_mut().expect("an open stream has its session");
        self.ledger.keep_page(PAGE * ANSWER_BYTES)?;
        let page = self.caller.sessions().answers_after(id, after, PAGE).await;
        let SolutionPage { page, output, .. } = page.map_err(Refusal::from)?;
        let has_more = page.next_page_token.is_some();
        let (solutions, presenter) = (page.items, self.caller.presenter(&output));
        let mut response = C::Response::default();
        for solution in solutions.iter().filter(|solution| solution.seq <= through) {
            carried.missed(solution, &presenter, &mut response);
        }
        let last = solutions.last().map(|solution| solution.seq);
        self.phase = match last.filter(|last| *last < through && has_more) {
            Some(after) => Phase::Missed { after, through },
            None => Phase::Open,
        };
        carried.complete(&mut response, self.ledger.credit());
        Ok(response)
    }

    /// The next response of an open stream.
    async fn flow(&mut self) -> Option<Result<C::Response, E>> {
        loop {
            if !self.is_reading && self.ledger.is_settled() && self.waiting_push.is_none() {
                return self.fault.take().map(Err);
            }
            let response = match self.event().await {
                Event::Message(Ok(request)) => self.receive(request).await,
                Event::Message(Err(error)) => self.stop(error),
                Event::HalfClosed => {
                    self.is_reading = false;
                    None
                }
                Event::Answers(answers) => self.answer(answers),
                Event::KeyEnded(error) => return Some(Err(Refusal::from(error).into())),
                Event::Draining => Some(self.announce_end()),
                Event::Time => self.on_time().await,
            };
            if let Some(response) = response {
                return Some(Ok(response));
            }
        }
    }

    /// Waits for the next event. The end of the key has priority, because other events may come
    /// without pause. Then come messages, so that all that have arrived are positioned and answered
    /// together.
    async fn event(&mut self) -> Event<C, E> {
        let deadline = self.deadline();
        if deadline < self.timer.deadline() || self.timer.is_elapsed() {
            self.timer.as_mut().reset(deadline);
        }
        std::future::poll_fn(|context| self.poll_event(context)).await
    }

    fn poll_event(&mut self, context: &mut Context<'_>) -> Poll<Event<C, E>> {
        if let Some(ended) = &mut self.key_ended
            && let Poll::Ready(error) = ended.as_mut().poll(context)
        {
            self.key_ended = None;
            return Poll::Ready(Event::KeyEnded(error));
        }
        if self.reads_on() {
            match self.messages.poll_next_unpin(context) {
                Poll::Ready(Some(message)) => return Poll::Ready(Event::Message(message)),
                Poll::Ready(None) => return Poll::Ready(Event::HalfClosed),
                Poll::Pending => {}
            }
        }
        if let Poll::Ready(answers) = self.answers.poll(context) {
            return Poll::Ready(Event::Answers(answers));
        }
        if let Some(drained) = &mut self.drained
            && drained.as_mut().poll(context).is_ready()
        {
            self.drained = None;
            return Poll::Ready(Event::Draining);
        }
        self.timer.as_mut().poll(context).map(|()| Event::Time)
    }

    /// Whether the next message may be read now.
    fn reads_on(&self) -> bool {
        self.is_reading && self.waiting_push.is_none() && self.ledger.has_room()
    }

    /// The time at which the timer must run next.
    fn deadline(&self) -> Instant {
        let idle = Duration::from_secs(self.caller.limits().stream_idle_s);
        let others = [
            self.reads_on().then(|| self.last_received + idle),
            self.waiting_push.as_ref().map(|push| push.until),
            self.end,
        ];
        others.into_iter().flatten().fold(self.answered + KEEPALIVE, Instant::min)
    }

    /// Handles a message; returns a response if it is answered at once.
    async fn receive(&mut self, request: C::Request) -> Option<C::Response> {
        self.last_received = Instant::now();
        let epochs = C::known_epochs(&request);
        match self.taken(request) {
            Ok(Some(push)) => {
                self.post(push).await;
                None
            }
            Ok(None) => Some(self.completed(C::Response::default())),
            Err(refusal) => {
                self.caller.sessions().counts().count_refused(epochs);
                self.stop(refusal.into())
            }
        }
    }

    /// The push of a message; `None` without content.
    fn taken(&mut self, request: C::Request) -> Result<Option<StreamedPush>, Refusal> {
        let bytes = self.ledger.last_message();
        let bytes = bytes.unwrap_or_else(|| prost::Message::encoded_len(&request)) as u64;
        let amount = Amount { count: C::count(&request), bytes };
        self.ledger.receive(amount)?;
        let (_, carried) = self.opened.as_ref().expect("an open stream has its session");
        let Some(Push { push, memory }) = carried.push(&self.caller, request, &self.answers)?
        else {
            self.ledger.answer_empty(amount)?;
            return Ok(None);
        };
        match self.ledger.keep(amount, memory) {
            Ok(()) => Ok(Some(push)),
            Err(refusal) => {
                self.ledger.forget_newest();
                push.cancel();
                Err(refusal)
            }
        }
    }

    /// Posts a push to the session. If the session's mailbox is full, the push waits, and no
    /// further message is read.
    async fn post(&mut self, mut push: StreamedPush) {
        let (id, _) = self.opened.as_ref().expect("an open stream has its session");
        let Err(error) = self.caller.sessions().post_streamed(id, &mut push).await else { return };
        match error.retry_after().filter(|_| error.code().class() == Class::Exhausted) {
            Some(delay) => {
                self.waiting_push = Some(WaitingPush { push, until: Instant::now() + delay })
            }
            None => {
                self.refuse(push);
                self.stop(Refusal::from(error).into());
            }
        }
    }

    /// Reads no further message: the stream ends with `fault` when everything is answered.
    fn stop(&mut self, fault: E) -> Option<C::Response> {
        self.is_reading = false;
        self.fault.get_or_insert(fault);
        if let Some(waited) = self.waiting_push.take() {
            self.refuse(waited.push);
        }
        None
    }

    /// Drops the newest push, which the session has not taken.
    fn refuse(&mut self, push: StreamedPush) {
        self.ledger.forget_newest();
        self.caller.sessions().counts().count_refused(push.known_epochs());
        push.cancel();
    }

    /// Makes the response for answers that are durable.
    fn answer(&mut self, answers: Vec<Result<C::Answer, SessionError>>) -> Option<C::Response> {
        let mut response = C::Response::default();
        let mut is_empty = true;
        for answer in answers {
            let settled = self.ledger.answer();
            match answer {
                Ok(answer) => {
                    let (_, carried) = self.opened.as_mut().expect("an open stream has a session");
                    carried.answer(&self.caller, answer, &mut response);
                    is_empty = false;
                }
                Err(error) => {
                    // The pushes after it are not answered.
                    self.stop(Refusal::from(error).into());
                    self.ledger.clear();
                }
            }
            if let Err(refusal) = settled {
                self.stop(refusal.into());
            }
        }
        (!is_empty).then(|| self.completed(response))
    }

    fn completed(&self, mut response: C::Response) -> C::Response {
        let (_, carried) = self.opened.as_ref().expect("an open stream has its session");
        carried.complete(&mut response, self.ledger.credit());
        response
    }

    /// Announces the end, which follows after `GRACE`.
    fn announce_end(&mut self) -> C::Response {
        self.end = Some(Instant::now() + GRACE);
        let refusal = Refusal::from(SessionError::Draining);
        let retry_after = refusal.retry_after.unwrap_or_default();
        let mut response = C::Response::default();
        let (code, message) = (refusal.code.name().to_owned(), refusal.message);
        let retry_after_s = retry_after.as_secs_f64();
        C::end(&mut response, v1::StreamEnding { code, message, retry_after_s });
        self.completed(response)
    }

    /// Does the work of the timer: ends the stream, posts a push again, or sends an empty answer.
    async fn on_time(&mut self) -> Option<C::Response> {
        let now = Instant::now();
        let limits = self.caller.limits();
        let idle = Duration::from_secs(limits.stream_idle_s);
        if self.end.take_if(|end| *end <= now).is_some() {
            return self.stop(Refusal::from(SessionError::Draining).into());
        }
        if let Some(waited) = self.waiting_push.take_if(|push| push.until <= now) {
            self.last_received = now;
            self.post(waited.push).await;
            return None;
        }
        if self.reads_on() && self.last_received + idle <= now {
            let message = format!("no message for {} s", limits.stream_idle_s);
            return self.stop(Refusal::new(Code::StreamIdle, message).into());
        }
        let is_silent = self.answered + KEEPALIVE <= now;
        is_silent.then(|| self.completed(C::Response::default()))
    }
}
