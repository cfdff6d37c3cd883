//! Fetches a large file by HTTP, chunk by chunk.

use std::time::Duration;

use bytes::Bytes;
use http_body_util::{BodyExt, Empty};
use hyper::body::Incoming;
use hyper::{Method, Response};
use tokio::sync::mpsc;
use tokio::time::timeout;

use super::web::{Head, REDIRECTIONS, answered, exchange, failed, head, on_same_host};
use super::{Connector, FetchError, Url, WebError};

/// Sends the chunks of a file to `chunks`, as fast as the receiver takes them, until the file ends
/// or the receiver is dropped. Redirections are followed on the same host only.
///
/// # Errors
/// The host is not contacted, does not have the file, is silent, or the file does not arrive within
/// `longest`.
pub(crate) async fn download(
    connector: &Connector,
    url: &Url,
    longest: Duration,
    chunks: &mpsc::Sender<Bytes>,
) -> Result<(), WebError> {
    let slow = |_| WebError::Slow { seconds: longest.as_secs() };
    timeout(longest, follow(connector, url, chunks)).await.map_err(slow)?
}

async fn follow(
    connector: &Connector,
    url: &Url,
    chunks: &mpsc::Sender<Bytes>,
) -> Result<(), WebError> {
    let mut at = url.clone();
    for _ in 0..=REDIRECTIONS {
        let invalid = |_| FetchError::UrlInvalid { text: at.to_string() };
        let request = head(Method::GET, &at).body(Empty::<Bytes>::new()).map_err(invalid)?;
        let silence = connector.time_limits().answering;
        let sending =
            exchange(connector, &at, (request, silence), |answer| send(answer, silence, chunks));
        match sending.await? {
            None => return Ok(()),
            Some(to) => at = on_same_host(&at, &to)?,
        }
    }
    Err(WebError::Redirected { location: at.without_query() })
}

/// Sends the chunks of an answer, or returns the URL to which it redirects.
async fn send(
    answer: Response<Incoming>,
    silence: Duration,
    chunks: &mpsc::Sender<Bytes>,
) -> Result<Option<String>, WebError> {
    match answered(&answer)? {
        Head::File => {}
        Head::Elsewhere(to) => return Ok(Some(to)),
        Head::Unchanged => {
            return Err(WebError::Protocol { why: format!("the answer is {}", answer.status()) });
        }
    }
    let slow = |_| WebError::Slow { seconds: silence.as_secs() };
    let mut body = answer.into_body();
    while let Some(frame) = timeout(silence, body.frame()).await.map_err(slow)? {
        if let Ok(data) = frame.map_err(|error| failed(&error))?.into_data()
            && chunks.send(data).await.is_err()
        {
            return Ok(None); // Whoever takes them knows why.
        }
    }
    Ok(None)
}
