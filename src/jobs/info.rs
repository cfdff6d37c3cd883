//! A job as the doors report it.

use crate::id::{Id, Kind};
use crate::store::{JobProgress, JobRow, JobState, StoreError, WebhookState};

use super::request::{JobRequest, Part};
use super::{Failure, Report};

/// Marks an [`Id`] as a job's.
#[derive(Debug)]
pub struct OfJob;

impl Kind for OfJob {
    const PREFIX: &str = "job_";
}

/// The id of a job, `job_` and 32 hexadecimal digits.
pub type JobId = Id<OfJob>;

/// The result of a job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct JobResult {
    /// Name of its file.
    pub(super) file: String,
    /// Its size (bytes).
    pub bytes: u64,
}

/// A job.
#[derive(Clone, Debug, PartialEq)]
pub struct JobInfo {
    /// Its id.
    pub id: JobId,
    /// Its state.
    pub state: JobState,
    /// Its options and inputs.
    pub request: JobRequest,
    /// When it arrived (ms since 1970-01-01 UTC).
    pub created_unix_ms: i64,
    /// When its present or last run began.
    pub started_unix_ms: Option<i64>,
    /// When it ended.
    pub ended_unix_ms: Option<i64>,
    /// Number of epochs so far, and of those with a position.
    pub progress: JobProgress,
    /// Its result, if it has succeeded.
    pub result: Option<JobResult>,
    /// Its report, if it has succeeded.
    pub report: Option<Report>,
    /// Why it has failed.
    pub failure: Option<Failure>,
    /// State of the message to its webhook; `None` without a webhook.
    pub webhook_state: Option<WebhookState>,
}

impl JobInfo {
    pub(super) fn of(row: JobRow) -> Result<Self, StoreError> {
        fn parse<T: serde::de::DeserializeOwned>(text: &str) -> Result<T, StoreError> {
            serde_json::from_str(text)
                .map_err(|error| StoreError::CorruptText { what: "job", why: error.to_string() })
        }
        let id = JobId::parse(&row.id).ok_or_else(|| StoreError::CorruptText {
            what: "job id",
            why: format!("{:?} is not the id of a job", row.id),
        })?;
        Ok(Self {
            id,
            state: row.state,
            request: parse(&row.request)?,
            created_unix_ms: row.created_unix_ms,
            started_unix_ms: row.started_unix_ms,
            ended_unix_ms: row.ended_unix_ms,
            progress: row.progress,
            result: row.result.map(|(file, bytes)| JobResult { file, bytes }),
            report: row.report.as_deref().map(parse).transpose()?,
            failure: row.failure.as_deref().map(parse).transpose()?,
            webhook_state: row.webhook_state,
        })
    }

    /// The part of the rover's file or of the session that is read (%). It becomes 100 only when
    /// the result is stored.
    pub fn percent(&self) -> f64 {
        /// The highest value of a job without a result.
        const NOT_DONE: f64 = 99.0;
        if self.state == JobState::Succeeded {
            return 100.0;
        }
        (self.progress.read_bytes as f64 / self.total() as f64 * 100.0).min(NOT_DONE)
    }

    /// Bytes of the rover's file, or the count of the session's epoch numbers.
    fn total(&self) -> u64 {
        match &self.request.session {
            None => self.request.input(Part::Rover).map_or(0, |rover| rover.bytes).max(1),
            Some(session) => session.epochs(),
        }
    }

    /// Time of the present or last run so far (s).
    fn elapsed_s(&self, now_unix_ms: i64) -> Option<f64> {
        let end = self.ended_unix_ms.unwrap_or(now_unix_ms);
        Some((end - self.started_unix_ms?).max(0) as f64 / 1e3)
    }

    /// Epochs per second of the present or last run, without the epochs that it has taken over from
    /// an earlier run.
    pub fn epochs_per_second(&self, now_unix_ms: i64) -> Option<f64> {
        let elapsed_s = self.elapsed_s(now_unix_ms).filter(|elapsed_s| 0.0 < *elapsed_s)?;
        let JobProgress { epochs, resumed_epochs, .. } = self.progress;
        Some(epochs.saturating_sub(resumed_epochs) as f64 / elapsed_s)
    }

    /// Estimated time until a running job ends (s), from the part of the rover's file or of the
    /// session that the present run has read so far.
    pub fn remaining_s(&self, now_unix_ms: i64) -> Option<f64> {
        let JobProgress { read_bytes, resumed_bytes, .. } = self.progress;
        let read = Some(read_bytes.saturating_sub(resumed_bytes)).filter(|read| 0 < *read)?;
        let left = self.total().saturating_sub(read_bytes);
        let elapsed_s = self.elapsed_s(now_unix_ms).filter(|_| self.state == JobState::Running)?;
        Some(elapsed_s * left as f64 / read as f64)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use crate::store::BaseChoice;

    use super::super::request::{BaseOrigin, JobInput, JobOptions};
    use super::*;

    /// A job that has been running for 5 s, with a file of 1000 bytes.
    fn running(progress: JobProgress) -> JobInfo {
        let rover = JobInput {
            part: Part::Rover,
            name: "rover.obs".to_owned(),
            hash: "c0ffee".to_owned(),
            bytes: 1000,
            is_own: false,
            url: None,
            frame: None,
        };
        JobInfo {
            id: JobId::random(),
            state: JobState::Running,
            request: JobRequest::new(options(), vec![rover]),
            created_unix_ms: 0,
            started_unix_ms: Some(5_000),
            ended_unix_ms: None,
            progress,
            result: None,
            report: None,
            failure: None,
            webhook_state: None,
        }
    }

    fn options() -> JobOptions {
        JobOptions {
            mode: "fgo".to_owned(),
            profile: "general".to_owned(),
            overrides: BTreeMap::new(),
            answer: "causal".to_owned(),
            base_position: BaseOrigin::Any,
            format: "pos".to_owned(),
            near_ns: None,
            bases: BaseChoice::None,
            session: None,
            webhook: None,
        }
    }

    /// A run that continued at 600 of 1000 epochs, and has computed 100 in ten seconds.
    #[test]
    fn rate_and_time_left_are_those_of_the_present_run() {
        let (resumed_epochs, resumed_bytes) = (600, 600);
        let (epochs, answered, read_bytes) = (700, 650, 700);
        let progress = JobProgress { epochs, answered, read_bytes, resumed_epochs, resumed_bytes };
        let went_on = running(progress);
        assert_eq!(went_on.percent(), 70.0);
        assert_eq!(went_on.epochs_per_second(15_000), Some(10.0));
        assert_eq!(went_on.remaining_s(15_000), Some(30.0));
        // The present run has read nothing yet, so its time left is unknown.
        let begun = running(JobProgress { read_bytes: 600, ..progress });
        assert_eq!(begun.remaining_s(15_000), None);
        let first = running(JobProgress { resumed_epochs: 0, resumed_bytes: 0, ..progress });
        assert_eq!(first.epochs_per_second(15_000), Some(70.0));
    }
}
