-- Sessions. `key` is the short form of `id` in the tables that grow.
CREATE TABLE sessions (
    key                INTEGER PRIMARY KEY AUTOINCREMENT,
    id                 TEXT    NOT NULL UNIQUE,
    label              TEXT    NOT NULL,
    mode               TEXT    NOT NULL,
    profile            TEXT    NOT NULL,
    overrides          TEXT    NOT NULL, -- JSON object: option name, value
    configuration      TEXT    NOT NULL, -- JSON object: every option with its value in force
    configuration_hash TEXT    NOT NULL,
    created_unix_ms    INTEGER NOT NULL,
    closed_unix_ms     INTEGER
);

-- Epochs as received; `content` is their canonical encoding, version in its first byte.
CREATE TABLE epochs (
    session     INTEGER NOT NULL REFERENCES sessions (key),
    seq         INTEGER NOT NULL,
    gps_time_ns INTEGER NOT NULL,
    content     BLOB    NOT NULL,
    UNIQUE (session, seq)
);

-- Solutions. `content` holds all of them bit by bit; the columns serve filters and readers of SQL.
CREATE TABLE solutions (
    session     INTEGER NOT NULL REFERENCES sessions (key),
    seq         INTEGER NOT NULL,
    revision    INTEGER NOT NULL, -- 0 is the real-time answer
    gps_time_ns INTEGER NOT NULL,
    status      INTEGER NOT NULL, -- 0 none, 10 single
    x_m         REAL, -- ECEF
    y_m         REAL,
    z_m         REAL,
    content     BLOB    NOT NULL,
    UNIQUE (session, seq, revision)
);
CREATE INDEX solutions_by_time ON solutions (session, gps_time_ns);

-- Broadcast ephemerides; the key is what tells two of them apart.
CREATE TABLE ephemerides (
    satellite     TEXT    NOT NULL,
    toe_ns        INTEGER NOT NULL,
    message       TEXT    NOT NULL,
    toc_ns        INTEGER NOT NULL,
    issue         INTEGER NOT NULL,
    source        TEXT    NOT NULL,
    stored_unix_ms INTEGER NOT NULL,
    content       BLOB    NOT NULL,
    PRIMARY KEY (satellite, toe_ns, message, toc_ns, issue)
);

-- Ionosphere coefficients and leap seconds, the newest of each kind.
CREATE TABLE navigation_records (
    kind          TEXT    PRIMARY KEY,
    source        TEXT    NOT NULL,
    stored_unix_ms INTEGER NOT NULL,
    content       BLOB    NOT NULL
);
