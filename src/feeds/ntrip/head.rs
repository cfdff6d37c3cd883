//! The head of a caster's answer: its status, and the position at which the stream begins.

use std::time::Duration;

use crate::feeds::head::{Fields, HEAD_LIMIT, end_of, shown};

use super::NtripError;

/// The possible beginnings of an answer.
const STARTS: [&[u8]; 4] = [b"ICY ", b"HTTP/1.", b"SOURCETABLE ", b"ERROR"];

/// A head that grants the request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Granted {
    /// Length of the head (bytes).
    pub(super) length: usize,
    /// The body is chunked.
    pub(super) is_chunked: bool,
    /// The body is the caster's sourcetable.
    pub(super) is_sourcetable: bool,
}

/// Reads a head; `None` if it is not complete yet.
///
/// # Errors
/// The caster refuses, or the answer does not follow the protocol.
pub(super) fn read(bytes: &[u8]) -> Result<Option<Granted>, NtripError> {
    let could_be = |start: &[u8]| {
        let length = start.len().min(bytes.len());
        bytes[..length].eq_ignore_ascii_case(&start[..length])
    };
    if !STARTS.into_iter().any(could_be) {
        return Err(NtripError::Protocol {
            why: format!("the answer begins with {:?}", shown(bytes)),
        });
    }
    let Some(line_end) = bytes.iter().take(HEAD_LIMIT).position(|byte| *byte == b'\n') else {
        return if bytes.len() < HEAD_LIMIT { Ok(None) } else { Err(endless()) };
    };
    let line = shown(&bytes[..line_end]);
    if line.starts_with("ICY ") {
        // The stream may follow at once. Its decoder skips an empty line before it.
        let granted = Granted { length: line_end + 1, is_chunked: false, is_sourcetable: false };
        return status(&line, None).map(|()| Some(granted));
    }
    if line.starts_with("ERROR") {
        return Err(error(&line));
    }
    let Some(length) = end_of(bytes) else {
        return if bytes.len() < HEAD_LIMIT { Ok(None) } else { Err(endless()) };
    };
    let fields = Fields(&bytes[line_end + 1..length]);
    status(&line, fields.retry_after())?;
    let is_table = |kind: String| kind.to_ascii_lowercase().contains("sourcetable");
    let is_sourcetable =
        line.starts_with("SOURCETABLE") || fields.value("content-type").is_some_and(is_table);
    let is_chunks = |coding: String| coding.to_ascii_lowercase().contains("chunked");
    let is_chunked = fields.value("transfer-encoding").is_some_and(is_chunks);
    Ok(Some(Granted { length, is_chunked, is_sourcetable }))
}

/// The refusal in the first line of a head, if the connection ended after it.
pub(super) fn refusal(bytes: &[u8]) -> Option<NtripError> {
    let line_end = bytes.iter().position(|byte| *byte == b'\n')?;
    status(&shown(&bytes[..line_end]), None).err()
}

fn endless() -> NtripError {
    NtripError::Protocol { why: format!("the head is longer than {HEAD_LIMIT} bytes") }
}

/// Whether the status line grants or refuses the request.
fn status(line: &str, retry_after: Option<Duration>) -> Result<(), NtripError> {
    let answer = line.to_owned();
    let number = line.split_whitespace().nth(1).and_then(|number| number.parse::<u16>().ok());
    match number {
        Some(200) => Ok(()),
        Some(401 | 403 | 407) => Err(NtripError::Unauthorised { answer }),
        Some(404 | 410) => Err(NtripError::NoSuchMountpoint { answer }),
        Some(300..=399) => Err(NtripError::Redirected { answer }),
        Some(408 | 409 | 425 | 429 | 500..=599) => {
            Err(NtripError::TryLater { answer, retry_after })
        }
        _ => Err(NtripError::Protocol { why: format!("the answer is {answer:?}") }),
    }
}

/// The refusal in an error line of version 1.
fn error(line: &str) -> NtripError {
    let (answer, lower) = (line.to_owned(), line.to_ascii_lowercase());
    if ["password", "pass", "user", "auth"].iter().any(|word| lower.contains(word)) {
        NtripError::Unauthorised { answer }
    } else if lower.contains("mount") {
        NtripError::NoSuchMountpoint { answer }
    } else {
        NtripError::TryLater { answer, retry_after: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feeds::head::RETRY_AFTER_LIMIT;
    use crate::refusal::Code;

    fn granted(head: &str) -> Granted {
        let whole = [head.as_bytes(), b"\xd3\0\0rest"].concat();
        for length in 1..head.len() {
            // An incomplete head is not answered yet, but `ICY` needs no empty line.
            let cut = read(&whole[..length]).unwrap();
            assert!(cut.is_none() || head.starts_with("ICY"), "{:?}", &head[..length]);
        }
        read(&whole).unwrap().unwrap()
    }

    fn code(head: &str) -> Code {
        read(head.as_bytes()).unwrap_err().code()
    }

    #[test]
    fn streams_are_granted_by_both_versions() {
        let one = granted("ICY 200 OK\r\n");
        assert_eq!(one, Granted { length: 12, is_chunked: false, is_sourcetable: false });
        let two =
            "HTTP/1.1 200 OK\r\nNtrip-Version: Ntrip/2.0\r\nTransfer-Encoding: chunked\r\n\r\n";
        let expected = Granted { length: two.len(), is_chunked: true, is_sourcetable: false };
        assert_eq!(granted(two), expected);
        let table = "SOURCETABLE 200 OK\r\nContent-Length: 5\r\n\r\n";
        assert!(granted(table).is_sourcetable);
        let table = "HTTP/1.1 200 OK\ncontent-type:gnss/sourcetable\n\n";
        assert!(granted(table).is_sourcetable);
    }

    #[test]
    fn refusals_are_told_apart() {
        assert_eq!(code("HTTP/1.1 401 Unauthorized\r\n\r\n"), Code::CasterUnauthorised);
        assert_eq!(code("ERROR - Bad Password\r\n"), Code::CasterUnauthorised);
        assert_eq!(code("HTTP/1.0 404 Not Found\r\n\r\n"), Code::NoSuchMountpoint);
        assert_eq!(code("ERROR - Mount Point Taken or Invalid\r\n"), Code::NoSuchMountpoint);
        assert_eq!(
            code("HTTP/1.1 302 Found\r\nLocation: http://10.0.0.1/\r\n\r\n"),
            Code::CasterRedirects
        );
        let busy = read(b"HTTP/1.1 503 Busy\r\nRetry-After: 7\r\n\r\n").unwrap_err();
        assert_eq!(busy.code(), Code::CasterTryLater);
        assert_eq!(busy.retry_after(), Some(Duration::from_secs(7)));
        let forever = read(b"HTTP/1.1 429 No\r\nRetry-After: 99999999999\r\n\r\n").unwrap_err();
        assert_eq!(forever.retry_after(), Some(RETRY_AFTER_LIMIT));
    }

    #[test]
    fn an_answer_without_ntrip_is_refused_at_once() {
        assert_eq!(code("SSH-2.0-OpenSSH_9.2\r\n"), Code::CasterProtocol);
        assert_eq!(code("\u{1}\u{2}"), Code::CasterProtocol);
        assert_eq!(code("HTTP/1.1 204 Nothing\r\n\r\n"), Code::CasterProtocol);
        let endless = format!("HTTP/1.1 200 OK\r\n{}", "X: y\r\n".repeat(2000));
        assert_eq!(code(&endless), Code::CasterProtocol);
        assert_eq!(code(&format!("HTTP/1.1 {}", "2".repeat(9000))), Code::CasterProtocol);
        assert_eq!(read(b"").unwrap(), None);
    }
}
