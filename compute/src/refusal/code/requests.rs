//! Codes of requests: their form, sessions and their epochs, streams, raw bytes.

/// Passes on the codes `before` and its own; see `collected` of the table.
macro_rules! requests {
    ($then:ident { $($before:tt)* } $($rest:ident)*) => { $then! { { $($before)*

    // The request itself.

    /// The body is not JSON, or not a message of the schema.
    MalformedBody = "MALFORMED_BODY", Malformed,
        "send a body that the schema allows, see /openapi.json or the proto files";
    /// The schema has no such field.
    UnknownField = "UNKNOWN_FIELD", Malformed,
        "remove the field or correct its name; the message lists the known fields";
    /// A field is missing, of the wrong type, or out of range.
    InvalidField = "INVALID_FIELD", Malformed, "correct the named field";
    /// The call does not take a body of this content type or encoding.
    UnsupportedMediaType = "UNSUPPORTED_MEDIA_TYPE", MediaType,
        "send the content type or encoding that the message names";
    /// The body or message exceeds its limit.
    BodyTooLarge = "BODY_TOO_LARGE", TooLarge,
        "split the request, or let the operator raise limits.body_bytes, for memory \
         limits.request_memory_bytes";
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
    /// The request is not encrypted, and the port takes TLS only.
    TlsRequired = "TLS_REQUIRED", Malformed, "begin the address with https://";
    /// The request names a host that is not this service, as a web page of another host can.
    HostRefused = "HOST_REFUSED", Forbidden,
        "name the service by localhost or its address, or let the operator list the name in hosts";
    /// A web page of another origin sends the request.
    OriginRefused = "ORIGIN_REFUSED", Forbidden,
        "use the service from its own pages, or let the operator list the page's origin in cors";
    /// The path does not exist.
    RouteNotFound = "ROUTE_NOT_FOUND", Route, "see /docs for the paths";
    /// The path does not take this method.
    MethodNotAllowed = "METHOD_NOT_ALLOWED", Method, "see /docs for the methods of this path";
    /// The page token does not come from an answer to this call.
    PageTokenInvalid = "PAGE_TOKEN_INVALID", Malformed,
        "send nextPageToken of the previous answer, unchanged";
    /// What the request changes has changed since its sender read it.
    EtagMismatch = "ETAG_MISMATCH", Changed,
        "read it again, and send the change with its new etag";
    /// The page size is out of range.
    PageSizeInvalid = "PAGE_SIZE_INVALID", Malformed,
        "ask for a page size in the range that the message names";

    // Keys.

    /// The service has keys, and the request brings none.
    KeyRequired = "KEY_REQUIRED", Unauthenticated,
        "send authorization: Bearer and a key; the operator creates one by graphfix keys create";
    /// The text is not a key of this service.
    KeyInvalid = "KEY_INVALID", Unauthenticated,
        "send the secret as it was shown once, as authorization: Bearer SECRET";
    /// The key has expired.
    KeyExpired = "KEY_EXPIRED", Unauthenticated, "ask the operator for another key";
    /// The key is revoked.
    KeyRevoked = "KEY_REVOKED", Unauthenticated, "ask the operator for another key";
    /// The cookie is not one of a sign-in, or no longer.
    SignInEnded = "SIGN_IN_ENDED", Unauthenticated, "sign in again with a key";
    /// A change by a cookie does not bring the token of its sign-in.
    CsrfTokenInvalid = "CSRF_TOKEN_INVALID", Forbidden,
        "send csrfToken of GET /v1/sign-in as x-graphfix-csrf, or a key instead of the cookie";
    /// The key has none of the rights that the call needs.
    RightMissing = "RIGHT_MISSING", Forbidden,
        "use a key with one of the rights that the message names";
    /// The call is for the operator, and the key is of another tenant.
    OperatorOnly = "OPERATOR_ONLY", Forbidden, "use a key of the operator's tenant";
    /// Too many requests from one address had a wrong key.
    TooManyAttempts = "TOO_MANY_ATTEMPTS", Exhausted,
        "correct the key, and wait for the delay in the answer";
    /// The tenant has no such key.
    KeyNotFound = "KEY_NOT_FOUND", NotFound, "list the keys for their ids";
    /// No tenant has this name.
    TenantNotFound = "TENANT_NOT_FOUND", NotFound, "list the tenants for their names";
    /// The tenant has as many sessions as its quota.
    SessionQuotaExceeded = "SESSION_QUOTA_EXCEEDED", Exhausted,
        "delete sessions (purge=true), or let the operator raise the tenant's quota";
    /// The tenant sends more epochs a second than its quota.
    EpochQuotaExceeded = "EPOCH_QUOTA_EXCEEDED", Exhausted,
        "wait for the delay in the answer, or let the operator raise the tenant's quota";
    /// The tenant has used as much processor time in a minute as its quota.
    CpuQuotaExceeded = "CPU_QUOTA_EXCEEDED", Exhausted,
        "wait for the delay in the answer, or let the operator raise the tenant's quota";
    /// The tenant has as many bytes stored as its quota.
    StorageQuotaExceeded = "STORAGE_QUOTA_EXCEEDED", Exhausted,
        "delete sessions, give them a retention, or let the operator raise the tenant's quota";
    /// The files of the tenant's jobs take as many bytes as its quota.
    JobStorageQuotaExceeded = "JOB_STORAGE_QUOTA_EXCEEDED", Exhausted,
        "delete jobs (purge=true) and uploads, or let the operator raise the tenant's quota";
    /// As many keys are in force as allowed, or the tenant has created as many within a day.
    TooManyKeys = "TOO_MANY_KEYS", Precondition,
        "revoke keys that are no longer used, and create fewer keys a day";

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
        "send GPS week and nanoseconds of week, 0 to 604799999999999; in an address WEEK:SECONDS";
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
    /// The epoch's time is far ahead of the service's clock, or before GPS time begins.
    TimeImplausible = "TIME_IMPLAUSIBLE", Precondition,
        "correct the receiver's week number, or the service's clock; or let the operator raise \
         limits.future_s";
    /// The computation takes more time than a request may, or its window is longer.
    TooCostly = "TOO_COSTLY", TooLarge,
        "send fewer epochs, shorten the window, or use a session; the operator sets limits.solve_s";
    /// The session has no epoch to solve yet.
    SessionEmpty = "SESSION_EMPTY", Precondition, "push an epoch first";
    /// The session has no epoch of this number, or of these times.
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
    /// The settings of the session have changed too often.
    TooManyUpdates = "TOO_MANY_UPDATES", Exhausted,
        "wait for the delay in the answer, and change several fields in one call";
    /// The session has been reset as often as allowed.
    TooManyArcs = "TOO_MANY_ARCS", Precondition,
        "open another session, and close or delete this one";
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
    /// The cursor does not come from a watch of this session, or is beyond what is stored.
    CursorInvalid = "CURSOR_INVALID", Malformed,
        "send the cursor of the last received message, unchanged; if the database was restored \
         from a backup, watch with afterSeq";
    /// The device has acknowledgements that the session has not given.
    AcknowledgementUnknown = "ACKNOWLEDGEMENT_UNKNOWN", Precondition,
        "check the session's id; if the database was restored from a backup, open the stream \
         without the acknowledgement and send the later epochs again";

    // Raw bytes of a receiver.

    /// The raw chunk, or the chunk of a job's file on gRPC, is larger than allowed.
    PieceTooLarge = "PIECE_TOO_LARGE", TooLarge,
        "send smaller chunks, or let the operator raise limits.raw_piece_bytes, for jobs \
         limits.stream_bytes";
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

} $($rest)* } } }
pub(super) use requests;
