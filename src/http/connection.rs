//! One connection: serves its requests, and closes it when its peer is too slow.

use std::convert::Infallible;
use std::io;
use std::net::IpAddr;
use std::pin::{Pin, pin};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use hyper::body::Incoming;
use hyper::rt::{Read, ReadBufCursor, Write};
use hyper::service::service_fn;
use hyper::{Request, Version};
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::watch;
use tokio::time::{Instant, sleep, sleep_until};
use tower::ServiceExt;

use super::answer::{Answer, PART_BYTES, WaitingAnswers};
use super::unread::{self, Discards};

/// Largest head of a request (bytes).
const HEAD_BYTES: usize = 16 << 10;
/// HTTP/2 flow-control windows (bytes): of a connection, and of a stream. A peer may send this many
/// bytes before a request reads them.
const WINDOWS_BYTES: [u32; 2] = [512 << 10, 256 << 10];
/// Most bytes of answers that one stream buffers for a slow reader.
const SEND_BYTES: usize = 256 << 10;
/// Most concurrent requests of one HTTP/2 connection.
const STREAMS: u32 = 128;
/// Interval of pings to a peer of HTTP/2, and the time within which it must answer.
const PING_INTERVAL: Duration = Duration::from_secs(20);
const PING_TIMEOUT: Duration = Duration::from_secs(20);
/// Slowest rate of a reader (bytes/s).
const RATE_MIN: u64 = 16 << 10;
/// Interval at which a connection that serves a request is checked.
const LOOK_INTERVAL: Duration = Duration::from_secs(5);
/// Time that a connection has for its shutdown.
const END_TIMEOUT: Duration = Duration::from_secs(1);

/// The other end of a request's connection.
#[derive(Clone, Copy, Debug)]
pub(super) struct Peer {
    pub(super) address: IpAddr,
    /// Whether the connection has TLS.
    pub(super) is_encrypted: bool,
    /// Whether it was accepted while the service stops.
    pub(super) is_late: bool,
}

/// Longest times that a connection waits for its peer.
#[derive(Clone, Copy, Debug)]
pub(super) struct ConnectionPatience {
    /// Time for the head of the first request, and for the rest of a head that has begun.
    pub(super) head: Duration,
    /// Time until the next request.
    pub(super) idle: Duration,
    /// Time without progress of an answer.
    pub(super) silence: Duration,
}

/// The present activity of a connection. Times are in ms since it was opened, 0 for none.
#[derive(Debug)]
struct Activity {
    opened: Instant,
    /// Number of requests that are being served.
    running: AtomicUsize,
    /// When the last request ended.
    ended_ms: AtomicU64,
    /// Time since which the peer has read nothing of an answer.
    blocked_ms: AtomicU64,
    /// When the head of the next request began. It is known for HTTP/1 only, where the peer sends
    /// nothing but requests.
    head_ms: AtomicU64,
    is_http1: AtomicBool,
    /// Number of requests so far.
    requests: AtomicU64,
    /// Answers whose reader reads nothing.
    waiting: Arc<WaitingAnswers>,
    /// Bodies that no call reads any more.
    discards: Discards,
}

/// A request that is being served. Dropping it marks its end.
struct Running(Arc<Activity>);

impl Activity {
    fn now_ms(&self) -> u64 {
        (self.opened.elapsed().as_millis() as u64).max(1)
    }

    fn begin(self: &Arc<Self>, version: Version) -> Running {
        self.is_http1.store(version < Version::HTTP_2, Ordering::Release);
        self.head_ms.store(0, Ordering::Release);
        self.running.fetch_add(1, Ordering::AcqRel);
        Running(self.clone())
    }

    fn is_running(&self) -> bool {
        0 < self.running.load(Ordering::Acquire)
    }

    /// When the connection is closed if nothing changes; `None` if it is not to be closed.
    fn deadline(&self, patience: &ConnectionPatience) -> Option<Instant> {
        let after = |ms: u64, wait: Duration| self.opened + Duration::from_millis(ms) + wait;
        let blocked_ms = self.blocked_ms.load(Ordering::Acquire);
        if 0 < blocked_ms {
            return Some(after(blocked_ms, patience.silence));
        }
        if self.is_running() {
            // As for a body: twice the silence, plus the time for the part that was passed on.
            let part = Duration::from_secs(PART_BYTES as u64 / RATE_MIN);
            let wait = patience.silence + patience.silence + part;
            return self.waiting.since().map(|since| since + wait);
        }
        if self.discards.is_any() {
            return None; // Discards have a limit of time of their own.
        }
        let ended_ms = self.ended_ms.load(Ordering::Acquire);
        let head_ms = self.head_ms.load(Ordering::Acquire);
        match (ended_ms, head_ms) {
            (0, _) => Some(after(0, patience.head)),
            (_, 0) => Some(after(ended_ms, patience.idle)),
            _ => Some(after(head_ms, patience.head)),
        }
    }
}

impl Running {
    /// The body of its answer. The body keeps the request until it is dropped.
    fn answer(self, body: Body) -> Body {
        let Self(activity) = &self;
        let number = activity.requests.fetch_add(1, Ordering::Relaxed);
        let waiting = activity.waiting.clone();
        Answer::body(body, (number, waiting), self)
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let Self(activity) = self;
        activity.ended_ms.store(activity.now_ms(), Ordering::Release);
        activity.running.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Serves the requests of `stream` until it ends, its peer is too slow, or `stopping` is true.
pub(super) async fn serve_connection(
    (stream, peer): (impl AsyncRead + AsyncWrite + Send + Unpin + 'static, Peer),
    router: Router,
    patience: ConnectionPatience,
    mut stopping: watch::Receiver<bool>,
) {
    let activity = Arc::new(Activity {
        opened: Instant::now(),
        running: AtomicUsize::new(0),
        ended_ms: AtomicU64::new(0),
        blocked_ms: AtomicU64::new(0),
        head_ms: AtomicU64::new(0),
        is_http1: AtomicBool::new(false),
        requests: AtomicU64::new(0),
        waiting: Arc::default(),
        discards: Discards::default(),
    });
    let of_service = activity.clone();
    let service = service_fn(move |mut request: Request<Incoming>| {
        request.extensions_mut().insert(peer);
        let (running, router) = (of_service.begin(request.version()), router.clone());
        let discards = of_service.discards.clone();
        async move {
            let response = router.oneshot(unread::body(request, &discards)).await?;
            Ok::<_, Infallible>(response.map(|body| running.answer(body)))
        }
    });
    let io = Watched { io: TokioIo::new(stream), activity: activity.clone() };
    let builder = builder(&patience);
    let mut connection = pin!(builder.serve_connection(io, service));
    let must_close = async {
        loop {
            match activity.deadline(&patience) {
                Some(deadline) if deadline <= Instant::now() => return,
                Some(deadline) => sleep_until(deadline.min(Instant::now() + LOOK_INTERVAL)).await,
                None => sleep(LOOK_INTERVAL).await,
            }
        }
    };
    let stopped = async {
        // Err: the server has ended, too.
        stopping.wait_for(|stopping| *stopping).await.ok();
    };
    tokio::select! {
        // Err: the peer violated the protocol or ended the connection. Nobody waits for an answer.
        _ = connection.as_mut() => return,
        () = must_close => {}
        () = stopped => {}
    }
    connection.as_mut().graceful_shutdown();
    let waits_in_vain = async {
        loop {
            sleep(END_TIMEOUT).await;
            let is_late = activity.deadline(&patience).is_some_and(|at| at <= Instant::now());
            if !activity.is_running() || is_late {
                return;
            }
        }
    };
    tokio::select! {
        _ = connection.as_mut() => {}
        () = waits_in_vain => {}
    }
}

fn builder(patience: &ConnectionPatience) -> auto::Builder<TokioExecutor> {
    let mut builder = auto::Builder::new(TokioExecutor::new());
    let [of_connection, of_stream] = WINDOWS_BYTES;
    builder
        .http1()
        .timer(TokioTimer::new())
        .header_read_timeout(patience.head.max(patience.idle))
        .max_buf_size(HEAD_BYTES)
        .http2()
        .timer(TokioTimer::new())
        .initial_connection_window_size(of_connection)
        .initial_stream_window_size(of_stream)
        .max_send_buf_size(SEND_BYTES)
        .max_header_list_size(HEAD_BYTES as u32)
        .max_concurrent_streams(STREAMS)
        .keep_alive_interval(PING_INTERVAL)
        .keep_alive_timeout(PING_TIMEOUT);
    builder
}

/// A stream that records since when its peer has read nothing.
struct Watched<I> {
    io: I,
    activity: Arc<Activity>,
}

impl<I> Watched<I> {
    fn note<T>(&self, outcome: &Poll<T>) {
        let blocked_ms = &self.activity.blocked_ms;
        match outcome {
            Poll::Ready(_) => blocked_ms.store(0, Ordering::Release),
            Poll::Pending => {
                let now = self.activity.now_ms();
                // Err: it was already blocked.
                blocked_ms.compare_exchange(0, now, Ordering::AcqRel, Ordering::Acquire).ok();
            }
        }
    }
}

impl<I: Read + Unpin> Read for Watched<I> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: ReadBufCursor<'_>,
    ) -> Poll<io::Result<()>> {
        let outcome = Pin::new(&mut self.io).poll_read(context, buffer);
        let Activity { is_http1, head_ms, discards, .. } = &*self.activity;
        let is_between = !self.activity.is_running() && !discards.is_any();
        if outcome.is_ready() && is_http1.load(Ordering::Acquire) && is_between {
            let now = self.activity.now_ms();
            // Err: the head had already begun.
            head_ms.compare_exchange(0, now, Ordering::AcqRel, Ordering::Acquire).ok();
        }
        outcome
    }
}

impl<I: Write + Unpin> Write for Watched<I> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let outcome = Pin::new(&mut self.io).poll_write(context, bytes);
        self.note(&outcome);
        outcome
    }

    // With TLS a write fills the buffer of the encryption, and a flush waits for the peer. Without
    // TLS a flush is ready at once. It comes after the writes, so it hides no pending write.
    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let outcome = Pin::new(&mut self.io).poll_flush(context);
        self.note(&outcome);
        outcome
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.io).poll_shutdown(context)
    }

    fn is_write_vectored(&self) -> bool {
        self.io.is_write_vectored()
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let outcome = Pin::new(&mut self.io).poll_write_vectored(context, slices);
        self.note(&outcome);
        outcome
    }
}
