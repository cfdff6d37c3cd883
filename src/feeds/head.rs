//! The head of a host's answer: its length, and its fields.

use std::time::Duration;

/// Longest head that is read (bytes).
pub(super) const HEAD_LIMIT: usize = 8 << 10;
/// Longest text from a host that is shown to users (characters).
const ANSWER_LIMIT: usize = 120;
/// Longest delay that a host may ask for.
pub(super) const RETRY_AFTER_LIMIT: Duration = Duration::from_secs(3600);

/// The length of the head, including the empty line that ends it.
pub(super) fn end_of(bytes: &[u8]) -> Option<usize> {
    let head = &bytes[..bytes.len().min(HEAD_LIMIT)];
    let lines = head.iter().enumerate().filter(|(_, byte)| **byte == b'\n').map(|(at, _)| at);
    let is_last = |at: &usize| matches!(head[at + 1..], [b'\n', ..] | [b'\r', b'\n', ..]);
    let at = lines.into_iter().find(is_last)?;
    Some(at + if head[at + 1] == b'\n' { 2 } else { 3 })
}

/// The fields of a head.
pub(super) struct Fields<'a>(pub(super) &'a [u8]);

impl Fields<'_> {
    /// The value of a field.
    pub(super) fn value(&self, name: &str) -> Option<String> {
        let field = |line: &[u8]| {
            let colon = line.iter().position(|byte| *byte == b':')?;
            let is_named = line[..colon].trim_ascii().eq_ignore_ascii_case(name.as_bytes());
            is_named.then(|| shown(&line[colon + 1..]))
        };
        self.0.split(|byte| *byte == b'\n').find_map(field)
    }

    /// The delay before the next request that the host asks for.
    pub(super) fn retry_after(&self) -> Option<Duration> {
        retry_after(&self.value("retry-after")?)
    }
}

/// The delay of a `Retry-After` field; `None` if it gives a date instead.
pub(super) fn retry_after(text: &str) -> Option<Duration> {
    let seconds = text.trim().parse().ok()?;
    Some(Duration::from_secs(seconds).min(RETRY_AFTER_LIMIT))
}

/// A text from another host, shortened and without control characters.
pub(super) fn shown(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(&bytes[..bytes.len().min(4 * ANSWER_LIMIT)]).into_owned();
    let printable = |c: char| if c.is_control() { ' ' } else { c };
    let text: String = text.trim().chars().map(printable).take(ANSWER_LIMIT).collect();
    text
}
