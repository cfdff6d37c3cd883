//! A refusal as both doors send it.

use std::time::Duration;

use crate::refusal::Code;

/// Why a request, or one epoch of it, is refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{code}: {message}")]
pub struct Refusal {
    /// The stable code, which has the remedy.
    pub code: Code,
    /// What is wrong, with the values at fault.
    pub message: String,
    /// The field at fault, as a path such as `epochs[3].time`.
    pub field: Option<String>,
    /// The line at fault of an uploaded file, from 1.
    pub line: Option<u64>,
    /// Offset of the byte at fault in the body, from 0.
    pub byte_offset: Option<u64>,
    /// The delay before the next attempt.
    pub retry_after: Option<Duration>,
    /// The cause of a failure. Only the log contains it, because it may reveal how data is stored.
    pub cause: Option<Box<str>>,
}

impl Refusal {
    /// A refusal that names no field, line or byte.
    pub(crate) fn new(code: Code, message: impl Into<String>) -> Self {
        let message = message.into();
        let (field, line, byte_offset) = (None, None, None);
        Self { code, message, field, line, byte_offset, retry_after: None, cause: None }
    }

    /// The refusal with its cause for the log.
    #[must_use]
    pub(super) fn because(mut self, cause: impl Into<Box<str>>) -> Self {
        self.cause = Some(cause.into());
        self
    }

    /// The message of a failure for the log.
    pub(crate) fn logged(&self) -> String {
        match &self.cause {
            Some(cause) => format!("{}: {cause}", self.message),
            None => self.message.clone(),
        }
    }

    /// The refusal that ended a body, found among the causes of `error`; `MALFORMED_BODY` if the
    /// body ended for another reason.
    pub(crate) fn of_body(error: &(dyn std::error::Error + 'static)) -> Self {
        let causes = std::iter::successors(Some(error), |error| error.source());
        let refusal = causes.filter_map(|cause| cause.downcast_ref::<Self>()).next();
        refusal.cloned().unwrap_or_else(|| Self::new(Code::MalformedBody, error.to_string()))
    }

    /// The refusal with the field at fault.
    #[must_use]
    pub(crate) fn at(mut self, field: impl Into<String>) -> Self {
        self.field = Some(field.into());
        self
    }

    /// The refusal with the field at fault, if there is one.
    #[must_use]
    pub(super) fn at_some(mut self, field: Option<&str>) -> Self {
        self.field = field.map(ToOwned::to_owned);
        self
    }

    /// The refusal with its field inside `outer`.
    #[must_use]
    pub(crate) fn within(mut self, outer: &str) -> Self {
        self.field = Some(match self.field {
            Some(inner) => format!("{outer}.{inner}"),
            None => outer.to_owned(),
        });
        self
    }

    /// The refusal with the line at fault.
    #[must_use]
    pub(crate) fn on_line(mut self, line: u64) -> Self {
        self.line = Some(line);
        self
    }

    /// The refusal with the byte at fault.
    #[must_use]
    pub(crate) fn on_byte(mut self, offset: u64) -> Self {
        self.byte_offset = Some(offset);
        self
    }

    /// The refusal with the delay before the next attempt.
    #[must_use]
    pub(crate) fn retry_after(mut self, delay: Duration) -> Self {
        self.retry_after = Some(delay);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_gains_its_surroundings() {
        let refusal = Refusal::new(Code::InvalidTime, "week 99999").at("time").within("epochs[3]");
        assert_eq!(refusal.field.as_deref(), Some("epochs[3].time"));
    }
}
