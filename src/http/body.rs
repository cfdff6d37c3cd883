//! Reads bodies, path segments and queries strictly: an unknown field is refused by name.

use axum::body::Bytes;
use axum::extract::rejection::BytesRejection;
use axum::extract::{FromRequest, FromRequestParts, Request};
use axum::http::request::Parts;
use axum::http::{StatusCode, header};
use serde::de::DeserializeOwned;
use serde_json::error::Category;

use crate::contract::Refusal;
use crate::refusal::Code;

use super::problem::Refused;

/// A JSON body.
#[derive(Clone, Debug)]
pub(super) struct JsonBody<T>(pub T);

/// A body of any content type, as bytes.
#[derive(Clone, Debug)]
pub(super) struct RawBody(pub Bytes);

/// The query of a URL.
#[derive(Clone, Debug)]
pub(super) struct StrictQuery<T>(pub T);

impl<S: Send + Sync, T: DeserializeOwned> FromRequest<S> for JsonBody<T> {
    type Rejection = Refused;

    async fn from_request(request: Request, state: &S) -> Result<Self, Refused> {
        let kind = request.headers().get(header::CONTENT_TYPE);
        let kind = kind.and_then(|value| value.to_str().ok()).unwrap_or("none");
        if kind.split(';').next().map(str::trim) != Some("application/json") {
            let message = format!("content type {kind}; this call takes application/json");
            return Err(Refusal::new(Code::UnsupportedMediaType, message).into());
        }
        let RawBody(bytes) = RawBody::from_request(request, state).await?;
        Ok(Self(json(&bytes)?))
    }
}

impl<S: Send + Sync> FromRequest<S> for RawBody {
    type Rejection = Refused;

    async fn from_request(request: Request, state: &S) -> Result<Self, Refused> {
        Ok(Self(Bytes::from_request(request, state).await.map_err(unread)?))
    }
}

impl<S: Send + Sync, T: DeserializeOwned> FromRequestParts<S> for StrictQuery<T> {
    type Rejection = Refused;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Refused> {
        let query = axum::extract::Query::<T>::try_from_uri(&parts.uri);
        let refusal = |error: axum::extract::rejection::QueryRejection| {
            let message = error.body_text();
            let message = message.trim_start_matches("Failed to deserialize query string: ");
            unfit(message.to_owned(), "")
        };
        query.map(|query| Self(query.0)).map_err(|error| refusal(error).into())
    }
}

fn unread(rejection: BytesRejection) -> Refused {
    let code = match rejection.status() {
        StatusCode::PAYLOAD_TOO_LARGE => Code::BodyTooLarge,
        _ => Code::MalformedBody,
    };
    Refusal::new(code, rejection.body_text()).into()
}

/// Reads JSON.
///
/// # Errors
/// The body is not JSON (with the byte at fault) or not of the schema (with the field).
pub(super) fn json<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Refusal> {
    let mut reader = serde_json::Deserializer::from_slice(bytes);
    let value = serde_path_to_error::deserialize(&mut reader).map_err(|error| {
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

/// The refusal of a body or query that is not of the schema.
fn unfit(message: String, path: &str) -> Refusal {
    let unknown = message.contains("unknown field");
    let code = if unknown { Code::UnknownField } else { Code::InvalidField };
    let named = message.split('`').nth(1).filter(|_| unknown && path.is_empty());
    let field = named.map_or_else(|| path.to_owned(), ToOwned::to_owned);
    Refusal::new(code, message).at(field)
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
