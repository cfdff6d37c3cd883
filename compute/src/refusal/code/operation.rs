//! Codes of the service itself, of its start, and of commands.

/// Passes on the codes `before` and its own; see `collected` of the table.
macro_rules! operation {
    ($then:ident { $($before:tt)* } $($rest:ident)*) => { $then! { { $($before)*

    // The service.

    /// The service is about to stop.
    Draining = "DRAINING", Unavailable, "connect again shortly and send the same request again";
    /// The database does not answer, or refuses.
    DatabaseFailed = "DATABASE_FAILED", Unavailable,
        "send the same request again, with backoff; the operator finds the cause in the log";
    /// Another service writes to the same session.
    WrittenElsewhere = "WRITTEN_ELSEWHERE", Unavailable,
        "let one service write a session; send the same request again";
    /// The session is another node's of the cluster.
    SessionElsewhere = "SESSION_ELSEWHERE", Unavailable,
        "send the same request again, with the session in the header x-graphfix-session";
    /// The node that must answer the call does not.
    NodeUnreachable = "NODE_UNREACHABLE", Unavailable,
        "send the same request again, with backoff; another node takes over within seconds";
    /// A stored row cannot be read.
    StoredDataCorrupt = "STORED_DATA_CORRUPT", Internal, "restore the database from a backup";
    /// The service has a fault.
    Internal = "INTERNAL", Internal,
        "retry; if it persists, report it with the log of the service";

    // The start of the service, and replay.

    /// Others can reach the address to listen on, and the database has no key.
    ListenNotLoopback = "LISTEN_NOT_LOOPBACK", NoCall,
        "create a key first (graphfix keys create), or listen on 127.0.0.1 or [::1]";
    /// Others can reach the address to listen on, and nothing encrypts what they send.
    ListenNotEncrypted = "LISTEN_NOT_ENCRYPTED", NoCall,
        "give --tls-certificate and --tls-key, or --plaintext if a proxy before it has TLS";
    /// A PEM file of certificates, or of a key, cannot be read.
    TlsFileInvalid = "TLS_FILE_INVALID", NoCall,
        "name PEM files: certificates, the own one first, and its key without a password";
    /// The private key is not that of the certificate.
    TlsKeyMismatch = "TLS_KEY_MISMATCH", NoCall,
        "name the key that the certificate was requested with";
    /// The certificate, or a list of revoked ones, has expired, or is not valid yet.
    TlsCertificateExpired = "TLS_CERTIFICATE_EXPIRED", NoCall,
        "renew the certificate or the list, or correct the clock of this machine";
    /// A key of stored secrets cannot be read.
    SecretsKeyInvalid = "SECRETS_KEY_INVALID", NoCall,
        "name a file with 64 hexadecimal digits, such as `openssl rand -hex 32` prints";
    /// Stored secrets are encrypted with a key that is not given.
    SecretsKeyUnknown = "SECRETS_KEY_UNKNOWN", NoCall,
        "name it in secrets.former_key_files, or give the secrets up (graphfix secrets forget)";
    /// The address of the collector of traces is invalid.
    TelemetryEndpointInvalid = "TELEMETRY_ENDPOINT_INVALID", NoCall,
        "name the collector's gRPC port as http://HOST:4317 or https://HOST:4317";
    /// The port is taken, or the process may not open it.
    AddressUnavailable = "ADDRESS_UNAVAILABLE", NoCall,
        "choose another address with --listen, stop the program that has this one, or let the \
         process open it";
    /// The log filter is invalid.
    LogFilterInvalid = "LOG_FILTER_INVALID", NoCall, "write a filter such as info";
    /// The configuration file is not TOML, or has an unknown key.
    ConfigurationMalformed = "CONFIGURATION_MALFORMED", NoCall,
        "correct the line that the message names";
    /// A pattern of fetch.hosts is invalid.
    FetchHostInvalid = "FETCH_HOST_INVALID", NoCall,
        "list hosts as host, host:port or *.domain; those of one tenant in fetch.tenants";
    /// The file fetch.ca_file cannot be read.
    CertificatesInvalid = "CERTIFICATES_INVALID", NoCall, "name a PEM file of certificates";
    /// The file antennas.antex cannot be read.
    AntexInvalid = "ANTEX_INVALID", NoCall, "name an ANTEX file of absolute calibrations";
    /// The file geoid_file cannot be read, or is no table of the geoid.
    GeoidInvalid = "GEOID_INVALID", NoCall,
        "name a PGM file of GeographicLib, or a GTX or ISG file";
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
    /// The lease of the database ended while the service could not renew it.
    LeaseLost = "LEASE_LOST", NoCall,
        "start it again, as a supervisor does; if that is refused, stop what the message names";
    /// A cluster is configured, and the database is not on Postgres.
    ClusterNeedsPostgres = "CLUSTER_NEEDS_POSTGRES", NoCall,
        "give a database on Postgres, or remove the section [cluster]";
    /// The address under which other nodes reach this one is invalid.
    ClusterAddressInvalid = "CLUSTER_ADDRESS_INVALID", NoCall,
        "give http://HOST:PORT or https://HOST:PORT of this node, as the others reach it";
    /// An option whose work one node of a cluster cannot do for the others.
    NotInCluster = "NOT_IN_CLUSTER", NoCall,
        "remove the option that the message names, or the section [cluster]";
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

    /// The key to rotate has expired or is revoked.
    KeyEnded = "KEY_ENDED", NoCall, "create another key";
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
    /// The service answers, but is not ready for requests.
    ServiceNotReady = "SERVICE_NOT_READY", NoCall,
        "wait, or look at the problems that the message names";
    /// The service refuses with a code that this program does not know; the message begins with it.
    ServiceRefused = "SERVICE_REFUSED", NoCall, "do what the service says";
    /// A load was not answered completely, or the store lacks what was acknowledged.
    LoadIncomplete = "LOAD_INCOMPLETE", NoCall, "see the errors above and the service's log";
    /// The process cannot start its threads.
    NoThreads = "NO_THREADS", NoCall, "let the process start threads";
    /// The system does not limit the memory of the process.
    MemoryNotLimited = "MEMORY_NOT_LIMITED", NoCall,
        "give --memory a value below the limit that the process has already";

} $($rest)* } } }
pub(super) use operation;
