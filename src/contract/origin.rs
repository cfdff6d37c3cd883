//! Errors of the desks and tools as refusals: one `match` for each.

use crate::aiding::AidingError;
use crate::aiding::bases::{BaseEpochRefusal, BaseFileError};
use crate::config::{ConfigError, Mode, PositioningOptions, Profile};
use crate::feeds::FetchError;
use crate::formats::rinex::RinexError;
use crate::reception::ReceptionError;
use crate::session::{EpochRefusal, SessionError};
use crate::store::StoreError;

use super::{Code, Refusal};

impl From<ConfigError> for Refusal {
    fn from(error: ConfigError) -> Self {
        let (code, field) = match &error {
            ConfigError::UnknownKey { key, .. } => {
                (Code::UnknownOption, format!("overrides.{key}"))
            }
            ConfigError::InvalidValue { key, .. } => {
                (Code::InvalidOptionValue, format!("overrides.{key}"))
            }
            ConfigError::FeatureNotBuilt { key, .. } => {
                (Code::FeatureNotBuilt, format!("overrides.{key}"))
            }
            ConfigError::UnknownMode { .. } => (Code::UnknownMode, "mode".to_owned()),
            ConfigError::UnknownProfile { .. } => (Code::UnknownProfile, "profile".to_owned()),
        };
        let message = match &error {
            ConfigError::UnknownKey { .. } => format!("{error}; there are {}", option_names()),
            _ => error.to_string(),
        };
        Self::new(code, message).at(field)
    }
}

/// Every option there is.
fn option_names() -> String {
    let options = PositioningOptions::new(Mode::Spp, Profile::General);
    options.entries().iter().map(|entry| entry.name).collect::<Vec<_>>().join(", ")
}

impl From<RinexError> for Refusal {
    fn from(error: RinexError) -> Self {
        Self::from(&error)
    }
}

impl From<ReceptionError> for Refusal {
    fn from(error: ReceptionError) -> Self {
        let refused = |code| Self::new(code, error.to_string()).at("content");
        match &error {
            ReceptionError::Rinex(error) => Self::from(&**error),
            ReceptionError::Unrecognised { .. }
            | ReceptionError::PackedTwice
            | ReceptionError::EpochTooLong { .. } => refused(Code::RawFormatUnknown),
            ReceptionError::Damaged(_) => refused(Code::RinexReadFailed),
            ReceptionError::UnpackedTooLarge { .. } => refused(Code::DecompressedTooLarge),
            ReceptionError::StreamTooLong { .. } => refused(Code::RawStreamTooLong),
        }
    }
}

impl From<&RinexError> for Refusal {
    fn from(error: &RinexError) -> Self {
        let code = match error {
            RinexError::NotRinex { .. } => Code::RinexNotRinex,
            RinexError::WrongKind { .. } => Code::RinexWrongKind,
            RinexError::UnsupportedVersion { .. } => Code::RinexUnsupportedVersion,
            RinexError::HeaderInvalid { .. } => Code::RinexHeaderInvalid,
            RinexError::Truncated { .. } => Code::RinexTruncated,
            RinexError::CompressionUnsupported { .. } => Code::RinexCompressionUnsupported,
            RinexError::LineTooLong { .. } => Code::RinexLineTooLong,
            RinexError::ReadFailed { .. } => Code::RinexReadFailed,
        };
        Self::new(code, error.to_string()).on_line(error.line())
    }
}

impl From<StoreError> for Refusal {
    fn from(error: StoreError) -> Self {
        match &error {
            StoreError::PageToken { .. } => {
                Self::new(Code::PageTokenInvalid, error.to_string()).at("pageToken")
            }
            StoreError::PageSize { .. } => {
                Self::new(Code::PageSizeInvalid, error.to_string()).at("pageSize")
            }
            StoreError::Closed => Self::new(Code::Draining, error.to_string()),
            StoreError::AlreadyStored => Self::new(Code::WrittenElsewhere, error.to_string()),
            StoreError::Corrupt { .. } | StoreError::CorruptText { .. } => {
                Self::new(Code::StoredDataCorrupt, error.to_string())
            }
            StoreError::Url { .. }
            | StoreError::NewerSchema { .. }
            | StoreError::Migration { .. }
            | StoreError::NavigationForgotten { .. } // Of replay, which is no call.
            | StoreError::BaseForgotten { .. }
            | StoreError::Database { .. } => Self::new(Code::DatabaseFailed, error.to_string()),
        }
    }
}

impl From<AidingError> for Refusal {
    fn from(error: AidingError) -> Self {
        let (code, field) = match error {
            AidingError::Store(error) => return error.into(),
            AidingError::TooManyEphemerides { .. } => (Code::TooManyEphemerides, None),
            AidingError::BaseNotFound { .. } => (Code::BaseNotFound, Some("base")),
            AidingError::TooManyBases { .. } => (Code::TooManyBases, None),
            AidingError::LabelTooLong { .. } => (Code::LabelTooLong, Some("label")),
            AidingError::BaseInUse { .. } => (Code::BaseInUse, Some("base")),
            AidingError::BasePositionMissing { .. } => (Code::BasePositionMissing, Some("base")),
            AidingError::BasePositionRefused { .. } => (Code::BasePositionRefused, Some("base")),
            AidingError::BaseTooLarge { .. } => (Code::BaseTooLarge, None),
        };
        let refusal = Self::new(code, error.to_string());
        Self { field: field.map(ToOwned::to_owned), ..refusal }
    }
}

impl From<BaseFileError> for Refusal {
    fn from(error: BaseFileError) -> Self {
        match &error {
            BaseFileError::Rinex(error) => Self::from(error),
            BaseFileError::TooManyEpochs { .. } => Self::new(Code::BaseTooLarge, error.to_string()),
        }
    }
}

impl From<FetchError> for Refusal {
    fn from(error: FetchError) -> Self {
        let (code, field) = match &error {
            FetchError::AddressInvalid { .. } => (Code::CasterAddressInvalid, "ntrip.caster"),
            FetchError::MountpointInvalid { .. } => (Code::MountpointInvalid, "ntrip.mountpoint"),
            FetchError::LocationInvalid { .. } | FetchError::TemplateWithoutDay { .. } => {
                (Code::InvalidField, "archive.template")
            }
            FetchError::HostNotAllowed { .. } => (Code::HostNotAllowed, "ntrip.caster"),
            // Of the connection, which no call waits for.
            FetchError::PatternInvalid { .. }
            | FetchError::Unresolved { .. }
            | FetchError::AddressRefused { .. }
            | FetchError::Unreachable { .. }
            | FetchError::Tls { .. }
            | FetchError::CertificatesInvalid { .. } => {
                return Self::new(Code::Internal, error.to_string());
            }
        };
        Self::new(code, error.to_string()).at(field)
    }
}

impl From<BaseEpochRefusal> for Refusal {
    fn from(refusal: BaseEpochRefusal) -> Self {
        let (code, field) = match refusal {
            BaseEpochRefusal::Conflict { .. } => (Code::BaseEpochConflict, "time"),
            BaseEpochRefusal::OutOfOrder { .. } => (Code::BaseOutOfOrder, "time"),
            BaseEpochRefusal::TooManyObservations { .. } => {
                (Code::TooManyObservations, "observations")
            }
        };
        Self::new(code, refusal.to_string()).at(field)
    }
}

impl From<SessionError> for Refusal {
    fn from(error: SessionError) -> Self {
        let (code, field) = match error {
            SessionError::Configuration(error) => return error.into(),
            SessionError::Store(error) => return error.into(),
            SessionError::Aiding(error) => return error.into(),
            SessionError::Raw(error) => return error.into(),
            SessionError::PieceTooLarge { .. } => (Code::PieceTooLarge, Some("content")),
            SessionError::RawGap { .. } => (Code::RawGap, Some("offset")),
            SessionError::RawConflict { .. } => (Code::RawConflict, Some("content")),
            SessionError::BaseRequired { .. } => (Code::BaseRequired, Some("base")),
            SessionError::TooManyCandidates { .. } | SessionError::BaseNamedTwice { .. } => {
                (Code::InvalidField, Some("bases"))
            }
            SessionError::NotFound { .. } => (Code::SessionNotFound, Some("session")),
            SessionError::Closed { .. } => (Code::SessionClosed, Some("session")),
            SessionError::LabelTooLong { .. } => (Code::LabelTooLong, Some("label")),
            SessionError::NoEpochs => (Code::NoEpochs, Some("epochs")),
            SessionError::TooManyEpochs { .. } => (Code::TooManyEpochs, Some("epochs")),
            SessionError::BurstOutOfOrder { .. } => (Code::OutOfOrder, Some("epochs")),
            SessionError::TooManyObservations { .. } => (Code::TooManyObservations, Some("epochs")),
            SessionError::MailboxFull { .. } => (Code::MailboxFull, None),
            SessionError::Overloaded { .. } => (Code::Overloaded, None),
            SessionError::TooManyActive { .. } => (Code::TooManyActiveSessions, None),
            SessionError::Empty { .. } => (Code::SessionEmpty, Some("session")),
            SessionError::Draining => (Code::Draining, None),
            SessionError::EstimatorFailed { .. } => (Code::EstimatorFailed, None),
            SessionError::Interrupted => (Code::Interrupted, None),
        };
        let refusal = Self::new(code, error.to_string());
        let refusal = Self { field: field.map(ToOwned::to_owned), ..refusal };
        Self { retry_after: error.retry_after(), ..refusal }
    }
}

impl From<EpochRefusal> for Refusal {
    fn from(refusal: EpochRefusal) -> Self {
        let code = match refusal {
            EpochRefusal::Conflict { .. } => Code::SequenceConflict,
            EpochRefusal::Superseded { .. } => Code::SequenceSuperseded,
            EpochRefusal::OutOfOrder { .. } => Code::OutOfOrder,
            EpochRefusal::TooManyObservations { .. } => Code::TooManyObservations,
            EpochRefusal::SequenceTooLarge { .. } => Code::InvalidSequence,
        };
        Self::new(code, refusal.to_string()).at(refusal.field())
    }
}
