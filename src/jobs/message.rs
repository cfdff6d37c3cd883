//! The message that informs a webhook of the end of a job.

use bytes::Bytes;
use serde_json::json;

use crate::clock::utc;
use crate::feeds::{FetchError, Url};

use super::info::JobInfo;
use super::webhook::WebhookSecret;

/// A message as it is sent.
pub(super) struct Message {
    pub(super) url: Url,
    pub(super) fields: [(&'static str, String); 3],
    pub(super) body: Bytes,
}

impl Message {
    /// The message for the end of a job. All attempts have the same id and body.
    ///
    /// # Errors
    /// The URL is invalid.
    pub(super) fn of(
        job: &JobInfo,
        secret: &WebhookSecret,
        unix_ms: i64,
    ) -> Result<Self, FetchError> {
        let (id, unix_s) = (job.id.as_str(), unix_ms / 1000);
        let body = content(job);
        let fields = [
            ("webhook-id", id.to_owned()),
            ("webhook-timestamp", unix_s.to_string()),
            ("webhook-signature", secret.sign(id, unix_s, body.as_bytes())),
        ];
        let url = job.request.options.webhook.as_deref().unwrap_or_default().parse()?;
        Ok(Self { url, fields, body: body.into() })
    }
}

/// The body of a message.
fn content(job: &JobInfo) -> String {
    let path = format!("/v1/jobs/{}", job.id);
    let mut links = json!({"job": path});
    if job.result.is_some() {
        links["result"] = format!("{path}/result").into();
        links["report"] = format!("{path}/report").into();
    }
    let failure = job.failure.as_ref().map(|failure| failure.code.as_str());
    let (id, state) = (job.id.as_str(), job.state.name());
    let data = json!({"job": id, "state": state, "failure": failure, "links": links});
    let timestamp = job.ended_unix_ms.map(utc);
    json!({"type": "job.ended", "timestamp": timestamp, "data": data}).to_string()
}
