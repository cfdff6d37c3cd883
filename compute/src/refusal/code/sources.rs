//! Codes of what sessions need beside observations: navigation data, bases, files, archives.

/// Passes on the codes `before` and its own; see `collected` of the table.
macro_rules! sources {
    ($then:ident { $($before:tt)* } $($rest:ident)*) => { $then! { { $($before)*

    // Navigation data.

    /// The push has more ephemerides of one satellite than the service keeps.
    TooManyEphemerides = "TOO_MANY_EPHEMERIDES", TooLarge,
        "push a shorter span, or let the operator raise limits.ephemerides_per_satellite";

    /// A recording has no navigation data, and its observations hold none.
    NavigationRequired = "NAVIGATION_REQUIRED", Malformed,
        "name RINEX navigation data of that day, or a receiver's log with ephemerides";

    // Bases.

    /// The base does not exist.
    BaseNotFound = "BASE_NOT_FOUND", NotFound, "create a base, or check the id";
    /// The mode is relative to a base, and the request names neither base nor bases.
    BaseRequired = "BASE_REQUIRED", Malformed,
        "create a base, push its epochs, and name it as base";
    /// Positions relative to the base cannot be given in the frame that is asked for.
    FrameUnavailable = "FRAME_UNAVAILABLE", Malformed,
        "state the frame and epoch of the base's coordinates, or leave out the option frame";
    /// Heights above the geoid are asked for, and there is no table of it.
    GeoidMissing = "GEOID_MISSING", Malformed,
        "leave out the option geoid, or let the operator name a table as geoid_file";
    /// The service has API keys, and no key that encrypts the secrets that it must store.
    SecretsKeyMissing = "SECRETS_KEY_MISSING", Precondition,
        "let the operator name a key of secrets (serve --secrets-key-file), or send no password";
    /// An open session uses the base.
    BaseInUse = "BASE_IN_USE", Precondition,
        "close the sessions that use it, or let them use another base";
    /// The base is the operator's, and another tenant wants to change it.
    BaseOfOperator = "BASE_OF_OPERATOR", Forbidden,
        "use the base, or create one of your own";
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
        "write ntrip://HOST:PORT (or http://), or ntrips:// (or https://) for TLS";
    /// The mountpoint's name is invalid.
    MountpointInvalid = "MOUNTPOINT_INVALID", Malformed,
        "choose a mountpoint of the caster's sourcetable";
    /// The address of files or of a webhook is invalid, or that of an archive has no placeholders
    /// for the day.
    LocationInvalid = "LOCATION_INVALID", Malformed,
        "write http:// or https://, host and path; of an archive, with placeholders";
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
    /// The file ends inside its header, or is cut off before its first ephemeris.
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

} $($rest)* } } }
pub(super) use sources;
