//! The table of codes.

use std::fmt;

/// Declares the codes with their name, class and remedy.
macro_rules! codes {
    ($($(#[$doc:meta])* $variant:ident = $name:literal, $class:ident, $remedy:literal;)+) => {
        /// Stable code of a refusal or failure.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Code {
            $($(#[$doc])* $variant,)+
        }

        impl Code {
            /// Every code.
            pub const ALL: &[Self] = &[$(Self::$variant,)+];

            /// The name as users see it, upper snake case.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $name,)+
                }
            }

            /// The kind of refusal, which decides the status at each door.
            pub const fn class(self) -> super::Class {
                match self {
                    $(Self::$variant => super::Class::$class,)+
                }
            }

            /// What the user can do about it.
            pub const fn remedy(self) -> &'static str {
                match self {
                    $(Self::$variant => $remedy,)+
                }
            }
        }
    };
}

codes! {
    // The request itself.

    /// The body is not JSON, or not a message of the schema.
    MalformedBody = "MALFORMED_BODY", Malformed,
        "send a body that the schema allows, see /openapi.json or the proto files";
    /// The schema has no such field.
    UnknownField = "UNKNOWN_FIELD", Malformed,
        "remove the field or correct its name; the message lists the known fields";
    /// A field is missing, of the wrong type, or out of range.
    InvalidField = "INVALID_FIELD", Malformed, "correct the named field";
    /// The call does not take a body of this content type.
    UnsupportedMediaType = "UNSUPPORTED_MEDIA_TYPE", MediaType,
        "send the content type that the message names";
    /// The body or message exceeds its limit.
    BodyTooLarge = "BODY_TOO_LARGE", TooLarge,
        "split the request, or let the operator raise limits.body_bytes";
    /// The unpacked upload exceeds its limit.
    DecompressedTooLarge = "DECOMPRESSED_TOO_LARGE", TooLarge,
        "split the file, or let the operator raise limits.decompressed_bytes";
    /// The compression ratio of the content exceeds its limit.
    CompressedTooMuch = "COMPRESSED_TOO_MUCH", TooLarge,
        "send it not packed, or in smaller parts";
    /// The body arrives too slowly.
    BodyTooSlow = "BODY_TOO_SLOW", Timeout, "send smaller requests, or over a faster connection";
    /// The call is not answered within the time that its caller gave.
    DeadlineExceeded = "DEADLINE_EXCEEDED", Timeout,
        "send the same request again; epochs that are stored are answered from the store";
    /// All requests together use as much memory as allowed.
    MemoryExhausted = "MEMORY_EXHAUSTED", Exhausted,
        "wait for the delay in the answer and send the same request again";
    /// As many connections are open as allowed, in all or from one address.
    TooManyConnections = "TOO_MANY_CONNECTIONS", Exhausted,
        "use one connection for many requests, or let the operator raise limits.connections";
    /// The request names a host that is not this service, as a web page of another host can.
    HostRefused = "HOST_REFUSED", Forbidden,
        "name the service by localhost or its address, or let the operator list the name in hosts";
    /// A web page of another origin sends the request.
    OriginRefused = "ORIGIN_REFUSED", Forbidden,
        "use the service from its own pages, or let the operator list the page's host in hosts";
    /// The path does not exist.
    RouteNotFound = "ROUTE_NOT_FOUND", Route, "see /docs for the paths";
    /// The path does not take this method.
    MethodNotAllowed = "METHOD_NOT_ALLOWED", Method, "see /docs for the methods of this path";
    /// The page token does not come from an answer to this call.
    PageTokenInvalid = "PAGE_TOKEN_INVALID", Malformed,
        "send nextPageToken of the previous answer, unchanged";
    /// The page size is out of range.
    PageSizeInvalid = "PAGE_SIZE_INVALID", Malformed,
        "ask for a page size in the range that the message names";

    // Configuration of a session.

    /// The mode does not exist.
    UnknownMode = "UNKNOWN_MODE", Malformed, "choose one of the modes that the message lists";
    /// The profile does not exist.
    UnknownProfile = "UNKNOWN_PROFILE", Malformed,
        "choose one of the profiles that the message lists";
    /// The option does not exist.
    UnknownOption = "UNKNOWN_OPTION", Malformed,
        "choose one of the options that the message lists";
    /// The option does not take this value.
    InvalidOptionValue = "INVALID_OPTION_VALUE", Malformed,
        "give a value that the message allows";
    /// The option takes this value only where a Cargo feature is built in.
    FeatureNotBuilt = "FEATURE_NOT_BUILT", Malformed,
        "choose another value, or ask a server built with the feature that the message names";
    /// The label is longer than allowed.
    LabelTooLong = "LABEL_TOO_LONG", Malformed, "shorten the label";

    // Epochs.

    /// The push has no epoch.
    NoEpochs = "NO_EPOCHS", Malformed, "send at least one epoch";
    /// The push has more epochs than allowed.
    TooManyEpochs = "TOO_MANY_EPOCHS", TooLarge,
        "split the push, or let the operator raise limits.epochs_per_push";
    /// The epoch has more satellites than allowed.
    TooManySatellites = "TOO_MANY_SATELLITES", TooLarge,
        "send each satellite once, or let the operator raise limits.satellites_per_epoch";
    /// The epoch has more observations than allowed.
    TooManyObservations = "TOO_MANY_OBSERVATIONS", TooLarge,
        "send fewer signals per satellite, or let the operator raise \
         limits.observations_per_epoch";
    /// The time is missing or out of range.
    InvalidTime = "INVALID_TIME", Malformed,
        "send GPS week and nanoseconds of week, 0 to 604799999999999";
    /// The sequence number is out of range.
    InvalidSequence = "INVALID_SEQUENCE", Malformed,
        "number the epochs from 1 to 9007199254740991";
    /// The text does not name a satellite.
    InvalidSatellite = "INVALID_SATELLITE", Malformed,
        "name the satellite as RINEX 3 does, such as G05, R24, E36, C63, J01";
    /// The text does not name a signal of this satellite.
    InvalidSignal = "INVALID_SIGNAL", Malformed,
        "name band and tracking attribute as RINEX 3 does, such as 1C, 2I, 7Q";
    /// The epoch has the same signal of the same satellite twice.
    DuplicateSignal = "DUPLICATE_SIGNAL", Malformed, "send each signal of a satellite once";
    /// The measurement is not a number, or physically impossible.
    InvalidMeasurement = "INVALID_MEASUREMENT", Malformed,
        "leave out what was not measured; units are m, cycles, Hz and dB-Hz";
    /// The displacement is impossible, or its frame or covariance is invalid.
    InvalidOdometry = "INVALID_ODOMETRY", Malformed,
        "give frame ecef, enu or body with heading, three metres, a positive definite covariance";

    // Sessions.

    /// The session does not exist.
    SessionNotFound = "SESSION_NOT_FOUND", NotFound, "create a session, or check the id";
    /// The session is closed and takes no more epochs.
    SessionClosed = "SESSION_CLOSED", Precondition,
        "create another session; the solutions of this one stay readable";
    /// An epoch with other content is stored under this sequence number.
    SequenceConflict = "SEQUENCE_CONFLICT", Conflict,
        "number each new epoch above the last; resend epochs unchanged";
    /// The sequence number is below the last one, and no epoch is stored under it.
    SequenceSuperseded = "SEQUENCE_SUPERSEDED", Precondition,
        "send epochs in rising order of their numbers; the session no longer takes this one";
    /// The epoch is older than the session's retention: it was acknowledged, and it and its
    /// solution are removed.
    AlreadyAcknowledged = "ALREADY_ACKNOWLEDGED", Precondition,
        "delete the epoch on the device; a longer retention keeps later ones longer";
    /// The epoch's time is not after the previous epoch's.
    OutOfOrder = "OUT_OF_ORDER", Precondition,
        "send epochs in order of time; open a new session for older data";
    /// The epoch's time is far ahead of the service's clock.
    TimeImplausible = "TIME_IMPLAUSIBLE", Precondition,
        "correct the receiver's week number, or the service's clock; or let the operator raise \
         limits.future_s";
    /// The computation takes more time than a request may, or its window is longer.
    TooCostly = "TOO_COSTLY", TooLarge,
        "send fewer epochs, shorten the window, or use a session; the operator sets limits.solve_s";
    /// The session has no epoch to solve yet.
    SessionEmpty = "SESSION_EMPTY", Precondition, "push an epoch first";
    /// The session has no epoch of this number.
    EpochNotFound = "EPOCH_NOT_FOUND", NotFound,
        "list the session's solutions for the numbers of its epochs";
    /// The session's mailbox is full of waiting epochs.
    MailboxFull = "MAILBOX_FULL", Exhausted,
        "wait for the delay in the answer and send the same epochs again";
    /// The mailboxes of all sessions together are full of waiting epochs.
    Overloaded = "OVERLOADED", Exhausted,
        "wait for the delay in the answer and send the same epochs again";
    /// As many sessions are active as allowed, and all of them have epochs waiting.
    TooManyActiveSessions = "TOO_MANY_ACTIVE_SESSIONS", Exhausted,
        "wait for the delay in the answer and send the same epochs again";
    /// The estimator failed on these epochs; the session continues from its last committed epoch.
    EstimatorFailed = "ESTIMATOR_FAILED", Internal,
        "resend the epochs one by one, and report the one that fails";
    /// The session's task ended before it answered.
    Interrupted = "INTERRUPTED", Unavailable,
        "send the same epochs again; those already stored are answered from the store";

    // Streams of a device.

    /// As many streams are open as allowed.
    TooManyStreams = "TOO_MANY_STREAMS", Exhausted,
        "wait for the delay in the answer and open the stream again, or let the operator raise \
         limits.streams";
    /// The device sends more on a stream than its credit allows.
    CreditExceeded = "CREDIT_EXCEEDED", Precondition,
        "send no more than the credit of the last answer, and open another stream after this one";
    /// No message has arrived on a stream for too long.
    StreamIdle = "STREAM_IDLE", Timeout,
        "open another stream; a message without epochs keeps a silent one open";
    /// As many watches are open as allowed.
    TooManyWatches = "TOO_MANY_WATCHES", Exhausted,
        "wait for the delay in the answer and watch again, or let the operator raise \
         limits.watches";
    /// The reader of a watch takes its messages too slowly.
    WatchTooSlow = "WATCH_TOO_SLOW", Exhausted,
        "watch again with the cursor of the last received message; nothing is missed";
    /// The cursor does not come from a watch.
    CursorInvalid = "CURSOR_INVALID", Malformed,
        "send the cursor of the last received message, unchanged";
    /// The device has acknowledgements that the session has not given.
    AcknowledgementUnknown = "ACKNOWLEDGEMENT_UNKNOWN", Precondition,
        "check the session's id; if the database was restored from a backup, open the stream \
         without the acknowledgement and send the later epochs again";

    // Raw bytes of a receiver.

    /// The raw chunk is larger than allowed.
    PieceTooLarge = "PIECE_TOO_LARGE", TooLarge,
        "send smaller chunks, or let the operator raise limits.raw_piece_bytes";
    /// Bytes are missing between the stored stream and the chunk.
    RawGap = "RAW_GAP", Precondition, "continue at rawThrough of the session";
    /// Other bytes are stored at the chunk's offset.
    RawConflict = "RAW_CONFLICT", Conflict,
        "count offsets from the first byte ever sent to the session";
    /// The bytes are neither RTCM 3, UBX, RINEX observations nor an Android GnssLogger log.
    RawFormatUnknown = "RAW_FORMAT_UNKNOWN", Malformed,
        "send RTCM 3, UBX, RINEX observations or a GnssLogger log, plain or gzip, from its start";
    /// No line `# Raw,…` names the columns of a GnssLogger log, or they lack one or change.
    GnssLoggerHeaderInvalid = "GNSS_LOGGER_HEADER_INVALID", Malformed,
        "send the log as the app wrote it, from its first line, and each log as its own stream";
    /// The line is longer than any line of a GnssLogger log.
    GnssLoggerLineTooLong = "GNSS_LOGGER_LINE_TOO_LONG", Malformed,
        "check that the log is text with line ends";
    /// A stream that can only be read from its beginning has become too long.
    RawStreamTooLong = "RAW_STREAM_TOO_LONG", TooLarge,
        "end the stream, and begin another file";

    // Navigation data.

    /// The push has more ephemerides of one satellite than the service keeps.
    TooManyEphemerides = "TOO_MANY_EPHEMERIDES", TooLarge,
        "push a shorter span, or let the operator raise limits.ephemerides_per_satellite";

    // Bases.

    /// The base does not exist.
    BaseNotFound = "BASE_NOT_FOUND", NotFound, "create a base, or check the id";
    /// The mode is relative to a base, and the request names neither base nor bases.
    BaseRequired = "BASE_REQUIRED", Malformed,
        "create a base, push its epochs, and name it as base";
    /// An open session uses the base.
    BaseInUse = "BASE_IN_USE", Precondition,
        "close the sessions that use it, or let them use another base";
    /// The service has as many bases as allowed.
    TooManyBases = "TOO_MANY_BASES", Precondition,
        "delete a base that is no longer used, or let the operator raise limits.bases";
    /// The position of the base is unknown: neither its creator nor a file's header has given it.
    BasePositionMissing = "BASE_POSITION_MISSING", Precondition,
        "create the base with the position of its marker";
    /// The stated position of the base is more than 100 m from its own single-point position.
    BasePositionRefused = "BASE_POSITION_REFUSED", Precondition,
        "create the base again with its right position";
    /// The base has an epoch of this time with other content.
    BaseEpochConflict = "BASE_EPOCH_CONFLICT", Conflict,
        "send each epoch once, or unchanged; create another base for other observations";
    /// The epoch is older than the base's newest epoch, and the base does not have it.
    BaseOutOfOrder = "BASE_OUT_OF_ORDER", Precondition,
        "send a base's epochs in order of time; create another base for older data";
    /// The ANTEX file of the service has no calibration of the named antenna, or the service has no
    /// ANTEX file.
    AntennaUnknown = "ANTENNA_UNKNOWN", Malformed,
        "name type and radome as the IGS does, or let the operator add them to the ANTEX file";
    /// The push exceeds what one base may store.
    BaseTooLarge = "BASE_TOO_LARGE", TooLarge,
        "push a shorter span, or let the operator raise limits.epochs_per_base and bytes_per_base";
    /// The caster's address is invalid.
    CasterAddressInvalid = "CASTER_ADDRESS_INVALID", Malformed,
        "write ntrip://HOST:PORT, or ntrips:// for TLS";
    /// The mountpoint's name is invalid.
    MountpointInvalid = "MOUNTPOINT_INVALID", Malformed,
        "choose a mountpoint of the caster's sourcetable";
    /// The address of an archive's files is invalid, or has no placeholders for the day.
    LocationInvalid = "LOCATION_INVALID", Malformed,
        "write http:// or https://, host, path and placeholders";
    /// The operator does not list the host.
    HostNotAllowed = "HOST_NOT_ALLOWED", Precondition,
        "let the operator list the host in fetch.hosts";

    // RINEX files.

    /// The upload is not RINEX.
    RinexNotRinex = "RINEX_NOT_RINEX", Malformed,
        "send a RINEX file of the kind that the call takes, plain or gzip";
    /// The upload is RINEX of another kind.
    RinexWrongKind = "RINEX_WRONG_KIND", Malformed,
        "send navigation data to navigation, and observations of a base to a base";
    /// This version of RINEX is not supported.
    RinexUnsupportedVersion = "RINEX_UNSUPPORTED_VERSION", Malformed,
        "convert the file to RINEX 2, 3 or 4, or CRINEX 1 or 3";
    /// The header is invalid.
    RinexHeaderInvalid = "RINEX_HEADER_INVALID", Malformed, "correct the header at the named line";
    /// The file ends inside its header.
    RinexTruncated = "RINEX_TRUNCATED", Malformed, "fetch the file again: its end is missing";
    /// The file is compressed by another method than gzip.
    RinexCompressionUnsupported = "RINEX_COMPRESSION_UNSUPPORTED", Malformed,
        "unpack the file (uncompress for .Z, unzip for .zip), or compress it with gzip";
    /// The line is longer than any line of RINEX.
    RinexLineTooLong = "RINEX_LINE_TOO_LONG", Malformed,
        "check that the file is text with line ends";
    /// The file could not be read to its end, for instance because its gzip data is damaged.
    RinexReadFailed = "RINEX_READ_FAILED", Malformed,
        "fetch the file again: it could not be read to its end";

    // The service.

    /// The service is about to stop.
    Draining = "DRAINING", Unavailable, "connect again shortly and send the same request again";
    /// The database does not answer, or refuses.
    DatabaseFailed = "DATABASE_FAILED", Unavailable,
        "send the same request again, with backoff; the operator finds the cause in the log";
    /// Another service writes to the same session.
    WrittenElsewhere = "WRITTEN_ELSEWHERE", Unavailable,
        "let one service write a session; send the same request again";
    /// A stored row cannot be read.
    StoredDataCorrupt = "STORED_DATA_CORRUPT", Internal, "restore the database from a backup";
    /// The service has a fault.
    Internal = "INTERNAL", Internal,
        "retry; if it persists, report it with the log of the service";

    // Streams and archives.

    /// The host's name cannot be resolved.
    HostUnresolved = "HOST_UNRESOLVED", NoCall, "check the host's name";
    /// The host's name resolves to addresses of a private network only.
    AddressRefused = "ADDRESS_REFUSED", NoCall,
        "name a public host, or let the operator set fetch.private_addresses";
    /// The host accepts no connection.
    HostUnreachable = "HOST_UNREACHABLE", NoCall,
        "check host and port; the service tries again by itself";
    /// The host's certificate is not valid, or it does not speak TLS.
    TlsFailed = "TLS_FAILED", NoCall,
        "check the host's certificate, or list its authority in fetch.ca_file";
    /// The caster refuses the user and password.
    CasterUnauthorised = "CASTER_UNAUTHORISED", NoCall,
        "create the base again with a valid user and password";
    /// The caster does not have this mountpoint.
    NoSuchMountpoint = "NO_SUCH_MOUNTPOINT", NoCall,
        "choose a mountpoint of the caster's sourcetable";
    /// The caster cannot serve now.
    CasterTryLater = "CASTER_TRY_LATER", NoCall, "nothing: the service tries again by itself";
    /// The caster redirects to another address, which the service does not follow.
    CasterRedirects = "CASTER_REDIRECTS", NoCall,
        "name the caster that the answer names, if you trust it";
    /// The answer does not follow the NTRIP protocol.
    CasterProtocol = "CASTER_PROTOCOL", NoCall, "check that the address is a caster's";
    /// The caster was silent for too long.
    CasterSilent = "CASTER_SILENT", NoCall, "nothing: the service tries again by itself";
    /// The stream has brought bytes for two minutes, but no epoch.
    CasterNoEpochs = "CASTER_NO_EPOCHS", NoCall,
        "choose a mountpoint of RTCM 3 observations (MSM4 to MSM7)";
    /// The caster ended the stream.
    CasterClosed = "CASTER_CLOSED", NoCall, "nothing: the service tries again by itself";
    /// The host does not have the file.
    FileNotFound = "FILE_NOT_FOUND", NoCall,
        "check the address; a file of today may come later";
    /// The fetched file is not RINEX of the right kind, or its gzip data is damaged.
    FileUnreadable = "FILE_UNREADABLE", NoCall,
        "check that the address is of RINEX files of the right kind, plain or gzip";
    /// The file has no epoch of the time that its address names.
    FileOfOtherTime = "FILE_OF_OTHER_TIME", NoCall, "check the placeholders of the address";
    /// The connection ended before the end of the file.
    FileCut = "FILE_CUT", NoCall, "nothing: the service tries again by itself";
    /// The file is larger than allowed.
    FileTooLarge = "FILE_TOO_LARGE", NoCall, "name a smaller file";
    /// The file did not arrive in time.
    HostSlow = "HOST_SLOW", NoCall, "nothing: the service tries again by itself";
    /// The host refuses the file, or cannot serve now.
    HostRefuses = "HOST_REFUSES", NoCall, "nothing: the service tries again by itself";
    /// The host redirects to another host, or too often.
    HostRedirects = "HOST_REDIRECTS", NoCall,
        "name the address that the answer names, if you trust it";
    /// The answer is not HTTP.
    HostProtocol = "HOST_PROTOCOL", NoCall, "check that the address is a web server's";

    // The start of the service, and replay.

    /// Others can reach the address to listen on, and the service has neither keys nor TLS.
    ListenNotLoopback = "LISTEN_NOT_LOOPBACK", NoCall,
        "listen on 127.0.0.1 or [::1], behind a proxy that authenticates if others need it";
    /// The port is taken, or the process may not open it.
    AddressUnavailable = "ADDRESS_UNAVAILABLE", NoCall,
        "choose another address with --listen, or let the process open this one";
    /// The log filter is invalid.
    LogFilterInvalid = "LOG_FILTER_INVALID", NoCall, "write a filter such as info";
    /// The configuration file is not TOML, or has an unknown key.
    ConfigurationMalformed = "CONFIGURATION_MALFORMED", NoCall,
        "correct the line that the message names";
    /// A pattern of fetch.hosts is invalid.
    FetchHostInvalid = "FETCH_HOST_INVALID", NoCall, "list hosts as host, host:port or *.domain";
    /// The file fetch.ca_file cannot be read.
    CertificatesInvalid = "CERTIFICATES_INVALID", NoCall, "name a PEM file of certificates";
    /// The file antennas.antex cannot be read.
    AntexInvalid = "ANTEX_INVALID", NoCall, "name an ANTEX file of absolute calibrations";
    /// The interval between requests to an archive is shorter than a minute.
    ArchiveIntervalTooShort = "ARCHIVE_INTERVAL_TOO_SHORT", NoCall,
        "raise the interval; 3600 s is usual";
    /// The interval between requests for a sourcetable is shorter than a minute.
    TableIntervalTooShort = "TABLE_INTERVAL_TOO_SHORT", NoCall,
        "raise the interval; 3600 s is usual";
    /// A limit is zero and would refuse everything.
    LimitZero = "LIMIT_ZERO", NoCall, "set the limit to at least 1, or remove the line";
    /// The database URL is invalid.
    DatabaseUrlInvalid = "DATABASE_URL_INVALID", NoCall,
        "give sqlite://FILE or postgres://USER@HOST/DATABASE";
    /// Another service has the lease of the database.
    DatabaseInUse = "DATABASE_IN_USE", NoCall,
        "stop the service that the message names, or give this one another database";
    /// A newer Graphfix wrote the database.
    DatabaseSchemaNewer = "DATABASE_SCHEMA_NEWER", NoCall,
        "run the Graphfix that wrote it, or a newer one";
    /// An older Graphfix wrote the database, and the command only reads it.
    DatabaseSchemaOlder = "DATABASE_SCHEMA_OLDER", NoCall,
        "run the Graphfix that wrote it, or let `graphfix serve` of this version open it once";
    /// The database's schema could not be brought up to date.
    DatabaseMigrationFailed = "DATABASE_MIGRATION_FAILED", NoCall,
        "restore the database from a backup, or report the failure";
    /// Replay needs navigation data that is no longer stored.
    NavigationForgotten = "NAVIGATION_FORGOTTEN", NoCall,
        "compute again from the observations, with navigation data of that time";
    /// Replay needs a base, or epochs of it, that are no longer stored.
    BaseForgotten = "BASE_FORGOTTEN", NoCall,
        "compute again from the observations, with the base's file";
    /// Epochs are removed, and no snapshot after them can be read.
    ReplayStartMissing = "REPLAY_START_MISSING", NoCall,
        "replay with the version that stored the session; new snapshots are stored every day";
    /// The same computation gives other bits than those stored.
    ReplayDiffers = "REPLAY_DIFFERS", NoCall,
        "replay with the version of Graphfix that the solutions name";

    // Commands: their arguments and files.

    /// An argument is missing, unknown or contradicts another.
    Usage = "USAGE", NoCall, "see graphfix --help, or graphfix COMMAND --help";
    /// The scenario does not exist.
    UnknownScenario = "UNKNOWN_SCENARIO", NoCall,
        "choose one of the scenarios that graphfix simulate --help lists";
    /// The ending of the output file's name belongs to no format.
    UnknownOutputFormat = "UNKNOWN_OUTPUT_FORMAT", NoCall,
        "name a file with an ending of the formats of this command";
    /// The file cannot be opened or read.
    FileNotReadable = "FILE_NOT_READABLE", NoCall, "check the path and its permissions";
    /// The file or folder cannot be written.
    FileNotWritable = "FILE_NOT_WRITABLE", NoCall,
        "check the folder, its permissions and its space";
    /// The file to write exists already.
    FileExists = "FILE_EXISTS", NoCall, "name another folder or add --force";
    /// The file is not of the kind that the command needs, or damaged.
    FileNotUnderstood = "FILE_NOT_UNDERSTOOD", NoCall,
        "name a file of the kind that the command takes, or repair it";
    /// A line of a solution or reference file cannot be read.
    FileMalformed = "FILE_MALFORMED", NoCall, "correct that line or name another file";
    /// The stream states its time only modulo a week or a day, and no argument gives the rest.
    NoReferenceTime = "NO_REFERENCE_TIME", NoCall, "add --week WEEK or --start-time TIME";
    /// No epoch lies in the window to plot.
    NothingToPlot = "NOTHING_TO_PLOT", NoCall, "check times and window";
    /// The service does not answer.
    ServiceUnreachable = "SERVICE_UNREACHABLE", NoCall,
        "check that the service runs and --server names it";
    /// The service refuses with a code that this program does not know; the message begins with it.
    ServiceRefused = "SERVICE_REFUSED", NoCall, "do what the service says";
    /// The process cannot start its threads.
    NoThreads = "NO_THREADS", NoCall, "let the process start threads";
}

impl fmt::Display for Code {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_upper_snake_case_and_distinct() {
        let mut seen = std::collections::BTreeSet::new();
        for code in Code::ALL {
            let plain = |c: char| c.is_ascii_uppercase() || c == '_';
            assert!(code.name().chars().all(plain), "{code}");
            assert!(seen.insert(code.name()), "{code} twice");
        }
    }
}
