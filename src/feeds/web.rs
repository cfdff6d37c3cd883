//! Files by HTTP: fetched whole, only if newer, and from nowhere else than asked.
//!
//! Source: RFC 9110 (validators, redirection) and RFC 9112 (message body length).

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::timeout;

use super::chunked::Unchunker;
use super::head::{Fields, HEAD_LIMIT, end_of, shown};
use super::{Connection, Connector, FetchError};

const AGENT: &str = concat!("graphfix/", env!("CARGO_PKG_VERSION"));
/// How often a host may send elsewhere on itself.
const REDIRECTIONS: usize = 3;
const LOCATION_LIMIT: usize = 2000;
const READ_BYTES: usize = 16 << 10;

/// A place of the web, such as `https://host/path`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Location {
    /// Name or address.
    pub host: String,
    /// TCP port.
    pub port: u16,
    /// Whether the connection is encrypted.
    pub is_tls: bool,
    /// Path and query, from the slash on.
    pub path: String,
}

impl FromStr for Location {
    type Err = FetchError;

    fn from_str(text: &str) -> Result<Self, FetchError> {
        let parse = || {
            let (scheme, rest) = text.split_once("://").filter(|_| text.len() <= LOCATION_LIMIT)?;
            let is_tls = match scheme {
                "http" => false,
                "https" => true,
                _ => return None,
            };
            let slash = rest.find('/').unwrap_or(rest.len());
            let (authority, path) = rest.split_at(slash);
            let (host, port) = match authority.rsplit_once(':') {
                Some((host, port)) if !host.contains(':') || host.ends_with(']') => {
                    (host, port.parse().ok().filter(|port| *port != 0)?)
                }
                _ => (authority, if is_tls { 443 } else { 80 }),
            };
            let is_host = |c: char| {
                c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_' | '[' | ']' | ':')
            };
            let is_path = |c: char| c.is_ascii_graphic() && c != '#';
            let is_sound =
                !host.is_empty() && host.chars().all(is_host) && path.chars().all(is_path);
            let path = if path.is_empty() { "/" } else { path }.to_owned();
            is_sound.then(|| Self { host: host.to_ascii_lowercase(), port, is_tls, path })
        };
        parse().ok_or_else(|| FetchError::LocationInvalid { text: text.to_owned() })
    }
}

impl fmt::Display for Location {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scheme = if self.is_tls { "https" } else { "http" };
        write!(f, "{scheme}://{}:{}{}", self.host, self.port, self.path)
    }
}

/// What a host said of the file that it gave last.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Validators {
    etag: Option<String>,
    modified: Option<String>,
}

/// What a host gave.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fetched {
    /// A file.
    New {
        /// Its bytes.
        content: Vec<u8>,
        /// What to ask with for a newer one.
        validators: Validators,
    },
    /// Nothing newer.
    Unchanged,
}

/// Why a file is not fetched.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WebError {
    /// The host is not asked, or does not answer.
    #[error(transparent)]
    Fetch(#[from] FetchError),
    /// There is no such file.
    #[error("there is no such file: {answer}")]
    NotFound {
        /// The answer.
        answer: String,
    },
    /// The host refuses, or cannot serve now.
    #[error("the host refuses: {answer}")]
    Refused {
        /// The answer.
        answer: String,
        /// When it asks to come back.
        retry_after: Option<Duration>,
    },
    /// It sends to another host, where nobody follows.
    #[error("the host sends elsewhere, which is not followed: {location}")]
    Redirected {
        /// Where.
        location: String,
    },
    /// What answers is no web server.
    #[error("the answer is not HTTP: {why}")]
    Protocol {
        /// What is wrong.
        why: String,
    },
    /// The file is too large.
    #[error("the file is larger than {limit} bytes")]
    TooLarge {
        /// The size allowed.
        limit: usize,
    },
    /// It took too long.
    #[error("the file did not come within {seconds} s")]
    Slow {
        /// How long it was waited.
        seconds: u64,
    },
    /// The connection ended first.
    #[error("the file ends before its end: {why}")]
    Cut {
        /// How.
        why: String,
    },
}

impl WebError {
    /// Stable code, upper snake case.
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Fetch(error) => error.code(),
            Self::NotFound { .. } => "FILE_NOT_FOUND",
            Self::Refused { .. } => "HOST_REFUSES",
            Self::Redirected { .. } => "HOST_REDIRECTS",
            Self::Protocol { .. } => "HOST_PROTOCOL",
            Self::TooLarge { .. } => "FILE_TOO_LARGE",
            Self::Slow { .. } => "HOST_SLOW",
            Self::Cut { .. } => "FILE_CUT",
        }
    }

    /// What can be done about it.
    pub const fn remedy(&self) -> &'static str {
        match self {
            Self::Fetch(error) => error.remedy(),
            Self::NotFound { .. } => "check the address; a file of today may come later",
            Self::Redirected { .. } => "name the place that the answer names, if it is trusted",
            Self::Protocol { .. } => "check that the address is a web server's",
            Self::TooLarge { .. } => "name a smaller file",
            Self::Refused { .. } | Self::Slow { .. } | Self::Cut { .. } => {
                "nothing: it is tried again"
            }
        }
    }

    /// When the host asks to come back, if it does.
    pub const fn retry_after(&self) -> Option<Duration> {
        match self {
            Self::Refused { retry_after, .. } => *retry_after,
            _ => None,
        }
    }
}

/// Fetches a file of at most `limit` bytes, unless it is the one that `known` is of.
///
/// # Errors
/// The host is not asked, or gives no such file in time.
pub async fn fetch(
    connector: &Connector,
    location: &Location,
    known: &Validators,
    limit: usize,
) -> Result<Fetched, WebError> {
    let patience = connector.patience().listing;
    let slow = |_| WebError::Slow { seconds: patience.as_secs() };
    timeout(patience, follow(connector, location, known, limit)).await.map_err(slow)?
}

async fn follow(
    connector: &Connector,
    location: &Location,
    known: &Validators,
    limit: usize,
) -> Result<Fetched, WebError> {
    let mut at = location.clone();
    for _ in 0..=REDIRECTIONS {
        match ask(connector, &at, known, limit).await? {
            Answer::File(fetched) => return Ok(fetched),
            Answer::Elsewhere(to) => at = on_same_host(&at, &to)?,
        }
    }
    Err(WebError::Redirected { location: at.to_string() })
}

/// The place that a host sends to, if it is its own.
fn on_same_host(from: &Location, to: &str) -> Result<Location, WebError> {
    let elsewhere = || WebError::Redirected { location: to.to_owned() };
    let whole = match to.strip_prefix('/') {
        // Two slashes begin another host's name.
        Some(path) if !path.starts_with('/') => {
            let Location { host, port, is_tls, .. } = from;
            let scheme = if *is_tls { "https" } else { "http" };
            format!("{scheme}://{host}:{port}{to}")
        }
        _ => to.to_owned(),
    };
    let place: Location = whole.parse().map_err(|_| elsewhere())?;
    let is_same = (&place.host, place.port, place.is_tls) == (&from.host, from.port, from.is_tls);
    if is_same { Ok(place) } else { Err(elsewhere()) }
}

enum Answer {
    File(Fetched),
    Elsewhere(String),
}

async fn ask(
    connector: &Connector,
    at: &Location,
    known: &Validators,
    limit: usize,
) -> Result<Answer, WebError> {
    let mut connection = connector.connect(&at.host, at.port, at.is_tls).await?;
    let Location { host, port, path, .. } = at;
    let mut request = format!(
        "GET {path} HTTP/1.1\r\nHost: {host}:{port}\r\nUser-Agent: {AGENT}\r\n\
         Accept-Encoding: identity\r\nConnection: close\r\n"
    );
    if let Some(etag) = &known.etag {
        request.push_str(&format!("If-None-Match: {etag}\r\n"));
    }
    if let Some(modified) = &known.modified {
        request.push_str(&format!("If-Modified-Since: {modified}\r\n"));
    }
    request.push_str("\r\n");
    connection.write_all(request.as_bytes()).await.map_err(|error| cut(&error))?;
    let (bytes, length) = head(&mut connection).await?;
    let line_end = bytes.iter().position(|byte| *byte == b'\n').unwrap_or(length);
    let line = shown(&bytes[..line_end]);
    let fields = Fields(&bytes[line_end..length]);
    let number = line.split_whitespace().nth(1).and_then(|number| number.parse::<u16>().ok());
    match number {
        Some(200) => {}
        Some(304) => return Ok(Answer::File(Fetched::Unchanged)),
        Some(301 | 302 | 303 | 307 | 308) => {
            let to = fields.value("location").unwrap_or_default();
            return Ok(Answer::Elsewhere(to));
        }
        Some(404 | 410) => return Err(WebError::NotFound { answer: line }),
        Some(300..=599) => {
            return Err(WebError::Refused { answer: line, retry_after: fields.retry_after() });
        }
        _ => return Err(WebError::Protocol { why: format!("it says {line:?}") }),
    }
    let validators =
        Validators { etag: fields.value("etag"), modified: fields.value("last-modified") };
    let is_chunks = |coding: String| coding.to_ascii_lowercase().contains("chunked");
    let end = if fields.value("transfer-encoding").is_some_and(is_chunks) {
        End::Chunks(Unchunker::new())
    } else {
        match fields.value("content-length").map(|text| text.parse::<usize>()) {
            Some(Ok(length)) if limit < length => return Err(WebError::TooLarge { limit }),
            Some(Ok(length)) => End::Length(length),
            Some(Err(_)) => {
                return Err(WebError::Protocol { why: "its length is none".to_owned() });
            }
            None => End::Connection,
        }
    };
    let content = body(&mut connection, &bytes[length..], end, limit).await?;
    Ok(Answer::File(Fetched::New { content, validators }))
}

/// The bytes up to the end of the head at least, and where that is.
async fn head(connection: &mut Connection) -> Result<(Vec<u8>, usize), WebError> {
    let mut bytes = Vec::new();
    let mut buffer = vec![0; READ_BYTES];
    loop {
        if let Some(length) = end_of(&bytes) {
            return Ok((bytes, length));
        }
        let start = &bytes[..bytes.len().min(b"HTTP/1.".len())];
        if !b"HTTP/1.".starts_with(start) {
            return Err(WebError::Protocol { why: format!("it begins {:?}", shown(&bytes)) });
        }
        if HEAD_LIMIT <= bytes.len() {
            let why = format!("its head is longer than {HEAD_LIMIT} bytes");
            return Err(WebError::Protocol { why });
        }
        match connection.read(&mut buffer).await.map_err(|error| cut(&error))? {
            0 => return Err(WebError::Cut { why: "before it answered".to_owned() }),
            length => bytes.extend_from_slice(&buffer[..length]),
        }
    }
}

/// What ends a body.
enum End {
    Length(usize),
    Chunks(Unchunker),
    Connection,
}

async fn body(
    connection: &mut Connection,
    first: &[u8],
    mut end: End,
    limit: usize,
) -> Result<Vec<u8>, WebError> {
    let mut content = Vec::new();
    let mut buffer = first.to_vec();
    loop {
        match &mut end {
            End::Chunks(unchunker) => unchunker
                .push(&buffer, &mut content)
                .map_err(|unchunked| WebError::Protocol { why: unchunked.0.to_owned() })?,
            End::Length(_) | End::Connection => content.extend_from_slice(&buffer),
        }
        if limit < content.len() {
            return Err(WebError::TooLarge { limit });
        }
        let is_whole = match &end {
            End::Length(length) => *length <= content.len(),
            End::Chunks(unchunker) => unchunker.is_at_end(),
            End::Connection => false,
        };
        if is_whole {
            if let End::Length(length) = end {
                content.truncate(length);
            }
            return Ok(content);
        }
        buffer.resize(READ_BYTES, 0);
        let read = match connection.read(&mut buffer).await {
            Ok(read) => read,
            // How TLS ends where nobody says that it does; a file cut there would not unpack.
            Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => 0,
            Err(error) => return Err(cut(&error)),
        };
        if read == 0 {
            return match end {
                End::Connection => Ok(content),
                _ => Err(WebError::Cut { why: format!("after {} bytes", content.len()) }),
            };
        }
        buffer.truncate(read);
    }
}

fn cut(error: &std::io::Error) -> WebError {
    WebError::Cut { why: error.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_named_by_address() {
        let place = |text: &str| text.parse::<Location>().map(|place| place.to_string());
        assert_eq!(place("https://Example.org").unwrap(), "https://example.org:443/");
        assert_eq!(place("http://a:81/b?c=d").unwrap(), "http://a:81/b?c=d");
        for wrong in
            ["a/b", "ftp://a/b", "http://", "http://u@a/", "http://a/ b", "http://a/\r\nX:"]
        {
            assert!(place(wrong).is_err(), "{wrong:?}");
        }
    }

    #[test]
    fn a_host_sends_elsewhere_on_itself_alone() {
        let from: Location = "https://a.example/b/c".parse().unwrap();
        let to = |text: &str| on_same_host(&from, text).map(|place| place.path);
        assert_eq!(to("/d").unwrap(), "/d");
        assert_eq!(to("https://a.example/e").unwrap(), "/e");
        for other in [
            "https://b.example/",
            "http://a.example/",
            "//b.example/",
            "https://a.example:8/",
            "",
            "x",
        ] {
            assert_eq!(to(other).unwrap_err().code(), "HOST_REDIRECTS", "{other:?}");
        }
    }
}
