//! A refusal as both doors send it.

use std::time::Duration;

use uuid::Uuid;

use crate::refusal::Code;

/// Shortest delay before a request is sent again that was refused because capacity was missing or
/// the service cannot serve now.
pub(super) const RETRY_AFTER: Duration = Duration::from_millis(500);

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
    /// A refusal that names no field, line or byte. It has a delay if a later attempt can succeed.
    pub(crate) fn new(code: Code, message: impl Into<String>) -> Self {
        let message = message.into();
        let (field, line, byte_offset) = (None, None, None);
        let retry_after = code.class().is_passing().then(|| spread(RETRY_AFTER));
        Self { code, message, field, line, byte_offset, retry_after, cause: None }
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

    /// The refusal that ended a body, found among the causes of `error`. Without a refusal among
    /// them, the body is not packed as its `Content-Encoding` states: `MALFORMED_BODY`.
    pub(crate) fn of_body(error: &(dyn std::error::Error + 'static)) -> Self {
        let causes = std::iter::successors(Some(error), |error| error.source());
        let refusal = causes.filter_map(|cause| cause.downcast_ref::<Self>()).next();
        refusal.cloned().unwrap_or_else(|| {
            let message = format!("the body cannot be unpacked: {error}");
            Self::new(Code::MalformedBody, message).at("Content-Encoding")
        })
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

    /// The refusal with another delay before the next attempt, if one is given.
    #[must_use]
    pub(crate) fn retry_after(mut self, delay: Option<Duration>) -> Self {
        self.retry_after = delay.or(self.retry_after);
        self
    }
}

/// A random delay from `shortest` to twice as long, so that refused clients do not return together.
pub(super) fn spread(shortest: Duration) -> Duration {
    // The quality of these random bits does not matter.
    let fraction = f64::from(Uuid::new_v4().as_fields().0) / f64::from(u32::MAX);
    shortest.mul_f64(1.0 + fraction)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A refusal that passes with time has a random delay; any other has none.
    #[test]
    fn what_time_cures_asks_for_a_delay() {
        for code in Code::ALL {
            let refusal = Refusal::new(*code, "no");
            assert_eq!(refusal.retry_after.is_some(), code.class().is_passing(), "{code}");
            assert!(refusal.retry_after.is_none_or(|d| d <= 2 * RETRY_AFTER && RETRY_AFTER <= d));
        }
        let refused = || Refusal::new(Code::MailboxFull, "full");
        let delays: Vec<_> = (0..20).filter_map(|_| refused().retry_after).collect();
        assert!(delays.iter().any(|delay| *delay != delays[0]), "{delays:?}");
        let given = Duration::from_millis(100);
        let refused = refused().retry_after(Some(given)).retry_after(None);
        assert_eq!(refused.retry_after, Some(given));
    }

    #[test]
    fn a_field_gains_its_surroundings() {
        let refusal = Refusal::new(Code::InvalidTime, "week 99999").at("time").within("epochs[3]");
        assert_eq!(refusal.field.as_deref(), Some("epochs[3].time"));
    }
}
