//! The bucket, and its requests with short answers.

use std::path::PathBuf;
use std::time::Duration;

use bytes::Bytes;
use hyper::{Method, header};
use jiff::Timestamp;
use rusty_s3::actions::ListObjectsV2;
use rusty_s3::{Credentials, S3Action, UrlStyle};
use tokio::sync::Semaphore;

use crate::config::{S3Configuration, S3Keys};
use crate::feeds::{Connector, FetchPolicy, TimeLimits};

use super::attempts::Attempts;
use super::send::{Signed, whole};
use super::{BucketError, Listed, ListedPage, Patience};

/// Time for which a signature is valid.
const SIGNED_FOR: Duration = Duration::from_secs(3600);
/// Longest object that is a text, and longest page of a list (bytes).
const TEXT_BYTES: usize = 4 << 10;
const PAGE_BYTES: usize = 8 << 20;
/// Most parts in memory at the same time.
const PARTS: usize = 4;

/// A bucket of an S3 service, or only those of its objects whose names begin with a prefix.
pub(crate) struct Bucket {
    pub(super) bucket: rusty_s3::Bucket,
    /// The prefix of names. It is empty, or ends in a slash.
    prefix: String,
    keys: KeySource,
    pub(super) connector: Connector,
    /// The right to have a part in memory.
    pub(super) parts: Semaphore,
}

/// The source of the credentials.
enum KeySource {
    /// A file. It is read for each request, because the credentials may change.
    File(PathBuf),
    Given(S3Keys),
}

impl Bucket {
    /// Opens a bucket, without a request to its server.
    ///
    /// # Errors
    /// The configuration is wrong, or there are no credentials.
    pub(crate) fn open(configuration: &S3Configuration) -> Result<Self, BucketError> {
        let wrong = |why: String| BucketError::Configuration { why };
        let S3Configuration { endpoint, region, bucket, prefix, path_style, .. } = configuration;
        let url: url::Url =
            endpoint.parse().map_err(|error| wrong(format!("endpoint {endpoint:?}: {error}")))?;
        let style = if *path_style { UrlStyle::Path } else { UrlStyle::VirtualHost };
        let bucket = rusty_s3::Bucket::new(url, style, bucket.clone(), region.clone());
        let bucket = bucket.map_err(|error| wrong(format!("endpoint {endpoint:?}: {error}")))?;
        let base = bucket.base_url();
        let (Some(host), Some(port)) = (base.host_str(), base.port_or_known_default()) else {
            return Err(wrong(format!("endpoint {endpoint:?} has no host")));
        };
        // The operator names this host, so it may be in a private network.
        let policy = FetchPolicy::new(&[format!("{host}:{port}")], true);
        let policy = policy.map_err(|error| wrong(error.to_string()))?;
        let ca_file = configuration.ca_file.as_deref();
        let connector = Connector::new(policy, TimeLimits::standard(), ca_file);
        let connector = connector.map_err(|error| wrong(error.to_string()))?;
        let keys = match (&configuration.credentials_file, &configuration.keys) {
            (Some(path), _) => KeySource::File(path.clone()),
            (None, Some(keys)) => KeySource::Given(keys.clone()),
            (None, None) => {
                let why = "neither jobs.s3.credentials_file nor AWS_ACCESS_KEY_ID and \
                           AWS_SECRET_ACCESS_KEY are given";
                return Err(BucketError::Credentials { why: why.to_owned() });
            }
        };
        let trimmed = prefix.trim_matches('/');
        let prefix = if trimmed.is_empty() { String::new() } else { format!("{trimmed}/") };
        Ok(Self { bucket, prefix, keys, connector, parts: Semaphore::new(PARTS) })
    }

    /// Its name in messages.
    pub(crate) fn name(&self) -> String {
        format!("s3://{}/{}", self.bucket.name(), self.prefix)
    }

    /// The key of an object in the bucket.
    pub(super) fn key(&self, name: &str) -> String {
        format!("{}{name}", self.prefix)
    }

    /// The credentials as they are now.
    ///
    /// # Errors
    /// The file cannot be read, or lacks one.
    pub(super) async fn credentials(&self) -> Result<Credentials, BucketError> {
        let keys = match &self.keys {
            KeySource::Given(keys) => keys.clone(),
            KeySource::File(path) => {
                let failed = |why: String| BucketError::Credentials {
                    why: format!("{}: {why}", path.display()),
                };
                let text = tokio::fs::read_to_string(path).await;
                let text = text.map_err(|error| failed(error.to_string()))?;
                let lacks = || failed("it lacks aws_access_key_id or aws_secret_access_key".into());
                S3Keys::parse(&text).ok_or_else(lacks)?
            }
        };
        Ok(match keys.token {
            Some(token) => Credentials::new_with_token(keys.id, keys.secret, token),
            None => Credentials::new(keys.id, keys.secret),
        })
    }

    /// Signs an action.
    pub(super) fn sign<'a>(action: &impl S3Action<'a>) -> url::Url {
        action.sign(SIGNED_FOR)
    }

    /// The text of a small object; `None` if no object has this name.
    ///
    /// # Errors
    /// The server is away or refuses, or the object is no short text.
    pub(crate) async fn text(&self, name: &str) -> Result<Option<String>, BucketError> {
        let (key, mut attempts) = (self.key(name), Attempts::of(Patience::Call));
        loop {
            let credentials = self.credentials().await?;
            let url = Self::sign(&self.bucket.get_object(Some(&credentials), &key));
            let asked = Signed::of(Method::GET, url);
            let asking = asked.send(&self.connector, name, |answer| whole(answer, TEXT_BYTES));
            match asking.await {
                Ok(text) => return Ok(Some(String::from_utf8_lossy(&text).into_owned())),
                Err(BucketError::Missing { .. }) => return Ok(None),
                Err(error) => attempts.again(error).await?,
            }
        }
    }

    /// Puts a small object, unless an object has this name already.
    ///
    /// # Errors
    /// The server is away or refuses.
    pub(crate) async fn put_text(&self, name: &str, text: &str) -> Result<(), BucketError> {
        let (key, mut attempts) = (self.key(name), Attempts::of(Patience::Call));
        loop {
            let credentials = self.credentials().await?;
            let url = Self::sign(&self.bucket.put_object(Some(&credentials), &key));
            let asked = Signed {
                fields: vec![(header::IF_NONE_MATCH, "*".to_owned())],
                body: Bytes::copy_from_slice(text.as_bytes()),
                ..Signed::of(Method::PUT, url)
            };
            match asked.send(&self.connector, name, async |_| Ok(())).await {
                Ok(()) => return Ok(()),
                // Another request has put it first.
                Err(BucketError::Refused { answer }) if answer.starts_with("412") => return Ok(()),
                Err(error) => attempts.again(error).await?,
            }
        }
    }

    /// The size of an object (bytes); `None` if no object has this name.
    ///
    /// # Errors
    /// The server is away or refuses.
    pub(crate) async fn size(&self, name: &str) -> Result<Option<u64>, BucketError> {
        // Not by HEAD, because a refusal of HEAD has no code.
        let (page, _) = self.page(name, None).await?;
        Ok(page.into_iter().find(|object| object.name == name).map(|object| object.bytes))
    }

    /// A page of the objects whose names begin with `begin`: the first, or the page of a token.
    ///
    /// # Errors
    /// The server is away or refuses, or its answer is no list.
    pub(crate) async fn page(
        &self,
        begin: &str,
        token: Option<String>,
    ) -> Result<ListedPage, BucketError> {
        let (begin, mut attempts) = (self.key(begin), Attempts::of(Patience::Call));
        loop {
            let credentials = self.credentials().await?;
            let url = {
                let mut list = self.bucket.list_objects_v2(Some(&credentials));
                list.with_prefix(begin.as_str());
                if let Some(token) = &token {
                    list.with_continuation_token(token.as_str());
                }
                Self::sign(&list)
            };
            let asked = Signed::of(Method::GET, url);
            let asking = asked.send(&self.connector, &begin, |answer| whole(answer, PAGE_BYTES));
            match asking.await {
                Ok(text) => return self.listed(&text),
                Err(error) => attempts.again(error).await?,
            }
        }
    }

    fn listed(&self, text: &[u8]) -> Result<ListedPage, BucketError> {
        let no_list = |why: String| BucketError::Refused { answer: format!("no list: {why}") };
        let text = str::from_utf8(text).map_err(|error| no_list(error.to_string()))?;
        let list =
            ListObjectsV2::parse_response(text).map_err(|error| no_list(error.to_string()))?;
        let now = Timestamp::now();
        let objects = list.contents.into_iter().filter_map(|object| {
            let modified: Option<Timestamp> = object.last_modified.and_then(|t| t.parse().ok());
            // An object without a time counts as new.
            let age = modified.map_or(Duration::ZERO, |modified| {
                Duration::try_from(now.duration_since(modified)).unwrap_or_default()
            });
            let name = object.key.strip_prefix(&self.prefix)?.to_owned();
            Some(Listed { name, bytes: object.size.unwrap_or(0), age })
        });
        Ok((objects.collect(), list.next_continuation_token))
    }

    /// Deletes an object, if there is one.
    ///
    /// # Errors
    /// The server is away or refuses.
    pub(crate) async fn delete(&self, name: &str) -> Result<(), BucketError> {
        let (key, mut attempts) = (self.key(name), Attempts::of(Patience::Call));
        loop {
            let credentials = self.credentials().await?;
            let url = Self::sign(&self.bucket.delete_object(Some(&credentials), &key));
            let asked = Signed::of(Method::DELETE, url);
            match asked.send(&self.connector, name, async |_| Ok(())).await {
                Ok(()) | Err(BucketError::Missing { .. }) => return Ok(()),
                Err(error) => attempts.again(error).await?,
            }
        }
    }
}
