//! Uploads files to the bucket, in parts.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use hyper::body::Incoming;
use hyper::{Method, Response, header};
use rusty_s3::Credentials;
use rusty_s3::actions::{
    AbortMultipartUpload, CompleteMultipartUpload, CompleteMultipartUploadResponse,
    CreateMultipartUpload, UploadPart,
};
use tokio::task::spawn_blocking;

use super::attempts::Attempts;
use super::client::Bucket;
use super::send::{Signed, element, whole};
use super::{BucketError, Patience};

/// Size of a part (bytes), unless a file would have too many parts. A file of at most this size is
/// sent as a whole.
const PART_BYTES: u64 = 8 << 20;
/// Most parts of an object.
const PARTS_MAX: u64 = 10_000;
/// Longest time for a part: 70 kB/s.
const PART_TIME: Duration = Duration::from_secs(120);
/// Longest time in which a server joins the parts.
const COMPLETION_TIME: Duration = Duration::from_secs(300);
/// Longest answer to these requests (bytes).
const ANSWER_BYTES: usize = 64 << 10;

/// Consecutive bytes of a file.
struct Part {
    file: Arc<File>,
    at: u64,
    bytes: u64,
}

impl Bucket {
    /// Puts a file of this size as an object. It replaces an object of this name.
    ///
    /// # Errors
    /// The server is away or refuses, or the file cannot be read.
    pub(crate) async fn put(
        &self,
        name: &str,
        (file, bytes): (Arc<File>, u64),
        patience: Patience,
    ) -> Result<(), BucketError> {
        let key = self.key(name);
        if bytes <= PART_BYTES {
            let sign = |credentials: &Credentials| {
                Self::sign(&self.bucket.put_object(Some(credentials), &key))
            };
            let part = Part { file, at: 0, bytes };
            return self.put_part(name, part, patience, sign).await.map(drop);
        }
        let upload = self.begin(name, patience).await?;
        let put = async {
            let tags = self.put_parts(name, &upload, (file, bytes), patience).await?;
            self.complete(name, &upload, (&tags, bytes), patience).await
        };
        let put = put.await;
        if put.is_err() {
            self.abort(name, &upload).await;
        }
        put
    }

    /// Begins an upload in parts. Returns its id.
    async fn begin(&self, name: &str, patience: Patience) -> Result<String, BucketError> {
        let (key, mut attempts) = (self.key(name), Attempts::of(patience));
        loop {
            let credentials = self.credentials().await?;
            let action = CreateMultipartUpload::new(&self.bucket, Some(&credentials), &key);
            let asked = Signed::of(Method::POST, Self::sign(&action));
            match asked.send(&self.connector, name, text).await {
                Ok(answer) => {
                    let begun = CreateMultipartUpload::parse_response(&answer);
                    let unread = |error| BucketError::Refused { answer: format!("{error}") };
                    return Ok(begun.map_err(unread)?.upload_id().to_owned());
                }
                Err(error) => attempts.again(error).await?,
            }
        }
    }

    /// Puts all parts of a file. Returns their tags.
    async fn put_parts(
        &self,
        name: &str,
        upload: &str,
        (file, bytes): (Arc<File>, u64),
        patience: Patience,
    ) -> Result<Vec<String>, BucketError> {
        let (key, size) = (self.key(name), PART_BYTES.max(bytes.div_ceil(PARTS_MAX)));
        let mut tags = Vec::new();
        for (number, at) in (1..).zip((0..bytes).step_by(size as usize)) {
            let part = Part { file: file.clone(), at, bytes: size.min(bytes - at) };
            let sign = |credentials: &Credentials| {
                let bucket = &self.bucket;
                Self::sign(&UploadPart::new(bucket, Some(credentials), &key, number, upload))
            };
            tags.push(self.put_part(name, part, patience, sign).await?);
        }
        Ok(tags)
    }

    /// Puts a part. Returns its tag.
    async fn put_part(
        &self,
        name: &str,
        part: Part,
        patience: Patience,
        sign: impl Fn(&Credentials) -> url::Url,
    ) -> Result<String, BucketError> {
        let _permit = self.parts.acquire().await;
        let (body, mut attempts) = (part.read().await?, Attempts::of(patience));
        loop {
            let url = sign(&self.credentials().await?);
            let asked =
                Signed { body: body.clone(), longest: PART_TIME, ..Signed::of(Method::PUT, url) };
            let asking = asked.send(&self.connector, name, async |answer| {
                let tag = answer.headers().get(header::ETAG).and_then(|tag| tag.to_str().ok());
                Ok(tag.unwrap_or_default().trim_matches('"').to_owned())
            });
            match asking.await {
                Ok(tag) => return Ok(tag),
                Err(error) => attempts.again(error).await?,
            }
        }
    }

    /// Makes the server join the parts.
    async fn complete(
        &self,
        name: &str,
        upload: &str,
        (tags, bytes): (&[String], u64),
        patience: Patience,
    ) -> Result<(), BucketError> {
        let (key, mut attempts) = (self.key(name), Attempts::of(patience));
        loop {
            let credentials = self.credentials().await?;
            let tags = tags.iter().map(String::as_str);
            let (bucket, credentials) = (&self.bucket, Some(&credentials));
            let action = CompleteMultipartUpload::new(bucket, credentials, &key, upload, tags);
            let asked = Signed {
                method: Method::POST,
                url: Self::sign(&action),
                fields: vec![(header::CONTENT_TYPE, "application/xml".to_owned())],
                body: action.body().into(),
                longest: COMPLETION_TIME,
            };
            let error = match asked.send(&self.connector, name, text).await {
                // A success may still have a refusal in its body.
                Ok(answer) if CompleteMultipartUploadResponse::parse(&answer).is_ok() => {
                    return Ok(());
                }
                Ok(answer) => {
                    let (code, message) = (element(&answer, "Code"), element(&answer, "Message"));
                    BucketError::Away { why: format!("{code} {message}") }
                }
                // An earlier attempt, whose answer was lost, has joined the parts.
                Err(BucketError::Refused { answer }) if answer.contains("NoSuchUpload") => {
                    return match self.size(name).await? {
                        Some(stored) if stored == bytes => Ok(()),
                        _ => Err(BucketError::Refused { answer }),
                    };
                }
                Err(error) => error,
            };
            attempts.again(error).await?;
        }
    }

    /// Makes the server drop the parts of an upload.
    async fn abort(&self, name: &str, upload: &str) {
        let key = self.key(name);
        let aborting = async {
            let credentials = self.credentials().await?;
            let bucket = &self.bucket;
            let action = AbortMultipartUpload::new(bucket, Some(&credentials), &key, upload);
            let asked = Signed::of(Method::DELETE, Self::sign(&action));
            asked.send(&self.connector, name, async |_| Ok(())).await
        };
        if let Err(error) = aborting.await {
            tracing::warn!(%error, object = name, "parts of an upload may be left in the bucket");
        }
    }
}

impl Part {
    async fn read(self) -> Result<Bytes, BucketError> {
        let reading = spawn_blocking(move || {
            let mut content = vec![0; self.bytes as usize];
            self.file.read_exact_at(&mut content, self.at).map(|()| content)
        });
        let read = reading.await.unwrap_or_else(|error| Err(std::io::Error::other(error)));
        let failed = |error: std::io::Error| BucketError::Disk { why: error.to_string() };
        read.map(Bytes::from).map_err(failed)
    }
}

/// The text of an answer.
async fn text(answer: Response<Incoming>) -> Result<String, BucketError> {
    let text = whole(answer, ANSWER_BYTES).await?;
    Ok(String::from_utf8_lossy(&text).into_owned())
}
