//! Refusals: every way in which a door says no, once for both doors.

use std::fmt;
use std::time::Duration;

/// Declares the codes with their name, the class that decides both doors' status, and the remedy.
macro_rules! codes {
    ($($(#[$doc:meta])* $variant:ident = $name:literal, $class:ident, $remedy:literal;)+) => {
        /// Stable code of a refusal; `docs/errors.md` is its table.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum Code {
            $($(#[$doc])* $variant,)+
        }

        impl Code {
            /// Every code.
            pub const ALL: &[Self] = &[$(Self::$variant,)+];

            /// The name as the API writes it, upper snake case.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $name,)+
                }
            }

            /// What kind of refusal it is.
            pub const fn class(self) -> Class {
                match self {
                    $(Self::$variant => Class::$class,)+
                }
            }

            /// What the client can do about it.
            pub const fn remedy(self) -> &'static str {
                match self {
                    $(Self::$variant => $remedy,)+
                }
            }
        }
    };
}

/// What kind of refusal a code is: each door has one status for each class.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Class {
    /// The request is wrong and stays wrong.
    Malformed,
    /// The request's body is of a kind that the call does not take.
    MediaType,
    /// The request is larger than allowed.
    TooLarge,
    /// What was asked for is not there.
    NotFound,
    /// There is no such call.
    Route,
    /// The path exists, the method does not.
    Method,
    /// The request contradicts what is stored.
    Conflict,
    /// The request cannot be served in the present state of what it names.
    Precondition,
    /// A limit is reached; the same request may be served later.
    Exhausted,
    /// The service cannot serve now.
    Unavailable,
    /// The service failed.
    Internal,
}

codes! {
    /// The body is not JSON, or not a message of the schema.
    MalformedBody = "MALFORMED_BODY", Malformed,
        "send a body that the schema allows, see /openapi.json or the proto files";
    /// A field that the schema does not know.
    UnknownField = "UNKNOWN_FIELD", Malformed,
        "remove the field or correct its name; the message lists those there are";
    /// A field is missing, of the wrong type, or out of range.
    InvalidField = "INVALID_FIELD", Malformed, "correct the named field";
    /// The body's content type is another than the call takes.
    UnsupportedMediaType = "UNSUPPORTED_MEDIA_TYPE", MediaType,
        "send the content type that the message names";
    /// The body or message exceeds its limit.
    BodyTooLarge = "BODY_TOO_LARGE", TooLarge,
        "split the request, or let the operator raise limits.body_bytes";
    /// Unpacked, the upload exceeds its limit.
    DecompressedTooLarge = "DECOMPRESSED_TOO_LARGE", TooLarge,
        "split the file, or let the operator raise limits.decompressed_bytes";
    /// No such path.
    RouteNotFound = "ROUTE_NOT_FOUND", Route, "see /docs for the paths there are";
    /// The path does not take this method.
    MethodNotAllowed = "METHOD_NOT_ALLOWED", Method, "see /docs for the methods of this path";
    /// No such mode.
    UnknownMode = "UNKNOWN_MODE", Malformed, "choose one of the modes that the message lists";
    /// No such profile.
    UnknownProfile = "UNKNOWN_PROFILE", Malformed,
        "choose one of the profiles that the message lists";
    /// No such option.
    UnknownOption = "UNKNOWN_OPTION", Malformed,
        "choose one of the options that the message lists";
    /// An option does not take this value.
    InvalidOptionValue = "INVALID_OPTION_VALUE", Malformed,
        "give a value that the message allows";
    /// An option takes this value only where a Cargo feature is built in.
    FeatureNotBuilt = "FEATURE_NOT_BUILT", Malformed,
        "choose another value, or ask a server built with the feature that the message names";
    /// A push without an epoch.
    NoEpochs = "NO_EPOCHS", Malformed, "send at least one epoch";
    /// More epochs than one push may carry.
    TooManyEpochs = "TOO_MANY_EPOCHS", TooLarge,
        "split the push, or let the operator raise limits.epochs_per_push";
    /// More satellites than one epoch may carry.
    TooManySatellites = "TOO_MANY_SATELLITES", TooLarge,
        "send each satellite once, or let the operator raise limits.satellites_per_epoch";
    /// More observations than one epoch may carry.
    TooManyObservations = "TOO_MANY_OBSERVATIONS", TooLarge,
        "send fewer signals a satellite, or let the operator raise limits.observations_per_epoch";
    /// A time that is none.
    InvalidTime = "INVALID_TIME", Malformed,
        "send GPS week and nanoseconds of week, 0 to 604799999999999";
    /// A sequence number out of range.
    InvalidSequence = "INVALID_SEQUENCE", Malformed,
        "number the epochs from 1 to 9007199254740991";
    /// A text that names no satellite.
    InvalidSatellite = "INVALID_SATELLITE", Malformed,
        "name the satellite as RINEX 3 does, such as G05, R24, E36, C63, J01";
    /// A text that names no signal of that satellite.
    InvalidSignal = "INVALID_SIGNAL", Malformed,
        "name band and tracking attribute as RINEX 3 does, such as 1C, 2I, 7Q";
    /// One signal of one satellite twice in an epoch.
    DuplicateSignal = "DUPLICATE_SIGNAL", Malformed, "send each signal of a satellite once";
    /// A measurement that is not a number or cannot be.
    InvalidMeasurement = "INVALID_MEASUREMENT", Malformed,
        "leave out what was not measured; units are m, cycles, Hz and dB-Hz";
    /// A displacement that cannot be, along axes that are none, or with a covariance that is none.
    InvalidOdometry = "INVALID_ODOMETRY", Malformed,
        "give frame ecef, enu or body with heading, three metres, a positive definite covariance";
    /// No such session.
    SessionNotFound = "SESSION_NOT_FOUND", NotFound,
        "create a session, or check the id";
    /// The session takes no more epochs.
    SessionClosed = "SESSION_CLOSED", Precondition, "create another session";
    /// A label longer than a name is.
    LabelTooLong = "LABEL_TOO_LONG", Malformed, "shorten the label";
    /// Other content under a stored sequence number.
    SequenceConflict = "SEQUENCE_CONFLICT", Conflict,
        "number each new epoch above the last; resend epochs unchanged";
    /// A number below the last one, under which nothing is stored.
    SequenceSuperseded = "SEQUENCE_SUPERSEDED", Precondition,
        "send epochs in rising order; this one is lost to the session";
    /// An epoch whose time is not after the last one's.
    OutOfOrder = "OUT_OF_ORDER", Precondition,
        "send epochs in order of time; open a new session for older data";
    /// A piece of raw bytes larger than allowed.
    PieceTooLarge = "PIECE_TOO_LARGE", TooLarge,
        "send smaller pieces, or let the operator raise limits.raw_piece_bytes";
    /// Bytes are missing before a piece of raw bytes.
    RawGap = "RAW_GAP", Precondition, "go on at rawThrough of the session";
    /// Other raw bytes are stored at the place of a piece.
    RawConflict = "RAW_CONFLICT", Conflict,
        "count offsets from the first byte ever sent to the session";
    /// Raw bytes that are neither RTCM 3, UBX nor RINEX observations.
    RawFormatUnknown = "RAW_FORMAT_UNKNOWN", Malformed,
        "send RTCM 3, UBX or RINEX observations, plain or gzip, from the stream's beginning";
    /// A stream that can be read from its beginning alone has become too long.
    RawStreamTooLong = "RAW_STREAM_TOO_LONG", TooLarge,
        "end the stream, and begin another file";
    /// The session has as many epochs waiting as it may.
    MailboxFull = "MAILBOX_FULL", Exhausted,
        "wait as long as the answer says and send the same epochs again";
    /// All sessions together have as many epochs waiting as the service holds.
    Overloaded = "OVERLOADED", Exhausted,
        "wait as long as the answer says and send the same epochs again";
    /// Every session that may be active has epochs waiting.
    TooManyActiveSessions = "TOO_MANY_ACTIVE_SESSIONS", Exhausted,
        "wait as long as the answer says and send the same epochs again";
    /// Nothing to solve yet.
    SessionEmpty = "SESSION_EMPTY", Precondition, "push an epoch first";
    /// The estimator failed on these epochs; the session goes on from its last committed one.
    EstimatorFailed = "ESTIMATOR_FAILED", Internal,
        "resend the epochs singly, and report the one that fails";
    /// The session's task ended before it answered.
    Interrupted = "INTERRUPTED", Unavailable,
        "send the same epochs again; what is stored is answered from there";
    /// A page token that no answer of this call gave.
    PageTokenInvalid = "PAGE_TOKEN_INVALID", Malformed,
        "send nextPageToken of the answer before, unchanged";
    /// A page size that is not allowed.
    PageSizeInvalid = "PAGE_SIZE_INVALID", Malformed, "ask for a page of the allowed size";
    /// More ephemerides of a satellite in one push than are held.
    TooManyEphemerides = "TOO_MANY_EPHEMERIDES", TooLarge,
        "push a shorter span, or let the operator raise limits.ephemerides_per_satellite";
    /// No such base.
    BaseNotFound = "BASE_NOT_FOUND", NotFound, "create a base, or check the id";
    /// The mode is relative to a base, and none is named.
    BaseRequired = "BASE_REQUIRED", Malformed,
        "create a base, push its epochs, and name it as base";
    /// An open session names the base.
    BaseInUse = "BASE_IN_USE", Precondition,
        "close the sessions that name it, or let them use another base";
    /// As many bases as the service holds.
    TooManyBases = "TOO_MANY_BASES", Exhausted,
        "delete a base that is no longer used, or let the operator raise limits.bases";
    /// Nobody has told where the base stands: neither its creator nor the file's header.
    BasePositionMissing = "BASE_POSITION_MISSING", Precondition,
        "create the base with the position of its marker";
    /// The base's position is more than 100 m from what the base observes.
    BasePositionRefused = "BASE_POSITION_REFUSED", Precondition,
        "create the base anew with its right position";
    /// Other content is held of the base's epoch of this time.
    BaseEpochConflict = "BASE_EPOCH_CONFLICT", Conflict,
        "send each epoch once, or unchanged; create another base for other observations";
    /// An epoch of a base that is not after its newest, and not held.
    BaseOutOfOrder = "BASE_OUT_OF_ORDER", Precondition,
        "send a base's epochs in order of time; create another base for older data";
    /// One push brings more than a base holds.
    BaseTooLarge = "BASE_TOO_LARGE", TooLarge,
        "push a shorter span, or let the operator raise limits.epochs_per_base and bytes_per_base";
    /// A caster's address that is none.
    CasterAddressInvalid = "CASTER_ADDRESS_INVALID", Malformed,
        "write ntrip://HOST:PORT, or ntrips:// for TLS";
    /// A mountpoint's name that is none.
    MountpointInvalid = "MOUNTPOINT_INVALID", Malformed,
        "choose a mountpoint of the caster's sourcetable";
    /// A host that the operator does not list.
    HostNotAllowed = "HOST_NOT_ALLOWED", Precondition,
        "let the operator list the host in fetch.hosts";
    /// The upload is not RINEX.
    RinexNotRinex = "RINEX_NOT_RINEX", Malformed,
        "send a RINEX file of the kind that the call takes, plain or gzip";
    /// The upload is RINEX of another kind.
    RinexWrongKind = "RINEX_WRONG_KIND", Malformed,
        "send navigation data to navigation, and observations of a base to a base";
    /// RINEX of a version that is not read.
    RinexUnsupportedVersion = "RINEX_UNSUPPORTED_VERSION", Malformed,
        "convert the file to RINEX 3 or 4";
    /// A header that cannot be read.
    RinexHeaderInvalid = "RINEX_HEADER_INVALID", Malformed, "correct the header at the named line";
    /// The file ends inside its header.
    RinexTruncated = "RINEX_TRUNCATED", Malformed, "fetch the file again: its end is missing";
    /// Compressed otherwise than by gzip.
    RinexCompressionUnsupported = "RINEX_COMPRESSION_UNSUPPORTED", Malformed,
        "unpack the file, or compress it with gzip";
    /// A line that no RINEX file has.
    RinexLineTooLong = "RINEX_LINE_TOO_LONG", Malformed,
        "check that the file is text with line ends";
    /// The file could not be read to its end, as when gzip data are damaged.
    RinexReadFailed = "RINEX_READ_FAILED", Malformed,
        "fetch the file again: it could not be read to its end";
    /// The service is about to stop.
    Draining = "DRAINING", Unavailable, "connect again shortly and resend";
    /// The database does not answer or refuses.
    DatabaseFailed = "DATABASE_FAILED", Unavailable,
        "send the same request again, with backoff; the operator finds the cause in the log";
    /// Another service writes the same session.
    WrittenElsewhere = "WRITTEN_ELSEWHERE", Unavailable,
        "let one service write a session; send the same request again";
    /// A stored row cannot be read.
    StoredDataCorrupt = "STORED_DATA_CORRUPT", Internal, "restore the database from a backup";
    /// A fault of the service.
    Internal = "INTERNAL", Internal,
        "retry; if it persists, report it with the log of the service";
}

impl fmt::Display for Code {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Why a request, or one epoch of it, was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{code}: {message}")]
pub struct Refusal {
    /// Stable code.
    pub code: Code,
    /// What is wrong, with the values at fault.
    pub message: String,
    /// The field at fault, a path such as `epochs[3].time`, in the door's own spelling.
    pub field: Option<String>,
    /// The line at fault of an uploaded file, from 1.
    pub line: Option<u64>,
    /// The byte at fault of a body, from 0.
    pub byte_offset: Option<u64>,
    /// When to try again.
    pub retry_after: Option<Duration>,
}

impl Refusal {
    /// A refusal without a place.
    pub fn new(code: Code, message: impl Into<String>) -> Self {
        let message = message.into();
        Self { code, message, field: None, line: None, byte_offset: None, retry_after: None }
    }

    /// The same, with the field at fault.
    #[must_use]
    pub fn at(mut self, field: impl Into<String>) -> Self {
        self.field = Some(field.into());
        self
    }

    /// The same, with the field at fault standing inside `outer`.
    #[must_use]
    pub fn within(mut self, outer: &str) -> Self {
        self.field = Some(match self.field {
            Some(inner) => format!("{outer}.{inner}"),
            None => outer.to_owned(),
        });
        self
    }

    /// The same, with the line at fault.
    #[must_use]
    pub fn on_line(mut self, line: u64) -> Self {
        self.line = Some(line);
        self
    }

    /// The same, with the byte at fault.
    #[must_use]
    pub fn on_byte(mut self, offset: u64) -> Self {
        self.byte_offset = Some(offset);
        self
    }

    /// The same, with the time after which to try again.
    #[must_use]
    pub fn retry_after(mut self, delay: Duration) -> Self {
        self.retry_after = Some(delay);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_upper_snake_case_and_distinct() {
        let mut seen = std::collections::BTreeSet::new();
        for code in Code::ALL {
            let plain = |c: char| c.is_ascii_uppercase() || c == '_';
            assert!(code.name().chars().all(plain), "{code}");
            assert!(seen.insert(code.name()), "{code} twice");
        }
    }

    #[test]
    fn a_field_gains_its_surroundings() {
        let refusal = Refusal::new(Code::InvalidTime, "week 99999").at("time").within("epochs[3]");
        assert_eq!(refusal.field.as_deref(), Some("epochs[3].time"));
    }
}
