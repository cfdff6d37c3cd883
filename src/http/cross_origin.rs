//! Answers that allow browsers to call the service from pages of other hosts (CORS: WHATWG Fetch,
//! section 3.3). The admission of a request decides which pages may call.
//!
//! Pages send a key. Cookies are never allowed (`Access-Control-Allow-Credentials`), so a page of
//! another host cannot act for a user who is signed in.

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use crate::contract::WebOrigins;

/// Methods of the table of calls.
const METHODS: &str = "GET, HEAD, POST, PUT, PATCH, DELETE";
/// Header fields of requests that calls understand.
const REQUEST_FIELDS: &str = "authorization, content-encoding, content-type, idempotency-key, \
                              if-match, if-none-match, last-event-id, range, traceparent, \
                              tus-resumable, upload-length, upload-metadata, upload-offset, \
                              x-graphfix-session";
/// Header fields of answers that a page may read, besides those that every page may read.
const ANSWER_FIELDS: &str = "content-disposition, etag, location, retry-after, tus-resumable, \
                             upload-expires, upload-length, upload-offset, www-authenticate, \
                             x-graphfix-node, x-request-id";
/// Time for which a browser may remember the answer (s).
const ASKED_FOR: &str = "600";

/// Answers the question of a browser whether a page may call (preflight), and marks the answers
/// that a page may read.
pub(super) async fn share(
    State(origins): State<WebOrigins>,
    request: Request,
    next: Next,
) -> Response {
    let origin = request.headers().get(header::ORIGIN).filter(|origin| {
        let text = origin.to_str();
        text.is_ok_and(|text| origins.has(text))
    });
    let origin = origin.cloned();
    let mut response = match origin.is_some() && is_question(&request) {
        true => answered(),
        false => next.run(request).await,
    };
    let headers = response.headers_mut();
    headers.append(header::VARY, HeaderValue::from_static("origin"));
    if let Some(origin) = origin {
        headers.insert(header::ACCESS_CONTROL_ALLOW_ORIGIN, origin);
        set(headers, header::ACCESS_CONTROL_EXPOSE_HEADERS, ANSWER_FIELDS);
    }
    response
}

/// Whether this is the question of a browser before the request of a page (a preflight request).
fn is_question(request: &Request) -> bool {
    request.method() == Method::OPTIONS
        && request.headers().contains_key(header::ACCESS_CONTROL_REQUEST_METHOD)
}

fn answered() -> Response {
    let mut response = StatusCode::NO_CONTENT.into_response();
    let headers = response.headers_mut();
    set(headers, header::ACCESS_CONTROL_ALLOW_METHODS, METHODS);
    set(headers, header::ACCESS_CONTROL_ALLOW_HEADERS, REQUEST_FIELDS);
    set(headers, header::ACCESS_CONTROL_MAX_AGE, ASKED_FOR);
    response
}

fn set(headers: &mut HeaderMap, name: HeaderName, value: &'static str) {
    headers.insert(name, HeaderValue::from_static(value));
}
