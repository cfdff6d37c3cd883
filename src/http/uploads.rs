//! `/v1/uploads`: files of jobs that arrive in several requests, by the protocol tus.
//!
//! Source: tus resumable upload protocol 1.0.0 (2016): the core, and the extensions creation,
//! expiration and termination.

use std::time::SystemTime;

use axum::Json;
use axum::extract::{Path, Request};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use futures::TryStreamExt;

use crate::contract::calls::uploads::Answer;
use crate::contract::{Caller, Refusal, calls, v1};
use crate::refusal::Code;

use super::conditions::{Location, location};
use super::problem::Refused;

/// Path of the uploads.
pub(super) const PATH: &str = "/v1/uploads";
const VERSION: HeaderValue = HeaderValue::from_static("1.0.0");
const EXTENSIONS: HeaderValue = HeaderValue::from_static("creation,expiration,termination");
/// Content type of bytes that are appended.
const BYTES: &str = "application/offset+octet-stream";
const TUS_RESUMABLE: HeaderName = HeaderName::from_static("tus-resumable");
const TUS_VERSION: HeaderName = HeaderName::from_static("tus-version");
const TUS_EXTENSION: HeaderName = HeaderName::from_static("tus-extension");
const UPLOAD_OFFSET: HeaderName = HeaderName::from_static("upload-offset");
const UPLOAD_LENGTH: HeaderName = HeaderName::from_static("upload-length");
const UPLOAD_METADATA: HeaderName = HeaderName::from_static("upload-metadata");
const UPLOAD_EXPIRES: HeaderName = HeaderName::from_static("upload-expires");

/// Header of an answer: when the upload is removed.
type Expiry = [(HeaderName, String); 1];

/// States the version of the protocol in each answer, as the protocol requires.
pub(super) async fn versioned(request: Request, next: Next) -> Response {
    let mut response = next.run(request).await;
    response.headers_mut().insert(TUS_RESUMABLE, VERSION);
    if response.status() == StatusCode::PRECONDITION_FAILED {
        response.headers_mut().insert(TUS_VERSION, VERSION);
    }
    response
}

/// States what of the protocol tus the service has.
#[utoipa::path(options, operation_id = "uploadsOptions", path = "/v1/uploads", tag = "Jobs",
    responses((status = 204, description = "In the headers Tus-Version and Tus-Extension"),
        Refused))]
pub(super) async fn options() -> impl IntoResponse {
    (StatusCode::NO_CONTENT, [(TUS_VERSION, VERSION), (TUS_EXTENSION, EXTENSIONS)])
}

/// Begins an upload.
///
/// Its bytes follow by PATCH, in one request or several, also after breaks. Once all are there,
/// jobs name it in `options.uploads`. Clients of the protocol tus 1.0.0 do all of this.
#[utoipa::path(post, operation_id = "uploadsCreate", path = "/v1/uploads", tag = "Jobs",
    params(
        ("Tus-Resumable" = String, Header, description = "1.0.0"),
        ("Upload-Length" = u64, Header, description = "Size of the file (bytes)"),
        ("Upload-Metadata" = Option<String>, Header,
            description = "Pairs of a key and a text in base64; filename is the file's name")),
    responses(
        (status = 201, description = "It is begun", body = v1::Upload,
            headers(("Location" = String, description = "Path of the upload"))),
        Refused))]
pub(super) async fn create(
    caller: Caller,
    headers: HeaderMap,
) -> Result<(StatusCode, Location, Expiry, Json<v1::Upload>), Refused> {
    check_version(&headers)?;
    let length = number(&headers, &UPLOAD_LENGTH)?;
    let name = file_name(&headers)?;
    let Answer { upload, expires } = calls::uploads::create(&caller, &name, length).await?;
    Ok((StatusCode::CREATED, location(PATH, &upload.upload), expiry(expires), Json(upload)))
}

/// Returns an upload; by HEAD its offset in the header `Upload-Offset`.
#[utoipa::path(get, operation_id = "uploadsGet", path = "/v1/uploads/{upload}", tag = "Jobs",
    params(("upload" = String, Path, description = "Its id")),
    responses((status = 200, description = "The upload", body = v1::Upload), Refused))]
pub(super) async fn get(
    caller: Caller,
    Path(upload): Path<String>,
) -> Result<impl IntoResponse, Refused> {
    let Answer { upload, expires } = calls::uploads::get(&caller, &upload).await?;
    let headers = [
        (UPLOAD_OFFSET, HeaderValue::from(upload.offset)),
        (UPLOAD_LENGTH, HeaderValue::from(upload.length)),
        (header::CACHE_CONTROL, HeaderValue::from_static("no-store")),
    ];
    Ok((headers, expiry(expires), Json(upload)))
}

/// Appends bytes to an upload. What has arrived before a break is stored.
#[utoipa::path(patch, operation_id = "uploadsAppend", path = "/v1/uploads/{upload}", tag = "Jobs",
    params(
        ("upload" = String, Path, description = "Its id"),
        ("Tus-Resumable" = String, Header, description = "1.0.0"),
        ("Upload-Offset" = u64, Header, description = "Bytes that are stored")),
    request_body(content = String, content_type = "application/offset+octet-stream",
        description = "The bytes from the offset on"),
    responses(
        (status = 204, description = "They are stored; Upload-Offset has the new offset"),
        Refused))]
pub(super) async fn append(
    caller: Caller,
    Path(upload): Path<String>,
    request: Request,
) -> Result<impl IntoResponse, Refused> {
    let headers = request.headers();
    check_version(headers)?;
    let offset = number(headers, &UPLOAD_OFFSET)?;
    let kind = headers.get(header::CONTENT_TYPE).and_then(|kind| kind.to_str().ok());
    if kind != Some(BYTES) {
        let kind = kind.and_then(|kind| kind.get(..80).or(Some(kind))).unwrap_or("none");
        let message = format!("content type {kind}; this call takes {BYTES}");
        return Err(Refusal::new(Code::UnsupportedMediaType, message).into());
    }
    let body = request.into_body().into_data_stream();
    let body = body.map_err(|error| Refusal::of_body(&error));
    let Answer { upload, expires } = calls::uploads::append(&caller, &upload, offset, body).await?;
    let offset = [(UPLOAD_OFFSET, HeaderValue::from(upload.offset))];
    Ok((StatusCode::NO_CONTENT, offset, expiry(expires)))
}

/// Removes an upload. Jobs that name its file keep it.
#[utoipa::path(delete, operation_id = "uploadsDelete", path = "/v1/uploads/{upload}", tag = "Jobs",
    params(("upload" = String, Path, description = "Its id")),
    responses((status = 204, description = "It is removed"), Refused))]
pub(super) async fn remove(
    caller: Caller,
    Path(upload): Path<String>,
) -> Result<StatusCode, Refused> {
    calls::uploads::remove(&caller, &upload).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Refuses another version of the protocol.
fn check_version(headers: &HeaderMap) -> Result<(), Refusal> {
    match headers.get(TUS_RESUMABLE) {
        Some(version) if *version == VERSION => Ok(()),
        other => {
            let other = other.and_then(|version| version.to_str().ok()).unwrap_or("none");
            let message = format!("Tus-Resumable is {:?}, known is 1.0.0", brief(other));
            Err(Refusal::new(Code::UploadProtocolUnknown, message).at("Tus-Resumable"))
        }
    }
}

/// A header with a number of bytes.
fn number(headers: &HeaderMap, name: &HeaderName) -> Result<u64, Refusal> {
    let text = headers.get(name).and_then(|value| value.to_str().ok());
    let number = text.and_then(|text| text.parse().ok());
    number.ok_or_else(|| {
        let message =
            format!("{name} is {:?}, not a number of bytes", brief(text.unwrap_or("none")));
        Refusal::new(Code::InvalidField, message).at(name.as_str())
    })
}

/// The name of the file in `Upload-Metadata`; empty without one.
fn file_name(headers: &HeaderMap) -> Result<String, Refusal> {
    let text = headers.get(UPLOAD_METADATA).and_then(|value| value.to_str().ok());
    let pairs = text.unwrap_or_default().split(',').map(|pair| pair.trim().split_once(' '));
    let named = |(key, value): (&str, &str)| (key == "filename").then(|| value.to_owned());
    let Some(encoded) = pairs.flatten().find_map(named) else { return Ok(String::new()) };
    let decoded = STANDARD.decode(encoded).ok().and_then(|bytes| String::from_utf8(bytes).ok());
    decoded.ok_or_else(|| {
        let message = "filename in Upload-Metadata is not a text in base64";
        Refusal::new(Code::InvalidField, message).at("Upload-Metadata")
    })
}

/// When an upload is removed (RFC 9110, 5.6.7).
fn expiry(expires: SystemTime) -> Expiry {
    [(UPLOAD_EXPIRES, httpdate::fmt_http_date(expires))]
}

fn brief(text: &str) -> &str {
    text.get(..80).unwrap_or(text)
}
