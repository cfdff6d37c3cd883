//! Headers for safe changes.
//!
//! `Idempotency-Key` names a request, so that its repetition creates nothing. `If-Match` makes the
//! service refuse a change if the object has changed meanwhile (RFC 9110, section 13.1.1).

use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};

use crate::contract::{Refusal, header_or_field};
use crate::refusal::Code;

use super::problem::Refused;

const IDEMPOTENCY_KEY: &str = "Idempotency-Key";
const IF_MATCH: &str = "If-Match";

/// The name of a request.
#[derive(Clone, Debug)]
pub(super) struct IdempotencyKey(pub Option<String>);

/// The etag on which a change depends; `None` for any.
#[derive(Clone, Debug)]
pub(super) struct IfMatch(pub Option<String>);

/// Header of an answer: the etag of its content.
pub(super) type ETag = [(HeaderName, HeaderValue); 1];

/// Header of an answer that has created an object: the path of the object.
pub(super) type Location = [(HeaderName, String); 1];

impl<S: Send + Sync> FromRequestParts<S> for IdempotencyKey {
    type Rejection = Refused;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Refused> {
        Ok(Self(text(&parts.headers, IDEMPOTENCY_KEY)?.map(ToOwned::to_owned)))
    }
}

impl IdempotencyKey {
    /// The name of a request. The body may have a name, too.
    ///
    /// # Errors
    /// They differ.
    pub(super) fn or(self, request_id: String) -> Result<String, Refusal> {
        header_or_field((IDEMPOTENCY_KEY, self.0), ("requestId", request_id))
    }
}

impl<S: Send + Sync> FromRequestParts<S> for IfMatch {
    type Rejection = Refused;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Refused> {
        let etag = match text(&parts.headers, IF_MATCH)? {
            None | Some("*") => None,
            Some(quoted) => Some(unquoted(quoted).ok_or_else(|| {
                let message = "If-Match takes one etag in quotes, or *";
                Refusal::new(Code::InvalidField, message).at(IF_MATCH)
            })?),
        };
        Ok(Self(etag.map(ToOwned::to_owned)))
    }
}

impl IfMatch {
    /// The etag of a change. The body may have an etag, too.
    ///
    /// # Errors
    /// They differ.
    pub(super) fn or(self, etag: String) -> Result<String, Refusal> {
        header_or_field((IF_MATCH, self.0), ("etag", etag))
    }
}

/// The header of an etag.
pub(super) fn etag(etag: &str) -> ETag {
    // Etags of this service are digits.
    let value = HeaderValue::try_from(format!("\"{etag}\""));
    [(header::ETAG, value.unwrap_or(HeaderValue::from_static("\"\"")))]
}

/// The header with the path of an object in a list.
pub(super) fn location(list: &str, id: &str) -> Location {
    [(header::LOCATION, format!("{list}/{id}"))]
}

/// The status of an answer to a request that creates something.
pub(super) const fn created(is_new: bool) -> StatusCode {
    if is_new { StatusCode::CREATED } else { StatusCode::OK }
}

fn text<'a>(headers: &'a HeaderMap, name: &str) -> Result<Option<&'a str>, Refusal> {
    let text = headers.get(name).map(HeaderValue::to_str).transpose();
    text.map_err(|_| {
        let message = format!("{name} is not a text of visible ASCII characters");
        Refusal::new(Code::InvalidField, message).at(name)
    })
}

/// The text of a strong etag.
fn unquoted(quoted: &str) -> Option<&str> {
    let inner = quoted.strip_prefix('"')?.strip_suffix('"')?;
    (!inner.contains('"')).then_some(inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn header_and_field_agree_or_are_refused() {
        let key = |text: &str| IdempotencyKey(Some(text.to_owned()));
        assert_eq!(key("a").or(String::new()).unwrap(), "a");
        assert_eq!(key("a").or("a".to_owned()).unwrap(), "a");
        assert_eq!(IdempotencyKey(None).or("b".to_owned()).unwrap(), "b");
        assert_eq!(key("a").or("b".to_owned()).unwrap_err().code, Code::InvalidField);
    }

    #[test]
    fn one_strong_etag_is_taken() {
        assert_eq!(unquoted("\"12ab\""), Some("12ab"));
        for other in ["12ab", "W/\"12ab\"", "\"a\", \"b\"", "\""] {
            assert_eq!(unquoted(other), None, "{other}");
        }
    }
}
