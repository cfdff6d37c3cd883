//! Sends a message to a host by HTTP. Only the head of the answer is read.

use std::time::Duration;

use bytes::Bytes;
use http_body_util::Full;
use hyper::header;
use hyper::{Method, StatusCode};
use tokio::time::timeout;

use super::head::retry_after;
use super::web::{exchange, head};
use super::{Connector, FetchError, Url, WebError};

/// The head of the answer to a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Posted {
    /// Its status.
    pub(crate) status: StatusCode,
    /// The delay that the host asks for.
    pub(crate) retry_after: Option<Duration>,
}

/// Sends `body`, which is JSON, with these fields in the head. A redirection is not followed, but
/// returned like any other answer.
///
/// # Errors
/// The host is not contacted, or does not answer in time.
pub(crate) async fn post(
    connector: &Connector,
    url: &Url,
    fields: &[(&'static str, String)],
    body: Bytes,
) -> Result<Posted, WebError> {
    let mut request = head(Method::POST, url).header(header::CONTENT_TYPE, "application/json");
    for (name, value) in fields {
        request = request.header(*name, value);
    }
    let invalid = |_| FetchError::UrlInvalid { text: url.to_string() };
    let request = request.body(Full::new(body)).map_err(invalid)?;
    let limits = connector.time_limits();
    let longest = limits.connecting + limits.answering;
    let answering = exchange(connector, url, (request, limits.answering), |response| {
        let asked = response.headers().get(header::RETRY_AFTER);
        let asked = asked.and_then(|value| value.to_str().ok()).and_then(retry_after);
        std::future::ready(Ok(Posted { status: response.status(), retry_after: asked }))
    });
    let slow = |_| WebError::Slow { seconds: longest.as_secs() };
    timeout(longest, answering).await.map_err(slow)?
}
