//! Errors of the desks and tools as refusals. Each keeps its code and gets the field at fault.

use crate::aiding::AidingError;
use crate::aiding::bases::{BaseEpochRefusal, BaseFileError};
use crate::config::{ConfigError, PositioningOptions};
use crate::feeds::FetchError;
use crate::formats::rinex::RinexError;
use crate::formats::{GunzipError, UnpackError, unpack_error};
use crate::jobs::JobError;
use crate::keys::KeyError;
use crate::quotas::QuotaError;
use crate::reception::ReceptionError;
use crate::refusal::Code;
use crate::session::{EpochRefusal, SessionError};
use crate::store::StoreError;

use super::refusal::spread;
use super::{Lease, Refusal};

impl From<ConfigError> for Refusal {
    fn from(error: ConfigError) -> Self {
        let field = match &error {
            ConfigError::UnknownKey { key, .. } => format!("overrides.{key}"),
            ConfigError::InvalidValue { key, .. } | ConfigError::FeatureNotBuilt { key, .. } => {
                format!("overrides.{key}")
            }
            ConfigError::UnknownMode { .. } => "mode".to_owned(),
            ConfigError::UnknownProfile { .. } => "profile".to_owned(),
        };
        let message = match &error {
            ConfigError::UnknownKey { .. } => format!("{error}; known are {}", option_names()),
            _ => error.to_string(),
        };
        Self::new(error.code(), message).at(field)
    }
}

/// The names of all options of all modes.
fn option_names() -> String {
    PositioningOptions::names().collect::<Vec<_>>().join(", ")
}

impl From<RinexError> for Refusal {
    fn from(error: RinexError) -> Self {
        Self::from(&error)
    }
}

impl From<UnpackError> for Refusal {
    fn from(error: UnpackError) -> Self {
        let code = match error {
            UnpackError::TooLarge { .. } => Code::DecompressedTooLarge,
            UnpackError::Ratio { .. } => Code::CompressedTooMuch,
        };
        Self::new(code, error.to_string())
    }
}

impl From<&RinexError> for Refusal {
    fn from(error: &RinexError) -> Self {
        let refusal = Self::new(error.code(), error.to_string()).on_line(error.line());
        let RinexError::ReadFailed { line, source } = error else { return refusal };
        match (unpack_error(source), GunzipError::of(source)) {
            (Some(unpacking), _) => Self::from(unpacking).on_line(*line),
            (None, Some(damage)) => refusal.on_byte(damage.offset),
            (None, None) => refusal,
        }
    }
}

impl From<ReceptionError> for Refusal {
    fn from(error: ReceptionError) -> Self {
        match &error {
            ReceptionError::Rinex(error) => Self::from(&**error),
            ReceptionError::GnssLogger(log) => {
                Self::new(error.code(), error.to_string()).on_line(log.line())
            }
            _ => Self::new(error.code(), error.to_string()).at("content"),
        }
    }
}

/// A failure of the service. The message names the request, so that the operator finds the cause in
/// the log.
fn failure(code: Code) -> Refusal {
    let request = Lease::current().map(|lease| format!("; request {}", lease.request_id()));
    Refusal::new(code, format!("the database failed{}", request.unwrap_or_default()))
}

impl From<StoreError> for Refusal {
    fn from(error: StoreError) -> Self {
        let refusal = Self::new(error.code(), error.to_string());
        let refusal = match &error {
            StoreError::Database { .. }
            | StoreError::Unconfirmed { .. }
            | StoreError::Down { .. }
            | StoreError::Corrupt { .. }
            | StoreError::CorruptText { .. } => failure(error.code()).because(error.to_string()),
            StoreError::BaseDeleted { .. } => refusal.at("base"),
            StoreError::PageToken { .. } => refusal.at("pageToken"),
            StoreError::PageSize { .. } => refusal.at("pageSize"),
            _ => refusal,
        };
        refusal.retry_after(SessionError::from(error).retry_after())
    }
}

impl From<KeyError> for Refusal {
    fn from(error: KeyError) -> Self {
        let field = match &error {
            KeyError::Store(error) => return error.clone().into(),
            KeyError::UnknownRight { index, .. } => Some(format!("rights[{index}]")),
            KeyError::NoRights => Some("rights".to_owned()),
            KeyError::LabelTooLong { .. } | KeyError::LabelControl { .. } => {
                Some("label".to_owned())
            }
            KeyError::NotFound { .. } => Some("key".to_owned()),
            _ => None,
        };
        let delay = match error {
            KeyError::TooManyAttempts { retry_after } => Some(spread(retry_after)),
            _ => None,
        };
        let refusal = Self::new(error.code(), error.to_string()).retry_after(delay);
        refusal.at_some(field.as_deref())
    }
}

impl From<QuotaError> for Refusal {
    fn from(error: QuotaError) -> Self {
        match error {
            QuotaError::Store(error) => error.into(),
            QuotaError::Changed { .. } => Self::new(error.code(), error.to_string()).at("etag"),
            QuotaError::NotFound { .. } => Self::new(error.code(), error.to_string()).at("tenant"),
            error => {
                let delay = spread(error.retry_after());
                Self::new(error.code(), error.to_string()).retry_after(Some(delay))
            }
        }
    }
}

impl From<AidingError> for Refusal {
    fn from(error: AidingError) -> Self {
        let field = match error {
            AidingError::Store(error) => return error.into(),
            AidingError::LabelTooLong { .. } => Some("label"),
            AidingError::BaseNotFound { .. }
            | AidingError::BaseInUse { .. }
            | AidingError::BaseOfOperator { .. }
            | AidingError::BasePositionMissing { .. }
            | AidingError::BasePositionRefused { .. } => Some("base"),
            AidingError::RequestConflict { .. } => Some("requestId"),
            AidingError::AntennaUnknown { .. } => Some("antenna"),
            AidingError::TooManyEphemerides { .. }
            | AidingError::TooManyBases { .. }
            | AidingError::BaseTooLarge { .. }
            | AidingError::Contended => None,
        };
        Self::new(error.code(), error.to_string()).at_some(field)
    }
}

impl From<BaseFileError> for Refusal {
    fn from(error: BaseFileError) -> Self {
        match &error {
            BaseFileError::Rinex(error) => Self::from(error),
            _ => Self::new(error.code(), error.to_string()),
        }
    }
}

impl From<FetchError> for Refusal {
    fn from(error: FetchError) -> Self {
        let field = match &error {
            FetchError::CasterInvalid { .. } | FetchError::HostNotAllowed { .. } => {
                Some("ntrip.caster")
            }
            FetchError::MountpointInvalid { .. } => Some("ntrip.mountpoint"),
            FetchError::UrlInvalid { .. } | FetchError::TemplateWithoutDay { .. } => {
                Some("archive.template")
            }
            _ => None, // Of a connection, for which no call waits.
        };
        Self::new(error.code(), error.to_string()).at_some(field)
    }
}

impl From<BaseEpochRefusal> for Refusal {
    fn from(refusal: BaseEpochRefusal) -> Self {
        let field = match refusal {
            BaseEpochRefusal::Conflict { .. } | BaseEpochRefusal::OutOfOrder { .. } => "time",
            BaseEpochRefusal::TooManyObservations { .. } => "observations",
        };
        Self::new(refusal.code(), refusal.to_string()).at(field)
    }
}

impl From<SessionError> for Refusal {
    fn from(error: SessionError) -> Self {
        let field = match error {
            SessionError::Configuration(error) => return error.into(),
            SessionError::UnknownCleared(error) => {
                return Self::from(error).at("clearOverrides");
            }
            SessionError::Store(error) => return error.into(),
            SessionError::Aiding(error) => return error.into(),
            SessionError::Raw(error) => return error.into(),
            SessionError::ChunkTooLarge { .. } | SessionError::RawConflict { .. } => {
                Some("content")
            }
            SessionError::RawGap { .. } => Some("offset"),
            SessionError::BaseRequired { .. } => Some("base"),
            SessionError::Frame(_) => Some("overrides.frame"),
            SessionError::GeoidMissing => Some("overrides.geoid"),
            SessionError::TooManyCandidates { .. } | SessionError::BaseNamedTwice { .. } => {
                Some("bases")
            }
            SessionError::NotFound { .. }
            | SessionError::Closed { .. }
            | SessionError::TooManyArcs { .. }
            | SessionError::Empty { .. } => Some("session"),
            SessionError::RequestConflict { .. } => Some("requestId"),
            SessionError::Changed { .. } => Some("etag"),
            SessionError::NoEpochInSpan { .. } | SessionError::SpanTooLong { .. } => Some("from"),
            SessionError::NoSuchEpoch { .. } => Some("seq"),
            SessionError::TooManyPoints { .. } => Some("points"),
            SessionError::LabelTooLong { .. } => Some("label"),
            SessionError::RetentionTooLong { .. } => Some("retentionDays"),
            SessionError::WindowTooLong { .. } => Some("overrides.window_epochs_max"),
            SessionError::NoEpochs
            | SessionError::TooManyEpochs { .. }
            | SessionError::BurstOutOfOrder { .. }
            | SessionError::BurstBeforeGps { .. }
            | SessionError::TooCostly { .. }
            | SessionError::TooManyObservations { .. } => Some("epochs"),
            SessionError::MailboxFull { .. }
            | SessionError::Overloaded { .. }
            | SessionError::TooManyActive { .. }
            | SessionError::TooManyUpdates { .. }
            | SessionError::Quota(_)
            | SessionError::Draining
            | SessionError::EstimatorFailed { .. }
            | SessionError::ReplayStartMissing { .. }
            | SessionError::Interrupted => None,
        };
        let refusal = Self::new(error.code(), error.to_string()).at_some(field);
        refusal.retry_after(error.retry_after())
    }
}

impl From<JobError> for Refusal {
    fn from(error: JobError) -> Self {
        let field = match error {
            JobError::Configuration(error) => return Self::from(error).within("options"),
            JobError::Session(SessionError::Store(error)) => return error.into(),
            JobError::Session(error) => return Self::from(error).within("options"),
            JobError::Store(error) => return error.into(),
            JobError::Quota(error) => return error.into(),
            JobError::NotFound { .. }
            | JobError::NotEnded { .. }
            | JobError::WithoutResult { .. } => Some("job"),
            JobError::IdempotencyConflict { .. } => Some("Idempotency-Key"),
            JobError::InvalidOption { field, .. } | JobError::Fetch { field, .. } => Some(field),
            JobError::UploadNotFound { .. } => Some("upload"),
            JobError::UploadOffset { .. } => Some("Upload-Offset"),
            JobError::Frame(_) => Some("options.overrides.frame"),
            JobError::FormatNotBuilt { .. } => Some("options.format"),
            JobError::GeoidMissing => Some("options.overrides.geoid"),
            JobError::Off
            | JobError::TooMany { .. }
            | JobError::TooManyArriving { .. }
            | JobError::TooManyArrivingOfTenant { .. }
            | JobError::TooManyUploads { .. }
            | JobError::FileTooLarge { .. }
            | JobError::TooManyFiles { .. }
            | JobError::SpaceExhausted { .. }
            | JobError::Disk { .. }
            | JobError::UploadBusy { .. }
            | JobError::UploadTooLong { .. }
            | JobError::UploadIncomplete { .. }
            | JobError::WorkerOnSqlite
            | JobError::FolderDiffers { .. }
            | JobError::FolderNotShared { .. }
            | JobError::Bucket(_)
            | JobError::Draining => None,
        };
        let delay = error.retry_after().map(spread);
        Self::new(error.code(), error.to_string()).at_some(field).retry_after(delay)
    }
}

impl From<EpochRefusal> for Refusal {
    fn from(refusal: EpochRefusal) -> Self {
        Self::new(refusal.code(), refusal.to_string()).at(refusal.field())
    }
}

#[cfg(test)]
mod tests {
    use crate::config::{Mode, Profile};

    use super::*;

    /// The message lists exactly the options that can be set.
    #[test]
    fn an_unknown_option_is_told_those_of_all_modes() {
        let mut options = PositioningOptions::new(Mode::RtkFgo, Profile::General);
        let error = options.set("nope", "1").unwrap_err();
        let message = Refusal::from(error).message;
        let (_, listed) = message.split_once("known are ").unwrap();
        let listed: Vec<&str> = listed.split(", ").collect();
        for name in ["systems", "window_s", "motion", "differencing.pseudorange_sigma_m", "geoid"] {
            assert!(listed.contains(&name), "{name} is not in {message}");
        }
        let shown: Vec<&str> = options.entries().iter().map(|entry| entry.name).collect();
        assert_eq!(listed, shown, "rtk-fgo has every option");
    }

    #[test]
    fn a_failure_tells_its_cause_to_the_log_only() {
        let why = "\"x\" in /var/lib/graphfix.db".to_owned();
        let refusal = Refusal::from(StoreError::CorruptText { what: "base id", why: why.clone() });
        assert_eq!(refusal.code, Code::StoredDataCorrupt);
        assert!(!refusal.message.contains(&why), "{refusal}");
        assert!(refusal.logged().contains(&why), "{}", refusal.logged());
    }
}
