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
    /// Whether it only ends a receiver's stream. It is settled when the service ends a stream that
    /// has carried it: the answer to the message before has the same `through`.
    is_bare_end: bool,
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
        let is_bare_end = C::is_bare_end(&request);
        self.kept.push_back(Kept { request, amount, through, is_bare_end, due });
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
                    Ok(None) => match self.take_end() {
                        Some(acknowledged) => return Ok(Next::Acknowledged(acknowledged)),
                        None => self.after_end().await,
                    },
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
        while !self.is_settled() {
            self.end_side_before_end();
            if let Next::Acknowledged(acknowledged) = self.next(None).await? {
                count(acknowledged);
            }
        }
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

    /// Closes the device's side if only the end of a receiver's stream is not settled yet, and the
    /// open stream has carried it. The service then processes it and ends the stream.
    fn end_side_before_end(&mut self) {
        if self.has_carried_end()
            && let Some(open) = &mut self.open
        {
            open.sender = None;
        }
    }

    /// Takes the end of a stream without an error. It settles the end of a receiver's stream that
    /// the stream has carried, because the service has answered everything before.
    fn take_end(&mut self) -> Option<Acknowledged> {
        if !self.has_carried_end() {
            return None;
        }
        self.open = None;
        let now = Instant::now();
        let delays = self.kept.drain(..).map(|kept| now - kept.due).collect();
        Some(Acknowledged { results: Vec::new(), delays })
    }

    /// Whether the open stream has carried the end of a receiver's stream, and everything else is
    /// settled.
    fn has_carried_end(&self) -> bool {
        let carried = self.open.as_ref().map_or(0, |open| open.carried);
        0 < carried && carried == self.kept.len() && self.kept.iter().all(|kept| kept.is_bare_end)
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
            let is_known = is_first || 0 < carried;
            is_known && !kept.is_bare_end && Some(kept.through) <= answer.through
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

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use bytes::{BufMut, Bytes, BytesMut};
    use http_body_util::StreamBody;
    use hyper::body::Frame;
    use hyper::{HeaderMap, StatusCode};
    use tokio_stream::StreamExt;
    use tonic::codec::BufferSettings;
    use tonic_prost::ProstCodec;

    use super::super::cargo::RawBytes;
    use super::super::connection::Positioning;
    use super::super::trust::TrustArguments;
    use super::*;

    type Frames = mpsc::Sender<Result<Frame<Bytes>, Status>>;

    /// A service in the thread of the test, which stores bytes.
    #[derive(Clone, Copy)]
    struct Service {
        /// Number of streams that break before the end is processed.
        breaks: usize,
        through: u64,
        is_ended: bool,
    }

    thread_local! {
        static SERVICE: Cell<Service> =
            const { Cell::new(Service { breaks: 0, through: 0, is_ended: false }) };
    }

    /// Raw bytes for this service.
    struct Scripted;

    impl Cargo for Scripted {
        type Request = v1::StreamRawRequest;
        type Response = v1::StreamRawResponse;

        const UNIT: &'static str = "chunks";

        fn opening(&self, opening: Opening<'_>) -> Self::Request {
            RawBytes { near: None }.opening(opening)
        }

        async fn open(
            _: &mut Positioning,
            messages: Request<ReceiverStream<Self::Request>>,
        ) -> Result<tonic::Response<Streaming<Self::Response>>, Status> {
            let (frames, body) = mpsc::channel(64);
            tokio::spawn(serve(messages.into_inner(), frames));
            type Codec = ProstCodec<v1::StreamRawRequest, v1::StreamRawResponse>;
            let decoder = Codec::raw_decoder(BufferSettings::default());
            let body = StreamBody::new(ReceiverStream::new(body));
            let answers = Streaming::new_response(decoder, body, StatusCode::OK, None, None);
            Ok(tonic::Response::new(answers))
        }

        fn read(response: Self::Response) -> Answer {
            RawBytes::read(response)
        }

        fn is_bare_end(request: &Self::Request) -> bool {
            RawBytes::is_bare_end(request)
        }
    }

    /// Serves one stream.
    async fn serve(mut messages: ReceiverStream<v1::StreamRawRequest>, frames: Frames) {
        messages.next().await.expect("an opening");
        answer(&frames).await;
        while let Some(message) = messages.next().await {
            let Service { breaks, through, is_ended } = SERVICE.get();
            if message.end && 0 < breaks {
                SERVICE.set(Service { breaks: breaks - 1, through, is_ended });
                frames.send(Err(Status::unavailable("killed"))).await.unwrap();
                return;
            }
            let through = through.max(message.offset + message.content.len() as u64);
            SERVICE.set(Service { breaks, through, is_ended: is_ended || message.end });
            answer(&frames).await;
        }
        let status = HeaderMap::from_iter([("grpc-status".parse().unwrap(), "0".parse().unwrap())]);
        frames.send(Ok(Frame::trailers(status))).await.unwrap();
    }

    async fn answer(frames: &Frames) {
        let credit = v1::StreamRawCredit { chunks: 100, bytes: 1 << 20 };
        let raw_through = SERVICE.get().through;
        let answer =
            v1::StreamRawResponse { raw_through, credit: Some(credit), ..Default::default() };
        let mut frame = BytesMut::new();
        frame.put_u8(0);
        frame.put_u32(answer.encoded_len() as u32);
        answer.encode(&mut frame).unwrap();
        // Err: the client has closed the stream.
        frames.send(Ok(Frame::data(frame.freeze()))).await.ok();
    }

    /// Sends these bytes and their end. Returns the number of breaks.
    async fn sent(service: Service, content: &'static [u8]) -> usize {
        SERVICE.set(service);
        let (trust, patience) = (TrustArguments::default(), Duration::from_secs(10));
        let connection = Connection::to("http://127.0.0.1:9", None, &trust, patience);
        let connection = connection.expect("an address");
        let mut device =
            DeviceStream::new((&connection, Scripted), "ses_1", v1::Answers::Summary, 0);
        let (mut offset, now) = (service.through, Instant::now());
        for (content, end) in [(content, false), (b"".as_slice(), true)] {
            if content.is_empty() && !end {
                continue;
            }
            let content = Bytes::from_static(content);
            let through = offset + content.len() as u64;
            let chunk = v1::StreamRawRequest { opening: None, offset, content, end };
            device.send(chunk, 1, through, now);
            offset = through;
        }
        device.close(|_| ()).await.expect("the service comes back")
    }

    /// The answer to the last bytes does not settle the end of the receiver's stream, nor does a
    /// new stream whose service has all bytes. Without the end, the last epoch would be missing.
    #[tokio::test]
    async fn the_end_of_a_receiver_is_sent_until_it_is_processed() {
        for breaks in 0..3 {
            for (through, content) in [(0, b"0123456789".as_slice()), (10, b"")] {
                let service = Service { breaks, through, is_ended: false };
                assert_eq!(sent(service, content).await, breaks);
                let Service { through, is_ended, .. } = SERVICE.get();
                assert_eq!((through, is_ended), (10, true), "{breaks} breaks");
            }
        }
    }
}
