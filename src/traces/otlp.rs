//! The messages of OTLP that carry spans, with the field numbers of `opentelemetry-proto` 1.x
//! (`collector/trace/v1/trace_service.proto`, `trace/v1/trace.proto`, `common/v1/common.proto`,
//! `resource/v1/resource.proto`). Fields that are not used here are left out.

use std::time::Instant;

use super::Work;
use super::span::EndedSpan;

/// `SPAN_KIND_INTERNAL`.
const INTERNAL: i32 = 1;
/// `SPAN_KIND_SERVER`.
const SERVER: i32 = 2;
/// `STATUS_CODE_ERROR`.
const ERROR: i32 = 2;
/// The flag `sampled` of W3C Trace Context.
const SAMPLED: u32 = 1;

/// `ExportTraceServiceRequest`.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct ExportRequest {
    #[prost(message, repeated, tag = "1")]
    resource_spans: Vec<ResourceSpans>,
}

/// `ExportTraceServiceResponse`.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct ExportResponse {
    #[prost(message, optional, tag = "1")]
    pub(super) partial_success: Option<PartialSuccess>,
}

/// `ExportTracePartialSuccess`.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct PartialSuccess {
    #[prost(int64, tag = "1")]
    pub(super) rejected_spans: i64,
}

#[derive(Clone, PartialEq, prost::Message)]
struct ResourceSpans {
    #[prost(message, optional, tag = "1")]
    resource: Option<Resource>,
    #[prost(message, repeated, tag = "2")]
    scope_spans: Vec<ScopeSpans>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct Resource {
    #[prost(message, repeated, tag = "1")]
    attributes: Vec<KeyValue>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct ScopeSpans {
    #[prost(message, optional, tag = "1")]
    scope: Option<Scope>,
    #[prost(message, repeated, tag = "2")]
    spans: Vec<Span>,
}

/// `InstrumentationScope`.
#[derive(Clone, PartialEq, prost::Message)]
struct Scope {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(string, tag = "2")]
    version: String,
}

#[derive(Clone, PartialEq, prost::Message)]
struct Span {
    #[prost(bytes = "vec", tag = "1")]
    trace_id: Vec<u8>,
    #[prost(bytes = "vec", tag = "2")]
    span_id: Vec<u8>,
    #[prost(bytes = "vec", tag = "4")]
    parent_span_id: Vec<u8>,
    #[prost(string, tag = "5")]
    name: String,
    #[prost(int32, tag = "6")]
    kind: i32,
    #[prost(fixed64, tag = "7")]
    start_time_unix_nano: u64,
    #[prost(fixed64, tag = "8")]
    end_time_unix_nano: u64,
    #[prost(message, repeated, tag = "9")]
    attributes: Vec<KeyValue>,
    #[prost(message, repeated, tag = "13")]
    links: Vec<Link>,
    #[prost(message, optional, tag = "15")]
    status: Option<Status>,
    #[prost(fixed32, tag = "16")]
    flags: u32,
}

#[derive(Clone, PartialEq, prost::Message)]
struct Link {
    #[prost(bytes = "vec", tag = "1")]
    trace_id: Vec<u8>,
    #[prost(bytes = "vec", tag = "2")]
    span_id: Vec<u8>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct Status {
    #[prost(int32, tag = "3")]
    code: i32,
}

#[derive(Clone, PartialEq, prost::Message)]
struct KeyValue {
    #[prost(string, tag = "1")]
    key: String,
    #[prost(message, optional, tag = "2")]
    value: Option<AnyValue>,
}

/// `AnyValue` with a text.
#[derive(Clone, PartialEq, prost::Message)]
struct AnyValue {
    // A member of a oneof is written even if it is empty.
    #[prost(string, optional, tag = "1")]
    string_value: Option<String>,
}

fn attribute(key: &str, value: &str) -> KeyValue {
    let value = Some(AnyValue { string_value: Some(value.to_owned()) });
    KeyValue { key: key.to_owned(), value }
}

/// The message with these spans of a node. `now` is the time at which the clock shows `unix_ns`.
pub(super) fn request(
    spans: &[EndedSpan],
    node: &str,
    (now, unix_ns): (Instant, u64),
) -> ExportRequest {
    let version = env!("CARGO_PKG_VERSION");
    let of_service = [
        attribute("service.name", "graphfix"),
        attribute("service.version", version),
        attribute("service.instance.id", node),
    ];
    let at = |time: Instant| {
        let before = u64::try_from(now.saturating_duration_since(time).as_nanos());
        unix_ns.saturating_sub(before.unwrap_or(u64::MAX))
    };
    let scope = Scope { name: "graphfix".to_owned(), version: version.to_owned() };
    let spans = spans.iter().map(|span| message(span, at)).collect();
    let resource = Some(Resource { attributes: of_service.into() });
    let scope_spans = vec![ScopeSpans { scope: Some(scope), spans }];
    ExportRequest { resource_spans: vec![ResourceSpans { resource, scope_spans }] }
}

/// The name of a span that has none of its own.
const fn name_of(work: Work) -> &'static str {
    match work {
        Work::Request => "request",
        Work::Push => "push",
        Work::Solve => "solve",
        Work::Commit => "commit",
    }
}

fn message(span: &EndedSpan, at: impl Fn(Instant) -> u64) -> Span {
    let EndedSpan { work, name, context, parent, link, begun, ended, attributes, has_failed } =
        span;
    let name = if name.is_empty() { name_of(*work) } else { name };
    Span {
        trace_id: context.trace_id.to_be_bytes().into(),
        span_id: context.span_id.to_be_bytes().into(),
        parent_span_id: parent.map(|id| id.to_be_bytes().into()).unwrap_or_default(),
        name: name.to_owned(),
        kind: if *work == Work::Request { SERVER } else { INTERNAL },
        start_time_unix_nano: at(*begun),
        end_time_unix_nano: at(*ended),
        attributes: attributes.iter().map(|(key, value)| attribute(key, value)).collect(),
        links: link
            .iter()
            .map(|link| Link {
                trace_id: link.trace_id.to_be_bytes().into(),
                span_id: link.span_id.to_be_bytes().into(),
            })
            .collect(),
        status: has_failed.then_some(Status { code: ERROR }),
        flags: SAMPLED,
    }
}
