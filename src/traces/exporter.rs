//! Sends ended spans to the collector, in batches, by one task.
//!
//! A batch that the collector does not accept in time is dropped and counted, because traces are
//! for diagnosis and need not be complete. The log has one line when the collector fails, and one
//! when it works again.

use std::path::Path;
use std::time::{Duration, Instant};

use hyper::Uri;
use hyper_util::rt::TokioIo;
use tokio::sync::mpsc::{self, Receiver};
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio::time::{sleep, timeout};
use tonic::codegen::http::uri::PathAndQuery;
use tonic::transport::{Channel, Endpoint};
use tonic::{Request, Status};
use tonic_prost::ProstCodec;

use crate::clock::unix_ms;
use crate::config::TelemetryConfiguration;
use crate::tls::{ClientFiles, ClientTls};

use super::otlp::{self, ExportRequest, ExportResponse};
use super::span::EndedSpan;
use super::{Tracer, TracesError};

/// Most spans that wait for the collector.
const QUEUE: usize = 4_096;
/// Most spans in a message.
const BATCH: usize = 512;
/// Longest time that a span waits for others in its message.
const INTERVAL: Duration = Duration::from_secs(1);
/// Time for a message to the collector, even at the end of the service.
const TIMEOUT: Duration = Duration::from_secs(5);
const PATH: &str = "/opentelemetry.proto.collector.trace.v1.TraceService/Export";
const NS_PER_MS: u64 = 1_000_000;

/// The task that sends spans.
#[derive(Debug)]
pub(crate) struct Exporter {
    tracer: Tracer,
    stop: watch::Sender<bool>,
    task: JoinHandle<()>,
}

impl Exporter {
    /// Starts to send the spans of a node, if the configuration names a collector. It connects when
    /// there are spans.
    ///
    /// # Errors
    /// The address or the file of authorities is invalid.
    ///
    /// # Panics
    /// Outside a tokio runtime.
    pub(crate) fn start(
        configuration: &TelemetryConfiguration,
        node: &str,
    ) -> Result<Option<Self>, TracesError> {
        let Some(endpoint) = &configuration.otlp_endpoint else { return Ok(None) };
        let channel = channel(endpoint, configuration.otlp_ca_file.as_deref())?;
        let (sender, queue) = mpsc::channel(QUEUE);
        let tracer = Tracer::new(sender, configuration.otlp_ratio);
        let (stop, stopped) = watch::channel(false);
        let client = tonic::client::Grpc::new(channel);
        let (node, has_failed) = (node.to_owned(), false);
        let sending = Sending { client, tracer: tracer.clone(), node, has_failed };
        let task = tokio::spawn(sending.run(queue, stopped));
        Ok(Some(Self { tracer, stop, task }))
    }

    /// The tracer whose spans this task sends.
    pub(crate) const fn tracer(&self) -> &Tracer {
        &self.tracer
    }

    /// Sends the waiting spans, for a limited time, and ends.
    pub(crate) async fn close(self) {
        self.stop.send_replace(true);
        // Err: it panicked, or takes too long; spans may be lost.
        timeout(TIMEOUT + INTERVAL, self.task).await.ok();
    }
}

/// A channel to the collector, which connects when it is first used.
fn channel(endpoint: &str, ca_file: Option<&Path>) -> Result<Channel, TracesError> {
    let invalid =
        |why: &str| TracesError::Endpoint { endpoint: endpoint.to_owned(), why: why.to_owned() };
    let uri: Uri = endpoint.parse().map_err(|_| invalid("this is not an address"))?;
    let (is_tls, port) = match uri.scheme_str() {
        Some("http") => (false, 4317),
        Some("https") => (true, 4317),
        _ => return Err(invalid("it begins with http:// or https://")),
    };
    let host = uri.host().filter(|host| !host.is_empty()).ok_or_else(|| invalid("no host"))?;
    let (host, port) = (host.to_owned(), uri.port_u16().unwrap_or(port));
    if !matches!(uri.path(), "" | "/") {
        return Err(invalid("OTLP over gRPC has no path; name the collector's gRPC port"));
    }
    let tls =
        ClientTls::new(&ClientFiles { ca: ca_file.map(Path::to_owned), identity: None }, b"h2")?;
    let connector = tower::service_fn(move |_: Uri| {
        let (tls, host) = (tls.clone(), host.clone());
        async move {
            let name = is_tls.then_some(&*host);
            tls.connect((&host, port), name).await.map(TokioIo::new)
        }
    });
    let endpoint = Endpoint::from(uri).connect_timeout(TIMEOUT).timeout(TIMEOUT);
    Ok(endpoint.connect_with_connector_lazy(connector))
}

/// The data of the task.
struct Sending {
    client: tonic::client::Grpc<Channel>,
    tracer: Tracer,
    node: String,
    /// The collector has not accepted the last message.
    has_failed: bool,
}

impl Sending {
    /// Sends spans until it is stopped and none is left.
    async fn run(mut self, mut queue: Receiver<EndedSpan>, mut stopped: watch::Receiver<bool>) {
        let mut batch = Vec::with_capacity(BATCH);
        loop {
            let is_stopped = tokio::select! {
                // Err: the exporter was dropped, and with it everything that could trace.
                _ = stopped.wait_for(|stopped| *stopped) => true,
                () = sleep(INTERVAL) => false,
                () = gathered(&mut queue, &mut batch) => false,
            };
            while batch.len() < BATCH
                && let Ok(span) = queue.try_recv()
            {
                batch.push(span);
            }
            if !batch.is_empty() {
                self.send(&batch).await;
                batch.clear();
            } else if is_stopped {
                return;
            }
            if is_stopped && self.has_failed {
                return; // What waits would wait for another timeout each.
            }
        }
    }

    async fn send(&mut self, batch: &[EndedSpan]) {
        let now = (Instant::now(), unix_ms().unsigned_abs() * NS_PER_MS);
        let message = otlp::request(batch, &self.node, now);
        let sent = timeout(TIMEOUT, self.export(message)).await;
        let sent = sent.unwrap_or_else(|_| Err(Status::deadline_exceeded("no answer in time")));
        let count = batch.len() as u64;
        let meters = self.tracer.meters();
        match sent {
            Ok(answer) => {
                let rejected = answer.partial_success.map_or(0, |partial| partial.rejected_spans);
                let rejected = u64::try_from(rejected).unwrap_or(0).min(count);
                meters.exported.inc_by(count - rejected);
                meters.dropped.inc_by(rejected);
                if self.has_failed {
                    tracing::info!("the collector of traces works again");
                }
                self.has_failed = false;
            }
            Err(status) => {
                meters.dropped.inc_by(count);
                if !self.has_failed {
                    let (code, message) = (status.code(), status.message());
                    tracing::warn!(?code, message, "the collector takes no traces; dropping them");
                }
                self.has_failed = true;
            }
        }
    }

    async fn export(&mut self, message: ExportRequest) -> Result<ExportResponse, Status> {
        self.client.ready().await.map_err(|error| Status::unavailable(error.to_string()))?;
        let codec = ProstCodec::<ExportRequest, ExportResponse>::default();
        let path = PathAndQuery::from_static(PATH);
        self.client.unary(Request::new(message), path, codec).await.map(tonic::Response::into_inner)
    }
}

/// Takes spans until a message is full.
async fn gathered(queue: &mut Receiver<EndedSpan>, batch: &mut Vec<EndedSpan>) {
    while batch.len() < BATCH {
        let missing = BATCH - batch.len();
        if queue.recv_many(batch, missing).await == 0 {
            std::future::pending::<()>().await; // No tracer is left.
        }
    }
}
