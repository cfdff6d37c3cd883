//! The metadata of a call that have the same meaning as a field of its message.

use tonic::metadata::MetadataMap;

use crate::contract::{Refusal, header_or_field};
use crate::refusal::Code;

/// Names a request, so that its repetition creates nothing, like the same header on REST.
const IDEMPOTENCY_KEY: &str = "idempotency-key";

/// The name of a request; `None` without one.
///
/// # Errors
/// It is not a text.
pub(super) fn idempotency_key(metadata: &MetadataMap) -> Result<Option<String>, Refusal> {
    let text = metadata.get(IDEMPOTENCY_KEY).map(|value| value.to_str()).transpose();
    text.map(|text| text.map(ToOwned::to_owned)).map_err(|_| {
        let message = format!("{IDEMPOTENCY_KEY} is not a text of visible ASCII characters");
        Refusal::new(Code::InvalidField, message).at(IDEMPOTENCY_KEY)
    })
}

/// The name of a request. The message may have a name, too.
///
/// # Errors
/// They differ, or the name in the metadata is not a text.
pub(super) fn request_id(metadata: &MetadataMap, in_message: String) -> Result<String, Refusal> {
    header_or_field((IDEMPOTENCY_KEY, idempotency_key(metadata)?), ("requestId", in_message))
}
