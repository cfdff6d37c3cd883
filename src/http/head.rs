//! What the head of a REST request says of its query and its body, beside host and key.
//!
//! Calls with parameters read their query themselves, and refuse those that they do not have. A
//! call without any does not look at it, so that is done here, for all of them.

use std::collections::BTreeSet;
use std::sync::LazyLock;

use axum::extract::{Query, Request};
use axum::http::{HeaderMap, HeaderValue, Uri, header};

use crate::contract::Refusal;
use crate::contract::access::Call;
use crate::refusal::Code;

use super::{openapi, uploads};

/// What packs bodies in transit (RFC 9110, section 8.4.1), as the answer to another one lists it.
pub(super) const ENCODINGS: HeaderValue = HeaderValue::from_static("gzip, identity");
/// Paths of calls begin with this.
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
    // What the protocol tus leaves to its clients is not refused.
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
