//! Downloads objects from the bucket, in chunks. A transfer that breaks continues where it ended.

use bytes::Bytes;
use hyper::body::Incoming;
use hyper::{Method, Response, StatusCode, header};
use tokio::sync::mpsc;

use super::attempts::Attempts;
use super::client::Bucket;
use super::send::{Signed, next_chunk};
use super::{BucketError, Patience};

/// The object of a download, and how many of its bytes have arrived.
struct Progress<'a> {
    name: &'a str,
    bytes: u64,
    received: u64,
    chunks: &'a mpsc::Sender<Bytes>,
}

impl Bucket {
    /// Sends the chunks of an object of this size to `chunks`, as fast as the receiver takes them,
    /// until the object ends or the receiver is dropped.
    ///
    /// # Errors
    /// The server is away or refuses, or the object is missing or has another size.
    pub(crate) async fn download(
        &self,
        (name, bytes): (&str, u64),
        patience: Patience,
        chunks: &mpsc::Sender<Bytes>,
    ) -> Result<(), BucketError> {
        let (key, mut attempts) = (self.key(name), Attempts::of(patience));
        let mut progress = Progress { name, bytes, received: 0, chunks };
        while progress.received < bytes && !chunks.is_closed() {
            let credentials = self.credentials().await?;
            let url = Self::sign(&self.bucket.get_object(Some(&credentials), &key));
            let mut asked = Signed::of(Method::GET, url);
            if 0 < progress.received {
                asked.fields.push((header::RANGE, format!("bytes={}-", progress.received)));
            }
            let asking = asked.send(&self.connector, name, |answer| progress.pass_on(answer));
            if let Err(error) = asking.await {
                attempts.again(error).await?;
            }
        }
        Ok(())
    }
}

impl Progress<'_> {
    /// Sends the bytes of an answer that have not arrived before.
    async fn pass_on(&mut self, answer: Response<Incoming>) -> Result<(), BucketError> {
        let begin = match answer.status() {
            StatusCode::PARTIAL_CONTENT => self.received,
            _ => 0, // The whole object: the server does not take ranges.
        };
        let field = |name| answer.headers().get(name).and_then(|value| value.to_str().ok());
        let range = field(header::CONTENT_RANGE).unwrap_or_default();
        if 0 < begin && !range.starts_with(&format!("bytes {begin}-")) {
            let answer = format!("bytes from {begin} on were asked for, and {range:?} came");
            return Err(BucketError::Refused { answer });
        }
        let length = field(header::CONTENT_LENGTH).and_then(|value| value.parse::<u64>().ok());
        if length.is_some_and(|length| begin + length != self.bytes) {
            return Err(self.other_size(begin + length.unwrap_or_default()));
        }
        let (mut body, mut at) = (answer.into_body(), begin);
        while let Some(mut data) = next_chunk(&mut body).await? {
            let known = (self.received - at).min(data.len() as u64);
            at += data.len() as u64;
            let new = data.split_off(known as usize);
            self.received += new.len() as u64;
            if self.bytes < self.received {
                return Err(self.other_size(self.received));
            }
            if self.chunks.send(new).await.is_err() {
                return Ok(()); // Nobody takes them any more.
            }
        }
        match self.received < self.bytes {
            true => {
                let (received, bytes) = (self.received, self.bytes);
                let why = format!("{received} of {bytes} bytes came");
                Err(BucketError::Away { why })
            }
            false => Ok(()),
        }
    }

    fn other_size(&self, bytes: u64) -> BucketError {
        let why = format!("it has {bytes} bytes in place of {}", self.bytes);
        BucketError::Damaged { name: self.name.to_owned(), why }
    }
}
