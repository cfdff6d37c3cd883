//! Why a request to a bucket fails.

use crate::refusal::Code;

/// Why a request to a bucket fails.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BucketError {
    /// This program has no client of S3.
    #[error("jobs.s3 is only in a build with the feature \"s3\"")]
    NotBuilt,
    /// The configuration contradicts itself, or names something that does not exist.
    #[error("jobs.s3: {why}")]
    Configuration {
        /// What is wrong.
        why: String,
    },
    /// There are no credentials, or they cannot be read.
    #[error("the credentials of the bucket: {why}")]
    Credentials {
        /// What is wrong.
        why: String,
    },
    /// The server cannot be reached, does not answer, or cannot serve now.
    #[error("the server of the bucket is away: {why}")]
    Away {
        /// What happened.
        why: String,
    },
    /// The server refuses the request.
    #[error("the server of the bucket refuses: {answer}")]
    Refused {
        /// Status, code and message of the answer.
        answer: String,
    },
    /// The bucket does not have the object.
    #[error("the bucket has no object {name}")]
    Missing {
        /// Its name.
        name: String,
    },
    /// The object differs from the one that was put.
    #[error("the object {name} of the bucket is damaged: {why}")]
    Damaged {
        /// Its name.
        name: String,
        /// What is wrong.
        why: String,
    },
    /// The file on the disk cannot be read.
    #[error("reading a file for the bucket: {why}")]
    Disk {
        /// What the system reports.
        why: String,
    },
}

impl BucketError {
    /// The stable code.
    pub const fn code(&self) -> Code {
        match self {
            Self::NotBuilt => Code::FeatureNotBuilt,
            Self::Configuration { .. } => Code::ConfigurationMalformed,
            Self::Away { .. } => Code::BucketUnavailable,
            Self::Credentials { .. } | Self::Refused { .. } => Code::BucketRefuses,
            Self::Missing { .. } | Self::Damaged { .. } | Self::Disk { .. } => Code::JobFilesFailed,
        }
    }
}
