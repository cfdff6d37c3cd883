//! Reads bodies, path segments and queries strictly: an unknown field is refused by name.

use std::error::Error;
use std::iter::successors;

use axum::body::{Bytes, HttpBody};
use axum::extract::rejection::QueryRejection;
use axum::extract::{FromRequest, FromRequestParts, Query, Request};
use axum::http::header;
use axum::http::request::Parts;
use bytes::BytesMut;
use http_body_util::BodyExt;
use serde::de::DeserializeOwned;
use serde_json::error::Category;

use crate::contract::{Lease, Refusal, in_background};
use crate::refusal::Code;

use super::json_extent::extent_of;
use super::objects::Objects;
use super::problem::Refused;

/// Bodies longer than this are parsed on a blocking thread (bytes).
const SHORT_BYTES: usize = 64 << 10;
/// Path of a message that is not inside another one, as `serde_path_to_error` writes it.
const ROOT_PATH: &str = ".";
/// Content type of bodies that are messages.
const JSON_TYPES: [&str; 1] = ["application/json"];
/// Content types of bodies that are files or bytes of a receiver. A web page of another origin
/// cannot send them without a CORS preflight, which the service does not grant.
const RAW_TYPES: [&str; 3] = ["application/octet-stream", "application/gzip", "application/x-gzip"];

/// What is wrong with a query, with its parameter.
type QueryFault = serde_path_to_error::Error<serde::de::value::Error>;

/// Largest body of a route (bytes), after decompression in transit.
#[derive(Clone, Copy, Debug)]
pub(super) struct BodyLimit(pub usize);

/// A JSON body.
#[derive(Clone, Debug)]
pub(super) struct JsonBody<T>(pub T);

/// A JSON body that may be empty.
#[derive(Clone, Debug)]
pub(super) struct OptionalJsonBody<T>(pub T);

/// A body of bytes.
#[derive(Clone, Debug)]
pub(super) struct RawBody(pub Bytes);

/// The query of a URL.
#[derive(Clone, Debug)]
pub(super) struct StrictQuery<T>(pub T);

impl<S: Send + Sync, T: DeserializeOwned + Send + 'static> FromRequest<S> for JsonBody<T> {
    type Rejection = Refused;

    async fn from_request(request: Request, _: &S) -> Result<Self, Refused> {
        check_type(&request, &JSON_TYPES)?;
        Ok(Self(message(read(request).await?).await?))
    }
}

impl<S, T> FromRequest<S> for OptionalJsonBody<T>
where
    S: Send + Sync,
    T: DeserializeOwned + Default + Send + 'static,
{
    type Rejection = Refused;

    async fn from_request(request: Request, _: &S) -> Result<Self, Refused> {
        // A content type is required only of a body that is not empty.
        let checked = check_type(&request, &JSON_TYPES);
        let bytes = read(request).await?;
        if bytes.is_empty() {
            return Ok(Self(T::default()));
        }
        checked?;
        Ok(Self(message(bytes).await?))
    }
}

impl<S: Send + Sync> FromRequest<S> for RawBody {
    type Rejection = Refused;

    async fn from_request(request: Request, _: &S) -> Result<Self, Refused> {
        check_type(&request, &RAW_TYPES)?;
        Ok(Self(read(request).await?))
    }
}

/// Refuses a body of another content type than `allowed`.
fn check_type(request: &Request, allowed: &[&str]) -> Result<(), Refusal> {
    let kind = request.headers().get(header::CONTENT_TYPE);
    let kind = kind.and_then(|value| value.to_str().ok()).unwrap_or("none");
    let name = kind.split(';').next().unwrap_or_default().trim();
    if allowed.iter().any(|allowed| name.eq_ignore_ascii_case(allowed)) {
        return Ok(());
    }
    let kind = kind.get(..80).unwrap_or(kind);
    let message = format!("content type {kind}; this call takes {}", allowed.join(", "));
    Err(Refusal::new(Code::UnsupportedMediaType, message))
}

/// Reads a body to its end, within the limit of its route. If it is longer unpacked than as sent,
/// memory for the difference is reserved here.
async fn read(request: Request) -> Result<Bytes, Refusal> {
    let BodyLimit(limit) = *request.extensions().get().expect("every route has a limit");
    let lease = Lease::current();
    let mut body = request.into_body();
    let length = usize::try_from(body.size_hint().lower()).unwrap_or(usize::MAX);
    let mut content = BytesMut::with_capacity(length.min(limit));
    let mut reserved = 0;
    while let Some(frame) = body.frame().await {
        let frame = frame.map_err(|error| Refusal::of_body(&error))?;
        let Ok(data) = frame.into_data() else { continue };
        let whole = content.len() + data.len();
        if limit < whole {
            let message = format!("the body has more than {limit} bytes");
            return Err(Refusal::new(Code::BodyTooLarge, message));
        }
        if let Some(lease) = &lease {
            lease.check_ratio(whole)?;
            let unpacked = whole.saturating_sub(lease.arrived()).saturating_sub(reserved);
            lease.reserve(unpacked)?;
            reserved += unpacked;
        }
        content.extend_from_slice(&data);
    }
    Ok(content.freeze())
}

impl<S: Send + Sync, T: DeserializeOwned> FromRequestParts<S> for StrictQuery<T> {
    type Rejection = Refused;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Refused> {
        let query = Query::try_from_uri(&parts.uri);
        query.map(|Query(query)| Self(query)).map_err(|rejection| of_query(&rejection).into())
    }
}

/// The refusal of a query, with the parameter at fault.
fn of_query(rejection: &QueryRejection) -> Refusal {
    let causes = successors(Some(rejection as &dyn Error), |error| (**error).source());
    let mut faults = causes.filter_map(|cause| cause.downcast_ref::<QueryFault>());
    match faults.next() {
        Some(fault) => unfit(fault.inner().to_string(), &fault.path().to_string()),
        None => Refusal::new(Code::InvalidField, rejection.body_text()),
    }
}

/// Reads the message of a body, within the memory of its request.
async fn message<T: DeserializeOwned + Send + 'static>(bytes: Bytes) -> Result<T, Refusal> {
    if let Some(lease) = Lease::current() {
        // The texts are copied; twice the length of the body bounds their memory.
        extent_of(&bytes).reserve(2 * bytes.len(), &lease)?;
    }
    if bytes.len() <= SHORT_BYTES {
        return json(&bytes);
    }
    in_background(move || json(&bytes)).await?
}

/// Parses JSON.
///
/// # Errors
/// The body is not JSON (with the byte at fault) or not of the schema (with the field).
pub(super) fn json<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Refusal> {
    let mut reader = serde_json::Deserializer::from_slice(bytes);
    let value = serde_path_to_error::deserialize(Objects(&mut reader)).map_err(|error| {
        let path = error.path().to_string();
        let inner = error.into_inner();
        match inner.classify() {
            Category::Data => unfit(inner.to_string(), &path),
            _ => not_json(bytes, &inner),
        }
    })?;
    reader.end().map_err(|error| not_json(bytes, &error))?;
    Ok(value)
}

/// The refusal of a body or query that does not match the schema. It names no field if it does
/// not match as a whole.
fn unfit(message: String, path: &str) -> Refusal {
    let is_unknown = message.starts_with("unknown field");
    let code = if is_unknown { Code::UnknownField } else { Code::InvalidField };
    let path = if path == ROOT_PATH { "" } else { path };
    // The path ends at the message in which a field is repeated.
    let repeated = message.strip_prefix("duplicate field `").and_then(|rest| rest.split_once('`'));
    let field = match repeated {
        Some((name, _)) if path.is_empty() => name.to_owned(),
        Some((name, _)) => format!("{path}.{name}"),
        None => path.to_owned(),
    };
    let refusal = Refusal::new(code, message);
    if field.is_empty() { refusal } else { refusal.at(field) }
}

fn not_json(bytes: &[u8], error: &serde_json::Error) -> Refusal {
    let lines = bytes.split_inclusive(|byte| *byte == b'\n');
    let before: usize = lines.take(error.line().saturating_sub(1)).map(<[u8]>::len).sum();
    let offset = (before + error.column().saturating_sub(1)).min(bytes.len());
    Refusal::new(Code::MalformedBody, error.to_string()).on_byte(offset as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contract::v1;

    fn refusal(text: &str) -> Refusal {
        json::<v1::PushEpochsRequest>(text.as_bytes()).unwrap_err()
    }

    #[test]
    fn a_field_that_is_not_known_is_named() {
        let wrong = refusal(r#"{"epochs":[{"seq":1,"observations":[{"pseudorange":2e7}]}]}"#);
        assert_eq!(wrong.code, Code::UnknownField);
        assert_eq!(wrong.field.as_deref(), Some("epochs[0].observations[0].pseudorange"));
        assert!(wrong.message.contains("pseudorangeM"), "{}", wrong.message);
    }

    #[test]
    fn a_wrong_type_has_its_place() {
        let wrong = refusal(r#"{"epochs":[{"seq":"one"}]}"#);
        let at_fault = (wrong.code, wrong.field.as_deref());
        assert_eq!(at_fault, (Code::InvalidField, Some("epochs[0].seq")));
    }

    #[test]
    fn what_is_not_json_has_its_byte() {
        let wrong = refusal("{\"epochs\":\n[}");
        assert_eq!((wrong.code, wrong.byte_offset), (Code::MalformedBody, Some(12)));
        assert_eq!(refusal("{} {}").code, Code::MalformedBody);
    }
}
