//! Checks of every request of both doors: its host, its call, its key, and its memory.
//!
//! Memory is checked last: a refused request uses none, and no part of its body is read.

use std::net::IpAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::BoxError;
use axum::body::{Body, HttpBody};
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, Uri, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use tonic::Code as Status;
use uuid::fmt::Hyphenated;

use crate::contract::access::{Call, Credential, CsrfToken, Need, Pass, Target, target};
use crate::contract::{Lease, Outcome, Refusal, Service};
use crate::grpc;
use crate::refusal::Code;

use super::connection::Peer;
use super::forwarding::{self, Mark, Peers, Route};
use super::jobs;
use super::metered::{Keeping, Metered, Patience};
use super::problem::Refused;
use super::{head, sign_in, traced, uploads};

/// Header with the name of the node that answers, for both doors.
const NODE: HeaderName = HeaderName::from_static("x-graphfix-node");
/// Header of an answer with the request's id. The log has the same id.
const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
/// `Strict-Transport-Security` (RFC 6797): for a year, of this name alone.
const TLS_ONLY: &str = "max-age=31536000";
/// `Content-Security-Policy` of answers that are not pages: nothing may be loaded or framed.
const NO_CONTENT: &str = "default-src 'none'; frame-ancestors 'none'";
/// `Content-Security-Policy` of the pages of `/docs`, which load nothing from other hosts.
const OWN_CONTENT: &str = "default-src 'self'; style-src 'self' 'unsafe-inline'; \
                           img-src 'self' data:; frame-ancestors 'none'";

/// Serves a request with a lease of memory, unless its host, its origin, its call or its key is
/// refused.
pub(super) async fn admit(
    State((service, peers)): State<(Service, Peers)>,
    request: Request,
    next: Next,
) -> Response {
    let (is_grpc, begun) = (is_grpc(request.headers()), Instant::now());
    let is_named = is_named(&service, &request);
    let target = target(request.method().as_str(), request.uri().path());
    let mark = forwarding::mark(&service, request.headers());
    let addressed = addressed(&service, &target, &mark, &request);
    let caught_up = match &addressed {
        // Boxed, so that other requests need no memory for it.
        Ok((call, _)) if may_be_new(&service, call, &mark, &request) => {
            Box::pin(service.catch_up()).await
        }
        _ => Ok(()),
    };
    let checked = addressed.and_then(|(call, foreign)| {
        caught_up?;
        Ok((call, sender(&service, call, foreign, &mark, &request)?))
    });
    let admitted = match checked {
        Ok((call, pass)) => {
            match peers.route(&service, call, (&mark, pass.as_ref()), (request, is_grpc)).await {
                Ok(Route::Here(request)) => leased(&service, request, pass, is_grpc),
                Ok(Route::Answered(response)) => {
                    service.meters().count(is_grpc, outcome(&response), begun.elapsed());
                    return response;
                }
                Err(refusal) => Err(refusal),
            }
        }
        Err(refusal) => {
            let entry = service.refused_request(&target, credential(&request), &refusal);
            // Boxed, so that requests that are not refused need no memory for it.
            Box::pin(service.note_refused(entry)).await;
            Err(refusal)
        }
    };
    let mut response = match admitted {
        Ok((request, lease)) => {
            let span = traced::begun(&service, &target, &request, &lease, begun);
            let mut response = lease.clone().scope(next.run(request)).await;
            traced::ended(span, &response, outcome(&response));
            identify(&mut response, &lease);
            response.map(|body| Keeping::body(body, lease))
        }
        Err(refusal) => {
            let lease = service.budget().empty_lease(None);
            let mut response = lease.during(|| refused(refusal, &target, is_grpc));
            identify(&mut response, &lease);
            response
        }
    };
    service.meters().count(is_grpc, outcome(&response), begun.elapsed());
    if let Ok(node) = HeaderValue::from_str(service.node()) {
        response.headers_mut().insert(NODE, node);
    }
    if is_grpc { response } else { with_security_headers(response, is_named) }
}

/// Adds to an answer the id of its request, which is also in the log.
fn identify(response: &mut Response, lease: &Lease) {
    let id = lease.request_id();
    tracing::debug!(request = %id, status = %response.status(), "answered");
    let mut text = [0; Hyphenated::LENGTH];
    if let Ok(mut id) = HeaderValue::from_str(id.as_hyphenated().encode_lower(&mut text)) {
        // Marked as sensitive, so that it is not added to the connection's table of headers
        // (RFC 7541, section 7.1.3): each id occurs once.
        id.set_sensitive(true);
        response.headers_mut().insert(REQUEST_ID, id);
    }
}

/// Whether a request came over TLS and names the service by a name of its own. Browsers may then
/// remember that this name has TLS. Addresses and `localhost` are shared with other services.
fn is_named(service: &Service, request: &Request) -> bool {
    let is_encrypted = request.extensions().get().is_some_and(|peer: &Peer| peer.is_encrypted);
    let name = host(request.uri(), request.headers()).map(name_of).unwrap_or_default();
    is_encrypted
        && service.is_listed_host(name)
        && !name.eq_ignore_ascii_case("localhost")
        && address_of(name).is_none()
}

/// The outcome of a request, as far as the head of its answer shows it.
fn outcome(response: &Response) -> Outcome {
    // A gRPC call that fails at once has its status in the head (trailers only).
    let grpc = response.headers().get("grpc-status");
    let grpc = grpc.map(|status| Status::from_bytes(status.as_bytes()));
    match (response.status(), grpc) {
        (_, Some(Status::Internal | Status::Unknown | Status::Unavailable | Status::DataLoss)) => {
            Outcome::Failed
        }
        (status, _) if status.is_server_error() => Outcome::Failed,
        (_, Some(code)) if code != Status::Ok => Outcome::Refused,
        (status, _) if status.is_client_error() => Outcome::Refused,
        _ => Outcome::Answered,
    }
}

/// The call of a request, if its host, its origin and its call are valid; and its origin, if the
/// operator lists it for certain tenants.
fn addressed<'a>(
    service: &Service,
    target: &Target,
    mark: &Mark,
    request: &'a Request,
) -> Result<(&'static Call, Option<&'a str>), Refusal> {
    let (method, path) = (request.method(), request.uri().path());
    let foreign = match mark {
        Mark::Node(_) => None, // The node that sends it on has looked.
        _ => foreign_origin(service, request.uri(), request.headers())?,
    };
    let call = match target {
        Target::Call(call) => call,
        Target::OtherMethod(_) => {
            let message = format!("{path} does not take {method}");
            return Err(Refusal::new(Code::MethodNotAllowed, message));
        }
        Target::Unknown => {
            let message = format!("{method} {path} is not a call");
            return Err(Refusal::new(Code::RouteNotFound, message));
        }
    };
    let peer: Option<&Peer> = request.extensions().get();
    if peer.is_some_and(|peer| peer.is_late) && !tells_health(call) {
        return Err(Refusal::new(Code::Draining, "the service is about to stop"));
    }
    Ok((call, foreign))
}

/// Whether a request has a key or a sign-in that others may have made just now, and its call needs
/// one. Calls that need none do not wait for the database: its failure does not make a service
/// appear dead.
fn may_be_new(service: &Service, call: &Call, mark: &Mark, request: &Request) -> bool {
    !matches!(call.need, Need::Nothing) && service.may_be_new(credential(request), mark.key())
}

/// The sender of a request, if everything but its body is valid; `None` if no key is needed.
fn sender(
    service: &Service,
    call: &Call,
    foreign: Option<&str>,
    mark: &Mark,
    request: &Request,
) -> Result<Option<Pass>, Refusal> {
    if let Mark::Node(key) = mark {
        return match call.need {
            Need::Nothing => Ok(None),
            _ => service.pass_of(key).map(Some),
        };
    }
    let peer: Option<&Peer> = request.extensions().get();
    let pass = service.admit(call, credential(request), peer.map(|peer| peer.address))?;
    if let (Some(origin), Some(pass)) = (foreign, &pass)
        && !service.web_origins().serve(origin, pass.tenant())
    {
        let tenant = pass.tenant().name();
        let message = format!("pages of {origin} may not call for the tenant {tenant:?}");
        return Err(Refusal::new(Code::OriginRefused, message));
    }
    if !is_grpc(request.headers()) {
        head::check(call, request)?;
    }
    Ok(pass)
}

/// Whether a call reports the health of the service. Such calls are answered until the service has
/// stopped.
fn tells_health(call: &Call) -> bool {
    matches!(call.rest, "GET /healthz" | "GET /readyz" | "GET /metrics")
        || call.grpc.starts_with("/grpc.health.")
}

/// The request with its lease.
fn leased(
    service: &Service,
    request: Request,
    pass: Option<Pass>,
    is_grpc: bool,
) -> Result<(Request, Lease), Refusal> {
    let lease = service.budget().lease(pass)?;
    metered(service, request, lease, is_grpc)
}

/// The key of a request (RFC 6750, section 2.1), otherwise its cookie. An `authorization` of
/// another form, or a second one, counts as a key that does not exist.
fn credential(request: &Request) -> Credential<'_> {
    let headers = request.headers();
    let mut values = headers.get_all(header::AUTHORIZATION).iter();
    if let Some(value) = values.next() {
        let value = value.to_str().unwrap_or_default();
        let (scheme, key) = value.split_once(' ').unwrap_or_default();
        let is_bearer = scheme.eq_ignore_ascii_case("bearer") && values.next().is_none();
        return Credential::Key(if is_bearer { key.trim() } else { "" });
    }
    let Some(cookie) = sign_in::cookie(headers) else { return Credential::None };
    let token = match request.method().is_safe() {
        true => CsrfToken::NotNeeded,
        false => {
            let token = headers.get(sign_in::CSRF).and_then(|token| token.to_str().ok());
            CsrfToken::Given(token.unwrap_or_default())
        }
    };
    Credential::Cookie(cookie, token)
}

/// A refusal as the addressed door sends it, with the methods that the path allows, or the allowed
/// encodings of bodies.
fn refused(refusal: Refusal, target: &Target, is_grpc: bool) -> Response {
    let is_packed = refusal.code == Code::UnsupportedMediaType;
    let mut response = answer(refusal, is_grpc);
    if is_packed {
        response.headers_mut().insert(header::ACCEPT_ENCODING, head::ENCODINGS);
    }
    if let Target::OtherMethod(methods) = target
        && let Ok(methods) = HeaderValue::from_str(&methods.join(", "))
    {
        response.headers_mut().insert(header::ALLOW, methods);
    }
    response
}

/// Whether these are the headers of a gRPC request.
fn is_grpc(headers: &HeaderMap) -> bool {
    let kind = headers.get(header::CONTENT_TYPE);
    kind.is_some_and(|kind| kind.as_bytes().starts_with(b"application/grpc"))
}

/// A refusal as the addressed door sends it: a gRPC status, or a problem document.
fn answer(refusal: Refusal, is_grpc: bool) -> Response {
    if is_grpc {
        return grpc::to_status(&refusal).into_http::<Body>();
    }
    Refused(refusal).into_response()
}

/// Refuses a request for a host that is not this service, and a request from a page of another
/// origin that the operator does not list. Otherwise a web page could resolve its own host name to
/// this machine and so reach the service (DNS rebinding). Returns the origin if the operator lists
/// it for certain tenants.
fn foreign_origin<'a>(
    service: &Service,
    uri: &Uri,
    headers: &'a HeaderMap,
) -> Result<Option<&'a str>, Refusal> {
    if 1 < headers.get_all(header::HOST).iter().count() {
        let message = "the request names more than one host".to_owned();
        return Err(Refusal::new(Code::HostRefused, message));
    }
    let host = host(uri, headers);
    if let Some(host) = host.filter(|host| !is_own(service, host)) {
        let message = format!("the request names the host {:?}", brief(host));
        return Err(Refusal::new(Code::HostRefused, message));
    }
    let Some(origin) = text(headers, header::ORIGIN) else { return Ok(None) };
    let (_, from) = origin.split_once("://").unwrap_or(("", origin));
    let is_same = host.is_some_and(|host| host.eq_ignore_ascii_case(from));
    if is_same || service.is_listed_host(name_of(from)) {
        return Ok(None);
    }
    if service.web_origins().has(origin) {
        return Ok(Some(origin));
    }
    let message = format!("the request comes from a page of {:?}", brief(origin));
    Err(Refusal::new(Code::OriginRefused, message))
}

/// The host that a request names, with its port.
fn host<'a>(uri: &'a Uri, headers: &'a HeaderMap) -> Option<&'a str> {
    uri.authority().map(|authority| authority.as_str()).or(text(headers, header::HOST))
}

/// The text of a header. A value that is not ASCII becomes `?`, which no check accepts.
fn text(headers: &HeaderMap, name: HeaderName) -> Option<&str> {
    headers.get(name).map(|value| value.to_str().unwrap_or("?"))
}

/// Whether a host is `localhost`, a loopback address, or a name that the operator lists.
fn is_own(service: &Service, host: &str) -> bool {
    let name = name_of(host);
    name.eq_ignore_ascii_case("localhost")
        || address_of(name).is_some_and(|address| address.is_loopback())
        || service.is_listed_host(name)
}

/// The address that the name of a host contains; `None` if it is not an address.
fn address_of(name: &str) -> Option<IpAddr> {
    name.trim_start_matches('[').trim_end_matches(']').parse().ok()
}

/// The host without its port.
fn name_of(host: &str) -> &str {
    match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|byte| byte.is_ascii_digit()) => name,
        _ => host,
    }
}

fn brief(text: &str) -> &str {
    text.get(..80).unwrap_or(text)
}

/// Whether a request sends files of jobs.
fn is_of_files(method: &Method, path: &str) -> bool {
    match *method {
        Method::POST => path == jobs::PATH,
        Method::PATCH => path.starts_with(uploads::PATH),
        _ => false,
    }
}

/// The request with a body whose memory is reserved as it is read.
fn metered(
    service: &Service,
    request: Request,
    lease: Lease,
    is_grpc: bool,
) -> Result<(Request, Lease), Refusal> {
    if is_grpc && grpc::is_stream(request.uri().path()) {
        return Ok((request, lease)); // It has no end; its door reserves memory for each message.
    }
    let fault = if is_grpc { status_error } else { refusal_error };
    let patience = Patience { silence: Duration::from_secs(service.limits().body_silence_s) };
    if !is_grpc && is_of_files(request.method(), request.uri().path()) {
        // Its files are written to the disk as they arrive.
        let (parts, body) = request.into_parts();
        let body = Metered::passing(body, lease.clone(), patience, fault)?;
        return Ok((Request::from_parts(parts, Body::new(body)), lease));
    }
    let limit = service.limits().body_bytes;
    let (parts, body) = request.into_parts();
    let length = usize::try_from(body.size_hint().lower()).unwrap_or(usize::MAX);
    if limit < length.saturating_sub(grpc::PREFIX_BYTES) {
        let message = format!("the body has {length} bytes, at most {limit} are taken");
        return Err(Refusal::new(Code::BodyTooLarge, message));
    }
    let body = Metered::new(body, length, lease.clone(), patience, fault)?;
    Ok((Request::from_parts(parts, Body::new(body)), lease))
}

fn status_error(refusal: Refusal) -> BoxError {
    let mut status = grpc::to_status(&refusal);
    status.set_source(Arc::new(refusal));
    status.into()
}

fn refusal_error(refusal: Refusal) -> BoxError {
    refusal.into()
}

/// Adds a `Content-Security-Policy` unless there is a stricter one, and forbids browsers to guess
/// the content type. If a name of the service was called over TLS, also forbids calls without TLS.
fn with_security_headers(mut response: Response, is_named: bool) -> Response {
    let headers = response.headers_mut();
    let kind = headers.get(header::CONTENT_TYPE).map(HeaderValue::as_bytes).unwrap_or_default();
    let is_page = [&b"text/html"[..], b"text/css", b"text/javascript", b"application/javascript"]
        .iter()
        .any(|page| kind.starts_with(page));
    let policy = HeaderValue::from_static(if is_page { OWN_CONTENT } else { NO_CONTENT });
    headers.entry(header::CONTENT_SECURITY_POLICY).or_insert(policy);
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    if is_named {
        headers.insert(header::STRICT_TRANSPORT_SECURITY, HeaderValue::from_static(TLS_ONLY));
    }
    response
}
