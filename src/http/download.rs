//! Answers that are files, read from the store while they are sent.

use axum::body::Body;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use futures::{Stream, TryStreamExt};

use crate::contract::{Refusal, log_failure};

/// A file of this name and media type. If reading its content fails, the connection is broken.
pub(super) fn download(
    name: &str,
    kind: &str,
    content: impl Stream<Item = Result<Bytes, Refusal>> + Send + 'static,
) -> Response {
    let content = content.inspect_err(|refusal| {
        log_failure(refusal, "a file breaks off: ");
    });
    let disposition = format!("attachment; filename=\"{name}\"");
    let headers =
        [(header::CONTENT_TYPE, kind.to_owned()), (header::CONTENT_DISPOSITION, disposition)];
    (headers, Body::from_stream(content)).into_response()
}
