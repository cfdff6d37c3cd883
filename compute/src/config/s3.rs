//! Options of a bucket of an S3 service, in which the files of jobs are.

use std::fmt;
use std::path::PathBuf;

use serde::Deserialize;

/// A bucket of an S3 service. Everything in it under the prefix belongs to this service, or to the
/// nodes and workers on its database.
#[derive(Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct S3Configuration {
    /// Address of the service, such as `https://s3.eu-central-1.amazonaws.com`.
    pub endpoint: String,
    /// Region for which requests are signed; most services other than Amazon's take any.
    #[serde(default = "standard_region")]
    pub region: String,
    /// Name of the bucket, which must exist.
    pub bucket: String,
    /// What the names of all objects begin with, without the slash at its end; empty for none.
    #[serde(default)]
    pub prefix: String,
    /// Whether the bucket stands in the path of an address, and not in the name of the host.
    #[serde(default = "is_in_path")]
    pub path_style: bool,
    /// File with `aws_access_key_id = …` and `aws_secret_access_key = …`, as other programs have
    /// it. Without it the environment has `AWS_ACCESS_KEY_ID` and `AWS_SECRET_ACCESS_KEY`.
    pub credentials_file: Option<PathBuf>,
    /// PEM file of certificate authorities trusted besides the usual ones.
    pub ca_file: Option<PathBuf>,
    /// The credentials themselves; from the environment only.
    #[serde(skip)]
    pub keys: Option<S3Keys>,
}

/// Credentials of an S3 service.
#[derive(Clone, PartialEq, Eq)]
pub struct S3Keys {
    /// Id of the key.
    pub id: String,
    /// The key.
    pub secret: String,
    /// Token of credentials that are valid for some time only.
    pub token: Option<String>,
}

fn standard_region() -> String {
    "us-east-1".to_owned()
}

const fn is_in_path() -> bool {
    true
}

impl S3Keys {
    /// The keys of a file of credentials: those of its first profile. `None` if one is missing.
    pub fn parse(text: &str) -> Option<Self> {
        let value = |wanted: &str| {
            let pairs = text.lines().filter_map(|line| line.split_once('='));
            let mut named = pairs.filter(|(name, _)| name.trim() == wanted);
            named.next().map(|(_, value)| value.trim().to_owned()).filter(|v| !v.is_empty())
        };
        Some(Self {
            id: value("aws_access_key_id")?,
            secret: value("aws_secret_access_key")?,
            token: value("aws_session_token"),
        })
    }
}

impl S3Configuration {
    /// What is wrong; `None` if nothing is.
    pub(super) fn wrong(&self) -> Option<&'static str> {
        let is_name = |text: &str| {
            text.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_'))
        };
        if self.bucket.is_empty() || !is_name(&self.bucket) {
            return Some("jobs.s3.bucket must have letters, digits, points, - and _ only");
        }
        let mut segments = self.prefix.trim_matches('/').split('/');
        let is_sound = |s: &str| is_name(s) && !s.is_empty() && s != "." && s != "..";
        if !self.prefix.is_empty() && !segments.all(is_sound) {
            return Some("jobs.s3.prefix must be names with slashes between, such as rovers/jobs");
        }
        None
    }
}

// Credentials are left out.
impl fmt::Debug for S3Configuration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("S3Configuration")
            .field("endpoint", &self.endpoint)
            .field("region", &self.region)
            .field("bucket", &self.bucket)
            .field("prefix", &self.prefix)
            .field("path_style", &self.path_style)
            .field("credentials_file", &self.credentials_file)
            .field("ca_file", &self.ca_file)
            .finish_non_exhaustive()
    }
}

impl fmt::Debug for S3Keys {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("S3Keys").finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn credentials_are_read_and_not_shown() {
        let text = "[default]\naws_access_key_id = ID\naws_secret_access_key=a/b+c=\n\n\
                    [other]\naws_access_key_id = X\naws_session_token = T";
        let keys = S3Keys::parse(text).unwrap();
        assert_eq!((&*keys.id, &*keys.secret), ("ID", "a/b+c="));
        assert_eq!(S3Keys::parse("aws_access_key_id = ID\naws_secret_access_key ="), None);
        let text = "endpoint = \"http://h:9000\"\nbucket = \"b\"\ncredentials_file = \"/k\"";
        let read: S3Configuration = toml::from_str(text).unwrap();
        let shown = format!("{:?}", S3Configuration { keys: Some(keys), ..read.clone() });
        assert!(shown.contains("/k") && !shown.contains("a/b+c"), "{shown}");
        assert!(read.path_style && read.region == "us-east-1");
    }

    #[test]
    fn names_are_checked() {
        let wrong = |bucket: &str, prefix: &str| {
            let text = format!("endpoint = \"\"\nbucket = \"{bucket}\"\nprefix = \"{prefix}\"");
            toml::from_str::<S3Configuration>(&text).unwrap().wrong()
        };
        for (bucket, prefix) in [("b", ""), ("a.b-c", "x"), ("b", "x/y/")] {
            assert_eq!(wrong(bucket, prefix), None);
        }
        for (bucket, prefix) in [("", ""), ("a/b", ""), ("b", "x//y"), ("b", ".."), ("b", "ä")] {
            assert!(wrong(bucket, prefix).is_some(), "{bucket} {prefix}");
        }
    }
}
