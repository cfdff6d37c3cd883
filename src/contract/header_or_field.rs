//! Values that both a header and a field of the message may have.

use crate::refusal::Code;

use super::Refusal;

/// The value of a header (on gRPC: metadata), or of the field with the same meaning; empty if
/// neither is given.
///
/// # Errors
/// They differ.
pub(crate) fn header_or_field(
    (header, in_header): (&str, Option<String>),
    (field, in_message): (&str, String),
) -> Result<String, Refusal> {
    match in_header {
        Some(value) if !in_message.is_empty() && in_message != value => {
            let message = format!("{header} has {value:?}, {field} has {in_message:?}");
            Err(Refusal::new(Code::InvalidField, message).at(field))
        }
        Some(value) => Ok(value),
        None => Ok(in_message),
    }
}
