//! Fetches files by HTTP: whole, only if changed, and only from the host asked.
//!
//! Source: RFC 9110 (validators, redirection, date) and RFC 9112 (message body length).

use std::convert::Infallible;
use std::error::Error;
use std::fmt;
use std::future::Future;
use std::io::ErrorKind;
use std::pin::pin;
use std::str::FromStr;
use std::time::{Duration, UNIX_EPOCH};

use bytes::Bytes;
use http_body_util::{BodyExt, Empty};
use hyper::body::{Body, Incoming};
use hyper::client::conn::http1;
use hyper::header::{self, HeaderValue};
use hyper::http::request::Builder;
use hyper::{Method, Request, Response, StatusCode, Uri};
use hyper_util::rt::TokioIo;
use tokio::time::timeout;

use crate::refusal::Code;

use super::head::{HEAD_LIMIT, retry_after, shown};
use super::{Connector, FetchError};

const AGENT: &str = concat!("graphfix/", env!("CARGO_PKG_VERSION"));
/// Most redirections that are followed.
pub(super) const REDIRECTIONS: usize = 3;
const URL_LIMIT: usize = 2000;
/// Most characters of a URL in the message that refuses it.
const URL_SHOWN: usize = 120;

/// A URL such as `https://host/path`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Url {
    /// Name or address of the host.
    pub host: String,
    /// TCP port.
    pub port: u16,
    /// Whether the connection uses TLS.
    pub is_tls: bool,
    /// Path and query, including the leading slash.
    pub path: String,
}

impl FromStr for Url {
    type Err = FetchError;

    fn from_str(text: &str) -> Result<Self, FetchError> {
        let parse = || {
            let uri: Uri = text.parse().ok().filter(|_| text.len() <= URL_LIMIT)?;
            let (is_tls, usual_port) = match uri.scheme_str()? {
                "http" => (false, 80),
                "https" => (true, 443),
                _ => return None,
            };
            let (host, path) = (uri.host()?.to_ascii_lowercase(), uri.path_and_query()?.as_str());
            let authority = uri.authority()?.as_str();
            let port = match authority.rsplit_once(':').filter(|(_, port)| !port.contains(']')) {
                None | Some((_, "")) => usual_port,
                Some((_, port)) => port.parse().ok()?,
            };
            let is_sound = port != 0 && text.is_ascii() && !authority.contains('@');
            is_sound.then(|| Self { host, port, is_tls, path: path.to_owned() })
        };
        parse().ok_or_else(|| FetchError::UrlInvalid { text: without_password(text) })
    }
}

impl Url {
    /// The URL without its query, which may contain a token. Logs have it in this form.
    pub(crate) fn without_query(&self) -> String {
        without_query(&self.to_string()).to_owned()
    }
}

/// A URL or a template of URLs without its query.
pub(super) fn without_query(url: &str) -> &str {
    url.split(['?', '#']).next().unwrap_or_default()
}

/// A text for a message: shortened, and without a user and password before the host.
fn without_password(text: &str) -> String {
    let (scheme, rest) = text.split_at(text.find("//").map_or(0, |at| at + 2));
    let end = rest.find(['/', '?', '#']).unwrap_or(rest.len());
    let host = rest[..end].rfind('@').map_or(0, |at| at + 1);
    scheme.chars().chain(rest[host..].chars()).take(URL_SHOWN).collect()
}

impl fmt::Display for Url {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scheme = if self.is_tls { "https" } else { "http" };
        write!(f, "{scheme}://{}:{}{}", self.host, self.port, self.path)
    }
}

/// The validators of the last version of a file, for requests that ask for changes only.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Validators {
    etag: Option<HeaderValue>,
    modified: Option<HeaderValue>,
}

/// The answer to a request for a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fetched {
    /// A new version of the file.
    New {
        /// The bytes of the file.
        content: Vec<u8>,
        /// The validators for the next request.
        validators: Validators,
        /// The host's time of the answer (ms since 1970-01-01 UTC), if it states one.
        host_unix_ms: Option<i64>,
    },
    /// The file has not changed.
    Unchanged {
        /// The host's time of the answer (ms since 1970-01-01 UTC), if it states one.
        host_unix_ms: Option<i64>,
    },
}

/// Why a file could not be fetched.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WebError {
    /// The host is not contacted, or cannot be reached.
    #[error(transparent)]
    Fetch(#[from] FetchError),
    /// The host does not have the file.
    #[error("the host does not have the file: {answer}")]
    NotFound {
        /// Status line of the answer.
        answer: String,
    },
    /// The host refuses, or cannot serve now.
    #[error("the host refuses: {answer}")]
    Refused {
        /// Status line of the answer.
        answer: String,
        /// The delay that the host asks for.
        retry_after: Option<Duration>,
    },
    /// The host redirects to another host, or too often. Redirections to other hosts are not
    /// followed.
    #[error("the host redirects to {location}, which is not followed")]
    Redirected {
        /// The URL of the redirection, without its query.
        location: String,
    },
    /// The answer is not HTTP.
    #[error("the answer is not HTTP: {why}")]
    Protocol {
        /// Message of the HTTP library.
        why: String,
    },
    /// The file is larger than allowed.
    #[error("the file is larger than {limit} bytes")]
    TooLarge {
        /// Size allowed (bytes).
        limit: usize,
    },
    /// The file did not arrive in time.
    #[error("the file did not arrive within {seconds} s")]
    Slow {
        /// Time allowed (s).
        seconds: u64,
    },
    /// The connection ended before the file did.
    #[error("the connection ended before the file did: {why}")]
    Cut {
        /// Message of the HTTP library.
        why: String,
    },
}

impl WebError {
    /// The stable code.
    pub const fn code(&self) -> Code {
        match self {
            Self::Fetch(error) => error.code(),
            Self::NotFound { .. } => Code::FileNotFound,
            Self::Refused { .. } => Code::HostRefuses,
            Self::Redirected { .. } => Code::HostRedirects,
            Self::Protocol { .. } => Code::HostProtocol,
            Self::TooLarge { .. } => Code::FileTooLarge,
            Self::Slow { .. } => Code::HostSlow,
            Self::Cut { .. } => Code::FileCut,
        }
    }

    /// The delay that the host asks for, if any.
    pub(crate) const fn retry_after(&self) -> Option<Duration> {
        match self {
            Self::Refused { retry_after, .. } => *retry_after,
            _ => None,
        }
    }
}

/// Fetches a file of at most `limit` bytes, if it is another version than `known`.
///
/// # Errors
/// The host is not contacted, or does not send the file in time.
pub async fn fetch(
    connector: &Connector,
    url: &Url,
    known: &Validators,
    limit: usize,
) -> Result<Fetched, WebError> {
    let longest = connector.time_limits().listing;
    let slow = |_| WebError::Slow { seconds: longest.as_secs() };
    timeout(longest, follow(connector, url, known, limit)).await.map_err(slow)?
}

async fn follow(
    connector: &Connector,
    url: &Url,
    known: &Validators,
    limit: usize,
) -> Result<Fetched, WebError> {
    let mut at = url.clone();
    for _ in 0..=REDIRECTIONS {
        match ask(connector, &at, known, limit).await? {
            Answer::File(fetched) => return Ok(fetched),
            Answer::Elsewhere(to) => at = on_same_host(&at, &to)?,
        }
    }
    Err(WebError::Redirected { location: at.without_query() })
}

/// The URL of a redirection, if it is on the same host.
pub(super) fn on_same_host(from: &Url, to: &str) -> Result<Url, WebError> {
    let elsewhere = || WebError::Redirected { location: shown(without_query(to).as_bytes()) };
    let Url { host, port, is_tls, .. } = from;
    // Two slashes begin the name of another host.
    let is_path = to.starts_with('/') && !to.starts_with("//");
    let scheme = if *is_tls { "https" } else { "http" };
    let whole = if is_path { format!("{scheme}://{host}:{port}{to}") } else { to.to_owned() };
    let url: Url = whole.parse().map_err(|_| elsewhere())?;
    let is_same = (&url.host, url.port, url.is_tls) == (host, *port, *is_tls);
    if is_same { Ok(url) } else { Err(elsewhere()) }
}

enum Answer {
    File(Fetched),
    Elsewhere(String),
}

async fn ask(
    connector: &Connector,
    at: &Url,
    known: &Validators,
    limit: usize,
) -> Result<Answer, WebError> {
    let request = (request(at, known)?, connector.time_limits().listing);
    exchange(connector, at, request, |response| take(response, limit)).await
}

/// Sends a request on a new connection, and passes the answer to `take` if its head arrives within
/// `longest`.
pub(crate) async fn exchange<B, T, F>(
    connector: &Connector,
    at: &Url,
    (request, longest): (Request<B>, Duration),
    take: impl FnOnce(Response<Incoming>) -> F,
) -> Result<T, WebError>
where
    B: Body<Data = Bytes, Error = Infallible> + 'static,
    F: Future<Output = Result<T, WebError>>,
{
    let stream = connector.connect(&at.host, at.port, at.is_tls).await?;
    let mut client = http1::Builder::new();
    client.max_buf_size(HEAD_LIMIT).title_case_headers(true);
    let client = client.handshake(TokioIo::new(stream));
    let (mut sender, connection) = client.await.map_err(|error| failed(&error))?;
    let mut exchange = pin!(async {
        let slow = |_| WebError::Slow { seconds: longest.as_secs() };
        let answering = timeout(longest, sender.send_request(request)).await.map_err(slow)?;
        take(answering.map_err(|error| failed(&error))?).await
    });
    tokio::select! {
        answer = &mut exchange => answer,
        // The connection ended first: let the exchange report what it read, or the error.
        _ = connection => exchange.await,
    }
}

/// The head of a request, with the fields that all requests have.
pub(super) fn head(method: Method, at: &Url) -> Builder {
    Request::builder()
        .method(method)
        .uri(at.path.as_str())
        .header(header::HOST, format!("{}:{}", at.host, at.port))
        .header(header::USER_AGENT, AGENT)
        .header(header::ACCEPT_ENCODING, "identity")
        .header(header::CONNECTION, "close")
}

fn request(at: &Url, known: &Validators) -> Result<Request<Empty<Bytes>>, WebError> {
    let mut request = head(Method::GET, at);
    if let Some(etag) = &known.etag {
        request = request.header(header::IF_NONE_MATCH, etag);
    }
    if let Some(modified) = &known.modified {
        request = request.header(header::IF_MODIFIED_SINCE, modified);
    }
    let invalid = |_| FetchError::UrlInvalid { text: at.to_string() };
    Ok(request.body(Empty::new()).map_err(invalid)?)
}

/// The meaning of the head of an answer.
pub(super) enum Head {
    /// The file follows.
    File,
    /// The file has not changed.
    Unchanged,
    /// The file is at another URL.
    Elsewhere(String),
}

/// Reads the head of an answer.
///
/// # Errors
/// It means that no file follows.
pub(super) fn answered(response: &Response<Incoming>) -> Result<Head, WebError> {
    let field = |name| response.headers().get(name).cloned();
    let text = |name| field(name).and_then(|value| value.to_str().ok().map(str::to_owned));
    let answer = response.status().to_string();
    match response.status() {
        StatusCode::OK => Ok(Head::File),
        StatusCode::NOT_MODIFIED => Ok(Head::Unchanged),
        StatusCode::NOT_FOUND | StatusCode::GONE => Err(WebError::NotFound { answer }),
        status if status.is_redirection() && response.headers().contains_key(header::LOCATION) => {
            Ok(Head::Elsewhere(text(header::LOCATION).unwrap_or_default()))
        }
        status if (300..=599).contains(&status.as_u16()) => {
            let retry_after = text(header::RETRY_AFTER).and_then(|text| retry_after(&text));
            Err(WebError::Refused { answer, retry_after })
        }
        _ => Err(WebError::Protocol { why: format!("the answer is {answer:?}") }),
    }
}

async fn take(response: Response<Incoming>, limit: usize) -> Result<Answer, WebError> {
    match answered(&response)? {
        Head::File => {}
        Head::Unchanged => {
            let host_unix_ms = host_unix_ms(&response);
            return Ok(Answer::File(Fetched::Unchanged { host_unix_ms }));
        }
        Head::Elsewhere(to) => return Ok(Answer::Elsewhere(to)),
    }
    let field = |name| response.headers().get(name).cloned();
    let validators =
        Validators { etag: field(header::ETAG), modified: field(header::LAST_MODIFIED) };
    let host_unix_ms = host_unix_ms(&response);
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
    Ok(Answer::File(Fetched::New { content, validators, host_unix_ms }))
}

/// The `Date` of an answer (ms since 1970-01-01 UTC).
fn host_unix_ms(response: &Response<Incoming>) -> Option<i64> {
    let date = response.headers().get(header::DATE)?.to_str().ok()?;
    let since = httpdate::parse_http_date(date).ok()?.duration_since(UNIX_EPOCH).ok()?;
    i64::try_from(since.as_millis()).ok()
}

pub(super) fn failed(error: &hyper::Error) -> WebError {
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
    fn urls_are_read_and_written() {
        let url = |text: &str| text.parse::<Url>().map(|url| url.to_string());
        assert_eq!(url("https://Example.org").unwrap(), "https://example.org:443/");
        assert_eq!(url("http://a:81/b?c=d").unwrap(), "http://a:81/b?c=d");
        for wrong in
            ["a/b", "ftp://a/b", "http://", "http://u@a/", "http://a/ b", "http://a/\r\nX:"]
        {
            assert!(url(wrong).is_err(), "{wrong:?}");
        }
    }

    #[test]
    fn a_port_that_is_none_is_refused() {
        let url = |text: &str| text.parse::<Url>();
        assert_eq!(url("http://[::1]/a").unwrap().port, 80);
        assert_eq!(url("http://a.example:/").unwrap().port, 80);
        assert_eq!(url("https://[::1]:8443/a").unwrap().port, 8443);
        for text in ["http://a.example:99999/", "https://a.example:x/", "http://a.example:0/"] {
            assert!(matches!(url(text), Err(FetchError::UrlInvalid { .. })), "{text}");
        }
    }

    #[test]
    fn a_refusal_shows_no_password() {
        let refused = "https://me:secret@a.example/b".parse::<Url>().unwrap_err().to_string();
        assert!(refused.starts_with("\"https://a.example/b\" is not a URL"), "{refused}");
        let path = "http://a.example:99999/b@c".parse::<Url>().unwrap_err().to_string();
        assert!(path.starts_with("\"http://a.example:99999/b@c\" is not a URL"), "{path}");
        let long = format!("ftp://{}", "a".repeat(5000)).parse::<Url>().unwrap_err();
        assert!(long.to_string().len() < 300);
    }

    #[test]
    fn logs_and_refusals_show_no_query() {
        let url: Url = "https://a.example/b?token=secret".parse().unwrap();
        assert_eq!(url.without_query(), "https://a.example:443/b");
        let elsewhere = on_same_host(&url, "https://b.example/b?token=secret").unwrap_err();
        let expected = "the host redirects to https://b.example/b, which is not followed";
        assert_eq!(elsewhere.to_string(), expected);
    }

    #[test]
    fn a_host_sends_elsewhere_on_itself_alone() {
        let from: Url = "https://a.example/b/c".parse().unwrap();
        let to = |text: &str| on_same_host(&from, text).map(|url| url.path);
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
            assert_eq!(to(other).unwrap_err().code(), Code::HostRedirects, "{other:?}");
        }
    }
}
