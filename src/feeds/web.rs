//! Files by HTTP: fetched whole, only if newer, and from nowhere else than asked.
//!
//! Source: RFC 9110 (validators, redirection) and RFC 9112 (message body length).

use std::error::Error;
use std::fmt;
use std::io::ErrorKind;
use std::pin::pin;
use std::str::FromStr;
use std::time::Duration;

use bytes::Bytes;
use http_body_util::{BodyExt, Empty};
use hyper::body::{Body, Incoming};
use hyper::client::conn::http1;
use hyper::header::{self, HeaderValue};
use hyper::{Request, Response, StatusCode, Uri};
use hyper_util::rt::TokioIo;
use tokio::time::timeout;

use super::head::{HEAD_LIMIT, retry_after, shown};
use super::{Connector, FetchError};

const AGENT: &str = concat!("graphfix/", env!("CARGO_PKG_VERSION"));
/// How often a host may send elsewhere on itself.
const REDIRECTIONS: usize = 3;
const LOCATION_LIMIT: usize = 2000;

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
            let uri: Uri = text.parse().ok().filter(|_| text.len() <= LOCATION_LIMIT)?;
            let (is_tls, usual_port) = match uri.scheme_str()? {
                "http" => (false, 80),
                "https" => (true, 443),
                _ => return None,
            };
            let port = uri.port_u16().unwrap_or(usual_port);
            let is_sound = port != 0 && text.is_ascii() && !uri.authority()?.as_str().contains('@');
            let (host, path) = (uri.host()?.to_ascii_lowercase(), uri.path_and_query()?.as_str());
            is_sound.then(|| Self { host, port, is_tls, path: path.to_owned() })
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
    etag: Option<HeaderValue>,
    modified: Option<HeaderValue>,
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
    let elsewhere = || WebError::Redirected { location: shown(to.as_bytes()) };
    let Location { host, port, is_tls, .. } = from;
    // Two slashes begin another host's name.
    let is_path = to.starts_with('/') && !to.starts_with("//");
    let scheme = if *is_tls { "https" } else { "http" };
    let whole = if is_path { format!("{scheme}://{host}:{port}{to}") } else { to.to_owned() };
    let place: Location = whole.parse().map_err(|_| elsewhere())?;
    let is_same = (&place.host, place.port, place.is_tls) == (host, *port, *is_tls);
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
    let stream = connector.connect(&at.host, at.port, at.is_tls).await?;
    let mut client = http1::Builder::new();
    client.max_buf_size(HEAD_LIMIT).title_case_headers(true);
    let client = client.handshake(TokioIo::new(stream));
    let (mut sender, connection) = client.await.map_err(|error| failed(&error))?;
    let request = request(at, known)?;
    let mut exchange = pin!(async {
        let answering = sender.send_request(request).await;
        take(answering.map_err(|error| failed(&error))?, limit).await
    });
    tokio::select! {
        answer = &mut exchange => answer,
        // What it has read before its end, or what ended it, the exchange is told.
        _ = connection => exchange.await,
    }
}

fn request(at: &Location, known: &Validators) -> Result<Request<Empty<Bytes>>, WebError> {
    let mut request = Request::get(at.path.as_str())
        .header(header::HOST, format!("{}:{}", at.host, at.port))
        .header(header::USER_AGENT, AGENT)
        .header(header::ACCEPT_ENCODING, "identity")
        .header(header::CONNECTION, "close");
    if let Some(etag) = &known.etag {
        request = request.header(header::IF_NONE_MATCH, etag);
    }
    if let Some(modified) = &known.modified {
        request = request.header(header::IF_MODIFIED_SINCE, modified);
    }
    let invalid = |_| FetchError::LocationInvalid { text: at.to_string() };
    Ok(request.body(Empty::new()).map_err(invalid)?)
}

async fn take(response: Response<Incoming>, limit: usize) -> Result<Answer, WebError> {
    let field = |name| response.headers().get(name).cloned();
    let text = |name| field(name).and_then(|value| value.to_str().ok().map(str::to_owned));
    let answer = response.status().to_string();
    match response.status() {
        StatusCode::OK => {}
        StatusCode::NOT_MODIFIED => return Ok(Answer::File(Fetched::Unchanged)),
        StatusCode::NOT_FOUND | StatusCode::GONE => return Err(WebError::NotFound { answer }),
        status if status.is_redirection() && response.headers().contains_key(header::LOCATION) => {
            return Ok(Answer::Elsewhere(text(header::LOCATION).unwrap_or_default()));
        }
        status if (300..=599).contains(&status.as_u16()) => {
            let retry_after = text(header::RETRY_AFTER).and_then(|text| retry_after(&text));
            return Err(WebError::Refused { answer, retry_after });
        }
        _ => return Err(WebError::Protocol { why: format!("it says {answer:?}") }),
    }
    let validators =
        Validators { etag: field(header::ETAG), modified: field(header::LAST_MODIFIED) };
    let mut body = response.into_body();
    let mut content = Vec::new();
    if (limit as u64) < body.size_hint().lower() {
        return Err(WebError::TooLarge { limit });
    }
    while let Some(frame) = body.frame().await {
        if let Ok(data) = frame.map_err(|error| failed(&error))?.into_data() {
            content.extend_from_slice(&data);
        }
        if limit < content.len() {
            return Err(WebError::TooLarge { limit });
        }
    }
    Ok(Answer::File(Fetched::New { content, validators }))
}

fn failed(error: &hyper::Error) -> WebError {
    let cause = error.source().map_or_else(String::new, |cause| format!(": {cause}"));
    let why = format!("{error}{cause}");
    let kind =
        error.source().and_then(|cause| Some(cause.downcast_ref::<std::io::Error>()?.kind()));
    let is_garbage = matches!(kind, Some(ErrorKind::InvalidInput | ErrorKind::InvalidData));
    if error.is_parse() || is_garbage { WebError::Protocol { why } } else { WebError::Cut { why } }
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
