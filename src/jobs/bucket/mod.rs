//! A bucket of an S3 service: objects in it are put, fetched, listed and deleted by their names.
//!
//! It knows nothing of jobs. An object is sent in parts and received in chunks, so that none is in
//! memory as a whole. A request that fails for a temporary reason is sent again, as many times as
//! its [`Patience`] allows. A build without the feature `s3` has no bucket.
//!
//! Source: Amazon Simple Storage Service API Reference, 2006-03-01; presigned requests of Signature
//! Version 4, by `rusty-s3`.

#[cfg(not(feature = "s3"))]
mod absent;
mod asked;
#[cfg(feature = "s3")]
mod attempts;
#[cfg(feature = "s3")]
mod client;
#[cfg(feature = "s3")]
mod download;
mod error;
#[cfg(feature = "s3")]
mod send;
#[cfg(feature = "s3")]
mod upload;

#[cfg(not(feature = "s3"))]
pub(crate) use absent::Bucket;
pub(crate) use asked::{Listed, ListedPage, Patience};
#[cfg(feature = "s3")]
pub(crate) use client::Bucket;
pub use error::BucketError;
