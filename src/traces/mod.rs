//! Traces for OpenTelemetry: the durations of the parts of a request's work, sent to a collector by
//! OTLP over gRPC.
//!
//! A traced request has a `TraceSpan`, and so has each push in a session's mailbox, with its
//! computation and its commit. All spans of a request have one trace id, which may be the caller's
//! (W3C Trace Context). Spans wait in a queue for `exporter`. If the queue is full, they are
//! counted and dropped, so a slow or absent collector costs only the memory of the queue. Without a
//! collector there is no `Tracer`, and no work is done. A build without the feature `otlp` has no
//! traces.

#[cfg(not(feature = "otlp"))]
mod absent;
#[cfg(feature = "otlp")]
mod context;
mod error;
#[cfg(feature = "otlp")]
mod exporter;
#[cfg(feature = "otlp")]
mod otlp;
#[cfg(feature = "otlp")]
mod span;

use std::sync::Arc;
use std::time::Instant;

use crate::meters::Counter;

#[cfg(not(feature = "otlp"))]
pub(crate) use absent::{Exporter, TraceContext, TraceSpan, Tracer};
#[cfg(feature = "otlp")]
pub(crate) use context::TraceContext;
pub use error::TracesError;
#[cfg(feature = "otlp")]
pub(crate) use exporter::Exporter;
#[cfg(feature = "otlp")]
pub(crate) use span::{TraceSpan, Tracer};

/// The kind of work that a span measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Work {
    /// A request, until the head of its answer. Its name is that of the call.
    Request,
    /// A push: from the mailbox of its session until it is committed.
    Push,
    /// The estimator computes the batch of a push.
    Solve,
    /// The batch of a push becomes durable.
    Commit,
}

/// What happened to the spans. Clones share the counters.
#[derive(Clone, Debug, Default)]
pub(crate) struct TraceMeters {
    /// Spans that the collector has accepted.
    pub(crate) exported: Counter,
    /// Spans that were dropped: the queue was full, or the collector did not accept them.
    pub(crate) dropped: Counter,
}

/// A traced request, for the spans of the work for it.
#[derive(Clone, Debug)]
pub(crate) struct Trace {
    /// Begins the child spans.
    pub(crate) tracer: Tracer,
    /// The span of the request.
    pub(crate) context: TraceContext,
    /// Id of the request.
    pub(crate) request_id: Arc<str>,
}

impl Trace {
    /// The span of a push. A push of a stream has a trace of its own.
    pub(crate) fn push(&self, is_streamed: bool) -> Option<TraceSpan> {
        let mut span = match is_streamed {
            true => self.tracer.begin_linked(Work::Push, self.context),
            false => self.tracer.begin(Work::Push, Some(self.context), Instant::now()),
        }?;
        span.set("graphfix.request_id", &self.request_id);
        Some(span)
    }
}
