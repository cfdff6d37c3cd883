//! Checks of the query and the body's encoding in the head of a REST request.
//!
//! Calls with parameters read their query themselves, and refuse unknown ones. A call without
//! parameters does not read its query, so the check is made here for all such calls.

use std::collections::BTreeSet;
use std::sync::LazyLock;

use axum::extract::{Query, Request};
use axum::http::{HeaderMap, HeaderValue, Uri, header};

use crate::contract::Refusal;
use crate::contract::access::Call;
use crate::refusal::Code;

use super::{openapi, uploads};

/// Supported encodings of bodies (RFC 9110, section 8.4.1), for the refusal of another one.
pub(super) const ENCODINGS: HeaderValue = HeaderValue::from_static("gzip, identity");
/// Beginning of the paths of calls.
const CALLS: &str = "/v1/";

/// Methods and paths of the calls without parameters.
static WITHOUT_QUERY: LazyLock<BTreeSet<&'static str>> = LazyLock::new(openapi::without_query);

/// Checks the head of a request for a call.
///
/// # Errors
/// The call takes no parameters and the query has one, or the body is packed by another method than
/// gzip.
pub(super) fn check(call: &Call, request: &Request) -> Result<(), Refusal> {
    check_query(call, request.uri())?;
    check_encoding(request.headers())
}

fn check_query(call: &Call, uri: &Uri) -> Result<(), Refusal> {
    let path = uri.path();
    // The protocol tus lets its clients add parameters, so they are not refused.
    let is_checked = path.starts_with(CALLS) && !path.starts_with(uploads::PATH);
    if uri.query().is_none() || !is_checked || !WITHOUT_QUERY.contains(call.rest) {
        return Ok(());
    }
    let parameters = Query::<Vec<(String, String)>>::try_from_uri(uri);
    let Some((name, _)) = parameters.ok().and_then(|Query(all)| all.into_iter().next()) else {
        return Ok(());
    };
    let name = name.get(..80).unwrap_or(&name);
    let message = format!("unknown parameter {name:?}: this call takes none in its query");
    Err(Refusal::new(Code::UnknownField, message).at(name))
}

fn check_encoding(headers: &HeaderMap) -> Result<(), Refusal> {
    let Some(encoding) = headers.get(header::CONTENT_ENCODING) else { return Ok(()) };
    if matches!(encoding.as_bytes(), b"gzip" | b"identity") {
        return Ok(());
    }
    let encoding = encoding.to_str().unwrap_or("?");
    let encoding = encoding.get(..80).unwrap_or(encoding);
    let message = format!("encoding {encoding:?}; this service takes gzip, identity");
    Err(Refusal::new(Code::UnsupportedMediaType, message).at("Content-Encoding"))
}
