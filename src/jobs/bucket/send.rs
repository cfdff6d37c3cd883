//! One request to the server of the bucket, and the meaning of its answer.

use std::future::Future;
use std::time::Duration;

use bytes::Bytes;
use http_body_util::{BodyExt, Full};
use hyper::body::Incoming;
use hyper::header::{self, HeaderName};
use hyper::{Method, Request, Response, StatusCode};
use tokio::time::timeout;

use crate::feeds::{Connector, Url, WebError, exchange};

use super::BucketError;

/// Longest message of a refusal that is read (bytes).
const REFUSAL_BYTES: usize = 16 << 10;
/// Longest silence of a server while it sends (s).
pub(super) const SILENCE: Duration = Duration::from_secs(30);

/// A signed request.
pub(super) struct Signed {
    pub(super) method: Method,
    pub(super) url: url::Url,
    /// Further fields of the head.
    pub(super) fields: Vec<(HeaderName, String)>,
    pub(super) body: Bytes,
    /// Time until the head of the answer must have arrived.
    pub(super) longest: Duration,
}

impl Signed {
    /// A request without further fields and content.
    pub(super) const fn of(method: Method, url: url::Url) -> Self {
        Self { method, url, fields: Vec::new(), body: Bytes::new(), longest: SILENCE }
    }

    /// Sends the request once, and passes the answer to `take` if it is a success.
    ///
    /// # Errors
    /// The server is away, or refuses the request for the object of this name.
    pub(super) async fn send<T, F>(
        &self,
        connector: &Connector,
        name: &str,
        take: impl FnOnce(Response<Incoming>) -> F,
    ) -> Result<T, BucketError>
    where
        F: Future<Output = Result<T, BucketError>>,
    {
        let (request, at) = self.request()?;
        let taking = exchange(connector, &at, (request, self.longest), |answer| async {
            Ok(match answer.status().is_success() {
                true => take(answer).await,
                false => Err(refusal(answer, name).await),
            })
        });
        taking.await.map_err(|error| away(&error))?
    }

    /// The request, and the URL to which it is sent. The head has the host as it was signed, that
    /// is without the default port of the scheme.
    fn request(&self) -> Result<(Request<Full<Bytes>>, Url), BucketError> {
        let invalid = || BucketError::Configuration { why: "the endpoint is no URL".to_owned() };
        let host = self.url.host_str().ok_or_else(invalid)?.to_owned();
        let authority = match self.url.port() {
            Some(port) => format!("{host}:{port}"),
            None => host.clone(),
        };
        let path = match self.url.query() {
            Some(query) => format!("{}?{query}", self.url.path()),
            None => self.url.path().to_owned(),
        };
        let mut request = Request::builder()
            .method(self.method.clone())
            .uri(&path)
            .header(header::HOST, authority)
            .header(header::CONNECTION, "close");
        for (name, value) in &self.fields {
            request = request.header(name, value);
        }
        let request = request.body(Full::new(self.body.clone())).map_err(|_| invalid())?;
        let port = self.url.port_or_known_default().ok_or_else(invalid)?;
        Ok((request, Url { host, port, is_tls: self.url.scheme() == "https", path }))
    }
}

pub(super) fn away(error: &WebError) -> BucketError {
    BucketError::Away { why: error.to_string() }
}

/// The error that an answer means which is not a success.
async fn refusal(answer: Response<Incoming>, name: &str) -> BucketError {
    let status = answer.status();
    // Err: only the status is known.
    let content = whole(answer, REFUSAL_BYTES).await.unwrap_or_default();
    let text = String::from_utf8_lossy(&content);
    let (code, message) = (element(&text, "Code"), element(&text, "Message"));
    let is_missing = status == StatusCode::NOT_FOUND && matches!(code, "" | "NoSuchKey" | "404");
    if is_missing {
        return BucketError::Missing { name: name.to_owned() };
    }
    let answer = format!("{status} {code} {message}").trim_end().to_owned();
    let is_passing = status.is_server_error()
        || matches!(status, StatusCode::REQUEST_TIMEOUT | StatusCode::TOO_MANY_REQUESTS)
        || matches!(code, "RequestTimeout" | "OperationAborted");
    match is_passing {
        true => BucketError::Away { why: answer },
        false => BucketError::Refused { answer },
    }
}

/// The text of the first element of this name; empty without it.
pub(super) fn element<'a>(xml: &'a str, name: &str) -> &'a str {
    let inside = xml.split_once(&format!("<{name}>")).map(|(_, rest)| rest);
    inside.and_then(|rest| rest.split_once("</")).map_or("", |(text, _)| text)
}

/// The content of an answer, of at most `limit` bytes.
///
/// # Errors
/// It is longer, or the connection ends before.
pub(super) async fn whole(
    answer: Response<Incoming>,
    limit: usize,
) -> Result<Vec<u8>, BucketError> {
    let (mut body, mut content) = (answer.into_body(), Vec::new());
    while let Some(data) = next_chunk(&mut body).await? {
        if limit < content.len() + data.len() {
            let answer = format!("an answer of more than {limit} bytes");
            return Err(BucketError::Refused { answer });
        }
        content.extend_from_slice(&data);
    }
    Ok(content)
}

/// The next bytes of an answer; `None` at its end.
///
/// # Errors
/// The server is silent, or the connection ends before the answer does.
pub(super) async fn next_chunk(body: &mut Incoming) -> Result<Option<Bytes>, BucketError> {
    loop {
        let silent = |_| BucketError::Away { why: format!("no byte in {} s", SILENCE.as_secs()) };
        let Some(frame) = timeout(SILENCE, body.frame()).await.map_err(silent)? else {
            return Ok(None);
        };
        let cut = |error| BucketError::Away { why: format!("the answer breaks off: {error}") };
        if let Ok(data) = frame.map_err(cut)?.into_data() {
            return Ok(Some(data));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_code_of_a_refusal_is_read() {
        let xml = "<?xml version=\"1.0\"?><Error><Code>AccessDenied</Code><Message>No</Message>";
        assert_eq!((element(xml, "Code"), element(xml, "Message")), ("AccessDenied", "No"));
        for none in ["", "<Code>", "<html>"] {
            assert_eq!(element(none, "Code"), "");
        }
    }

    #[test]
    fn the_host_is_sent_as_it_was_signed() {
        let asked = |text: &str| {
            let signed = Signed::of(Method::GET, text.parse().unwrap());
            let (request, at) = signed.request().unwrap();
            let host = request.headers()[header::HOST].to_str().unwrap().to_owned();
            (host, at.port, at.is_tls, request.uri().to_string())
        };
        let (host, path) = ("s3.example.org".to_owned(), "/b/a?x=1".to_owned());
        assert_eq!(asked("https://s3.example.org/b/a?x=1"), (host, 443, true, path));
        let (host, path) = ("[::1]:9000".to_owned(), "/b".to_owned());
        assert_eq!(asked("http://[::1]:9000/b"), (host, 9000, false, path));
    }
}
