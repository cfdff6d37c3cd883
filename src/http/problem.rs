//! Refusals as RFC 9457 problem documents.

use std::collections::BTreeMap;

use axum::Json;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::openapi::schema::{ObjectBuilder, Type};
use utoipa::openapi::{ContentBuilder, HeaderBuilder, Ref, RefOr, ResponseBuilder};
use utoipa::{IntoResponses, ToSchema};

use crate::contract::{Refusal, log_failure};
use crate::refusal::{Class, Code};

/// Media type of the documents.
const CONTENT_TYPE: &str = "application/problem+json";

/// A refusal as an RFC 9457 problem document.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "camelCase")]
pub struct Problem {
    /// Where this service explains the code: `/docs/errors#` followed by the code.
    #[serde(rename = "type")]
    pub kind: String,
    /// The code as words.
    pub title: String,
    /// The HTTP status.
    pub status: u16,
    /// What is wrong, with the values at fault.
    pub detail: String,
    /// Stable code, upper snake case; see `docs/errors.md`.
    pub code: String,
    /// What the user can do about it.
    pub remedy: String,
    /// The field at fault, such as `epochs[3].time`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub field: Option<String>,
    /// The line at fault of an uploaded file, from 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub line: Option<u64>,
    /// Offset of the byte at fault in the body, from 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub byte_offset: Option<u64>,
    /// The delay before the next attempt (ms).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub retry_after_ms: Option<u64>,
}

/// A refusal as the answer to a request.
#[derive(Clone, Debug)]
pub(super) struct Refused(pub Refusal);

impl From<Refusal> for Refused {
    fn from(refusal: Refusal) -> Self {
        Self(refusal)
    }
}

/// The refusals of a call in the OpenAPI document.
impl IntoResponses for Refused {
    fn responses() -> BTreeMap<String, RefOr<utoipa::openapi::Response>> {
        let refusals = [
            ("4XX", "Refused; statuses 408 and 429 pass with time."),
            ("5XX", "Failed, or not ready; status 503 passes with time."),
        ];
        let response = |description: &str| {
            let schema = Ref::from_schema_name("Problem");
            let whole_seconds = ObjectBuilder::new().schema_type(Type::Integer);
            let retry_after = HeaderBuilder::new()
                .schema(Some(whole_seconds))
                .description(Some("With statuses 429 and 503: the delay (s)."));
            ResponseBuilder::new()
                .description(description)
                .content(CONTENT_TYPE, ContentBuilder::new().schema(Some(schema)).build())
                .header("Retry-After", retry_after.build())
                .build()
        };
        let named = |(statuses, description): (&str, &str)| {
            (statuses.to_owned(), RefOr::T(response(description)))
        };
        refusals.into_iter().map(named).collect()
    }
}

/// The HTTP status of a class.
pub const fn http_status(class: Class) -> StatusCode {
    match class {
        Class::Malformed => StatusCode::BAD_REQUEST,
        Class::MediaType => StatusCode::UNSUPPORTED_MEDIA_TYPE,
        Class::TooLarge => StatusCode::PAYLOAD_TOO_LARGE,
        Class::NotFound | Class::Route => StatusCode::NOT_FOUND,
        Class::Method => StatusCode::METHOD_NOT_ALLOWED,
        Class::Conflict | Class::Precondition => StatusCode::CONFLICT,
        Class::Changed => StatusCode::PRECONDITION_FAILED,
        Class::Exhausted => StatusCode::TOO_MANY_REQUESTS,
        Class::Unavailable => StatusCode::SERVICE_UNAVAILABLE,
        Class::Unauthenticated => StatusCode::UNAUTHORIZED,
        Class::Forbidden => StatusCode::FORBIDDEN,
        Class::Timeout => StatusCode::REQUEST_TIMEOUT,
        Class::Internal | Class::NoCall => StatusCode::INTERNAL_SERVER_ERROR,
    }
}

/// How to authenticate (RFC 6750, section 3).
const fn challenge(code: Code) -> &'static str {
    match code {
        Code::KeyRequired => "Bearer realm=\"graphfix\"",
        _ => "Bearer realm=\"graphfix\", error=\"invalid_token\"",
    }
}

impl Problem {
    /// The document of a refusal.
    pub(crate) fn of(refusal: &Refusal) -> Self {
        let code = refusal.code.name();
        let words = code.to_lowercase().replace('_', " ");
        Self {
            kind: refusal.code.link(),
            title: words,
            status: http_status(refusal.code.class()).as_u16(),
            detail: refusal.message.clone(),
            code: code.to_owned(),
            remedy: refusal.code.remedy().to_owned(),
            field: refusal.field.clone(),
            line: refusal.line,
            byte_offset: refusal.byte_offset,
            retry_after_ms: refusal.retry_after.map(|delay| delay.as_millis() as u64),
        }
    }

    /// The document of a refusal as the last HTTP/1.1 answer on a connection whose requests are not
    /// read.
    pub(super) fn closing_answer(refusal: &Refusal) -> String {
        let status = http_status(refusal.code.class());
        let body =
            serde_json::to_string(&Self::of(refusal)).expect("a problem is texts and numbers");
        let retry_after = match retry_after_s(refusal) {
            Some(seconds) => format!("retry-after: {seconds}\r\n"),
            None => String::new(),
        };
        format!(
            "HTTP/1.1 {status}\r\ncontent-type: {CONTENT_TYPE}\r\ncontent-length: {}\r\n\
             {retry_after}connection: close\r\n\r\n{body}",
            body.len(),
        )
    }
}

/// The delay before the next attempt, in whole seconds.
fn retry_after_s(refusal: &Refusal) -> Option<u64> {
    refusal.retry_after.map(|delay| whole_seconds(delay.as_millis() as u64))
}

/// A delay (ms) in the form of `Retry-After` (s).
pub(super) const fn whole_seconds(delay_ms: u64) -> u64 {
    delay_ms.div_ceil(1000)
}

/// The document with its status, and `Retry-After` in whole seconds if there is a delay. Failures
/// of the service are logged here, once.
impl IntoResponse for Refused {
    fn into_response(self) -> Response {
        let Self(refusal) = self;
        let is_failure = matches!(refusal.code.class(), Class::Internal | Class::Unavailable);
        if is_failure && refusal.code != Code::Draining {
            log_failure(&refusal, "");
        }
        let status = http_status(refusal.code.class());
        let mut response = (status, Json(Problem::of(&refusal))).into_response();
        let kind = HeaderValue::from_static(CONTENT_TYPE);
        response.headers_mut().insert(header::CONTENT_TYPE, kind);
        if refusal.code.class() == Class::Unauthenticated {
            let challenge = HeaderValue::from_static(challenge(refusal.code));
            response.headers_mut().insert(header::WWW_AUTHENTICATE, challenge);
        }
        if let Some(seconds) = retry_after_s(&refusal) {
            response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from(seconds));
        }
        response
    }
}
