//! Traces for OpenTelemetry: how long the parts of a request's work have taken, sent to a collector
//! by OTLP over gRPC.
//!
//! A request that is traced has a `TraceSpan`, and so has each push in a session's mailbox, with
//! its computation and its commit. What belongs together has one trace id, which may be that of the
//! caller (W3C Trace Context). Spans wait in a queue for `exporter`; when it is full they are
//! counted and dropped, so a collector that is slow or gone costs memory for that queue and nothing
//! else. Without a collector there is no `Tracer`, and nothing of this is done. A build without the
//! feature `otlp` can have none.

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

/// What is done.
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

/// What became of the spans. Clones share it.
#[derive(Clone, Debug, Default)]
pub(crate) struct TraceMeters {
    /// The collector has taken them.
    pub(crate) exported: Counter,
    /// The queue was full, or the collector has not taken them.
    pub(crate) dropped: Counter,
}

/// A request that is traced, as what it calls sees it.
#[derive(Clone, Debug)]
pub(crate) struct Trace {
    /// Begins the spans below.
    pub(crate) tracer: Tracer,
    /// The span of the request.
    pub(crate) context: TraceContext,
    /// Id of the request.
    pub(crate) request_id: Arc<str>,
}

impl Trace {
    /// The span of a push; one of a stream has a trace of its own.
    pub(crate) fn push(&self, is_streamed: bool) -> Option<TraceSpan> {
        let mut span = match is_streamed {
            true => self.tracer.begin_linked(Work::Push, self.context),
            false => self.tracer.begin(Work::Push, Some(self.context), Instant::now()),
        }?;
        span.set("graphfix.request_id", &self.request_id);
        Some(span)
    }
}
