//! The type that replaces a bucket in a build without the feature `s3`. It has no values.

use std::convert::Infallible;
use std::fs::File;
use std::sync::Arc;

use bytes::Bytes;
use tokio::sync::mpsc;

use crate::config::S3Configuration;

use super::{BucketError, ListedPage, Patience};

/// A bucket in a build that cannot have one.
pub(crate) struct Bucket(Infallible);

impl Bucket {
    /// Refuses the configuration.
    ///
    /// # Errors
    /// Always.
    pub(crate) fn open(_: &S3Configuration) -> Result<Self, BucketError> {
        Err(BucketError::NotBuilt)
    }

    pub(crate) fn name(&self) -> String {
        match self.0 {}
    }

    pub(crate) async fn text(&self, _: &str) -> Result<Option<String>, BucketError> {
        match self.0 {}
    }

    pub(crate) async fn put_text(&self, _: &str, _: &str) -> Result<(), BucketError> {
        match self.0 {}
    }

    pub(crate) async fn size(&self, _: &str) -> Result<Option<u64>, BucketError> {
        match self.0 {}
    }

    pub(crate) async fn page(&self, _: &str, _: Option<String>) -> Result<ListedPage, BucketError> {
        match self.0 {}
    }

    pub(crate) async fn delete(&self, _: &str) -> Result<(), BucketError> {
        match self.0 {}
    }

    pub(crate) async fn put(
        &self,
        _: &str,
        _: (Arc<File>, u64),
        _: Patience,
    ) -> Result<(), BucketError> {
        match self.0 {}
    }

    pub(crate) async fn download(
        &self,
        _: (&str, u64),
        _: Patience,
        _: &mpsc::Sender<Bytes>,
    ) -> Result<(), BucketError> {
        match self.0 {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::refusal::Code;

    #[test]
    fn a_bucket_is_a_feature_of_the_build() {
        let configuration = S3Configuration {
            endpoint: "https://s3.example.org".to_owned(),
            region: "us-east-1".to_owned(),
            bucket: "jobs".to_owned(),
            prefix: String::new(),
            path_style: true,
            credentials_file: None,
            ca_file: None,
            keys: None,
        };
        let refused = Bucket::open(&configuration).err().unwrap();
        assert_eq!(refused.code(), Code::FeatureNotBuilt);
        assert!(refused.to_string().contains("\"s3\""), "{refused}");
    }
}
