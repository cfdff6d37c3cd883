//! The outcome of a job: the report of a success, the reason of a failure.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::aiding::AidingError;
use crate::formats::UnpackError;
use crate::recording::{Provenance, RecordingError, Tally};
use crate::refusal::Code;
use crate::session::SessionError;

/// What the user can do about a base of a file whose frame is unknown.
const BASE_FRAME_REMEDY: &str = "give the override base_frame, or leave out frame";

/// The report of a job that has succeeded.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Version of the program that computed it.
    pub version: String,
    /// Hash of the configuration.
    pub configuration_hash: String,
    /// Number of epochs.
    pub epochs: u64,
    /// Number of epochs with a position.
    pub answered: u64,
    /// Time from the start of the run to its end (s).
    pub seconds: f64,
    /// Number of epochs with each status.
    pub statuses: Vec<(String, u64)>,
    /// Number of epochs with each reason, by code.
    pub reasons: Vec<(String, u64)>,
    /// What the user can do about each reason, by its code.
    #[serde(default)]
    pub remedies: BTreeMap<String, String>,
    /// What the positions rest on; lines that need attention begin with "warning: ".
    pub provenance: Vec<String>,
    /// Parts of the files that were skipped.
    pub skipped: Vec<String>,
}

/// Why a job has no result.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Failure {
    /// The stable code.
    pub code: String,
    /// What is wrong; for a file, with the line or byte at fault.
    pub message: String,
    /// The part of the upload at fault.
    pub field: Option<String>,
    /// What the user can do about it.
    pub remedy: String,
}

impl Report {
    /// The report of a run.
    pub(super) fn of(tally: &Tally, provenance: &Provenance, hash: String, seconds: f64) -> Self {
        let counted = |counts: &[(&'static str, u64)]| {
            counts.iter().map(|(name, count)| ((*name).to_owned(), *count)).collect()
        };
        let owned = |code: &str, text: &str| (code.to_owned(), text.to_owned());
        let skipped = provenance.left_out.iter().flat_map(|(name, left_out)| {
            let text = left_out.to_string();
            text.lines().map(|line| format!("{name}: {line}")).collect::<Vec<_>>()
        });
        Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            configuration_hash: hash,
            epochs: tally.epochs,
            answered: tally.answered,
            seconds,
            statuses: counted(&tally.statuses),
            reasons: counted(&tally.reasons),
            remedies: tally.remedies.iter().map(|(code, text)| owned(code, text)).collect(),
            provenance: provenance.lines(),
            skipped: skipped.collect(),
        }
    }
}

impl Failure {
    pub(super) fn new(code: Code, message: String, field: Option<&str>) -> Self {
        Self {
            code: code.name().to_owned(),
            message,
            field: field.map(ToOwned::to_owned),
            remedy: code.remedy().to_owned(),
        }
    }

    /// Whether the database has failed. The job is not at fault.
    pub(super) fn is_of_database(&self) -> bool {
        self.code == Code::DatabaseFailed.name()
    }

    pub(super) fn with_remedy(self, remedy: &str) -> Self {
        Self { remedy: remedy.to_owned(), ..self }
    }

    /// The failure of a file that its host does not serve.
    pub(super) fn of_fetching(code: Code, message: String, part: Option<&str>) -> Self {
        let failure = Self::new(code, message, part);
        match code {
            Code::HostUnreachable | Code::FileCut | Code::HostSlow | Code::HostRefuses => {
                failure.with_remedy("create the job again when the host serves the file")
            }
            _ => failure,
        }
    }

    /// The failure of a file that is larger, unpacked, than allowed.
    pub(super) fn of_unpacking(error: UnpackError, part: &str) -> Self {
        let code = match error {
            UnpackError::TooLarge { .. } => Code::JobTooLarge,
            UnpackError::Ratio { .. } => Code::CompressedTooMuch,
        };
        Self::new(code, format!("{part}: {error}"), Some(part))
    }

    /// The failure of a session that cannot be positioned again.
    pub(super) fn of_session(error: &SessionError) -> Self {
        match error {
            SessionError::NotFound { id } => {
                let message = format!("session {id:?} was deleted after the job was created");
                let failure = Self::new(error.code(), message, Some("options.session"));
                failure.with_remedy("create the job with a session that is stored")
            }
            SessionError::NoEpochInSpan { .. } => {
                Self::new(error.code(), error.to_string(), Some("options.from"))
            }
            SessionError::Aiding(AidingError::BaseNotFound { .. }) => {
                Self::new(error.code(), error.to_string(), Some("options.base"))
            }
            _ => Self::new(error.code(), error.to_string(), None),
        }
    }

    /// The failure of a job whose claims were lost.
    pub(super) fn of_lost_claims(count: u64) -> Self {
        let message = format!("{count} processes that ran the job have ended or were frozen");
        Self::new(Code::JobLost, message, None)
    }

    /// The failure of a session with more epochs than are answered at once.
    pub(super) fn of_long_batch(limit: u64) -> Self {
        let message = format!("a batch has at most {limit} epochs of a session, this one has more");
        let failure = Self::new(Code::JobTooLarge, message, Some("options.batch"));
        failure.with_remedy("give from and to, or smoothed in place of batch")
    }

    /// The failure of a recording. The names of its inputs are those of the parts.
    pub(super) fn of_recording(error: &RecordingError) -> Self {
        let new = |code, field| Self::new(code, error.to_string(), field);
        match error {
            RecordingError::NotReadable { name, .. } => new(Code::JobFilesFailed, Some(name)),
            RecordingError::NotUnderstood { name, remedy, .. } => {
                new(Code::FileNotUnderstood, Some(name)).with_remedy(remedy)
            }
            RecordingError::NoReferenceTime { name } => {
                let remedy = "give near, a time within half a day of the first message";
                new(Code::NoReferenceTime, Some(name)).with_remedy(remedy)
            }
            RecordingError::NavigationRequired { .. } => {
                new(Code::NavigationRequired, Some("navigation"))
            }
            RecordingError::BasePositionMissing { .. } => {
                new(Code::BasePositionMissing, Some("base")).with_remedy("give basePosition")
            }
            RecordingError::BaseRequired { .. } => new(Code::BaseRequired, Some("base")),
            RecordingError::FrameUnavailable { .. } => {
                new(Code::FrameUnavailable, Some("options.overrides.frame"))
                    .with_remedy(BASE_FRAME_REMEDY)
            }
            RecordingError::NoSuchAnswer { .. } => new(Code::InvalidField, Some("options")),
            RecordingError::NoEpochs { name } => {
                let remedy = "give the part rover a file of observations";
                new(Code::NoEpochs, Some(name)).with_remedy(remedy)
            }
        }
    }
}
