//! The spans of requests: which requests are traced, and the content of their spans.

use std::time::Instant;

use axum::extract::Request;
use axum::response::Response;

use crate::contract::access::{Call, Target};
use crate::contract::{Lease, Outcome, Service};
use crate::traces::{Trace, TraceContext, TraceSpan, Work};

/// Header with the span of the caller (W3C Trace Context).
const CALLER: &str = "traceparent";

/// The span of an admitted request, if it is traced. Spans of the work for it are its children.
pub(super) fn begun(
    service: &Service,
    target: &Target,
    request: &Request,
    lease: &Lease,
    since: Instant,
) -> Option<TraceSpan> {
    let (tracer, Target::Call(call)) = (service.tracer()?, target) else { return None };
    let caller = request.headers().get(CALLER).and_then(|header| header.to_str().ok());
    let caller = caller.and_then(TraceContext::parse);
    let pass = lease.pass()?; // Health, pages and the like have none, and no trace.
    let mut span = tracer.begin(Work::Request, caller, since)?;
    let Call { grpc, rest, .. } = call;
    span.name(if grpc.is_empty() { rest } else { grpc });
    if !rest.is_empty() {
        span.set("graphfix.rest", rest);
    }
    let id = lease.request_id().to_string();
    span.set("graphfix.tenant", pass.tenant());
    span.set("graphfix.request_id", &id);
    let (tracer, context) = (tracer.clone(), span.context());
    lease.set_trace(Trace { tracer, context, request_id: id.into() });
    Some(span)
}

/// Ends a span with the head of the answer.
pub(super) fn ended(span: Option<TraceSpan>, response: &Response, outcome: Outcome) {
    let Some(mut span) = span else { return };
    span.set("http.response.status_code", response.status().as_u16());
    if let Some(status) = response.headers().get("grpc-status").and_then(|s| s.to_str().ok()) {
        span.set("rpc.response.status_code", status);
    }
    if outcome == Outcome::Failed {
        span.fail();
    }
}
