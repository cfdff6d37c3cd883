-- Which push of navigation data an epoch was solved with; 0 before pushes were counted.
ALTER TABLE epochs ADD COLUMN navigation BIGINT NOT NULL DEFAULT 0;

-- Every configuration that solved an epoch, by its hash.
CREATE TABLE configurations (
    hash          TEXT PRIMARY KEY,
    mode          TEXT NOT NULL,
    profile       TEXT NOT NULL,
    configuration TEXT NOT NULL -- JSON object: every option with its value in force
);
INSERT INTO configurations (hash, mode, profile, configuration)
SELECT configuration_hash, MIN(mode), MIN(profile), MIN(configuration)
FROM sessions GROUP BY configuration_hash;

-- The newest state of each session's estimator: what came after `seq` is replayed onto it.
CREATE TABLE snapshots (
    session            BIGINT PRIMARY KEY REFERENCES sessions (key),
    seq                BIGINT NOT NULL,
    configuration_hash TEXT NOT NULL,
    content            BYTEA NOT NULL
);

-- Ephemerides are in force from the push `since` until before the push `until`; kept beyond that,
-- for replay.
CREATE TABLE ephemerides_in_force (
    satellite      TEXT NOT NULL,
    toe_ns         BIGINT NOT NULL,
    message        TEXT NOT NULL,
    toc_ns         BIGINT NOT NULL,
    issue          BIGINT NOT NULL,
    since          BIGINT NOT NULL,
    until          BIGINT,
    source         TEXT NOT NULL,
    stored_unix_ms BIGINT NOT NULL,
    content        BYTEA NOT NULL,
    PRIMARY KEY (satellite, toe_ns, message, toc_ns, issue, since)
);
INSERT INTO ephemerides_in_force (satellite, toe_ns, message, toc_ns, issue, since, until, source,
                                  stored_unix_ms, content)
SELECT satellite, toe_ns, message, toc_ns, issue, 0, NULL, source, stored_unix_ms, content
FROM ephemerides;
DROP TABLE ephemerides;
ALTER TABLE ephemerides_in_force RENAME TO ephemerides;
CREATE INDEX superseded_ephemerides ON ephemerides (until) WHERE until IS NOT NULL;

CREATE TABLE navigation_records_in_force (
    kind           TEXT NOT NULL,
    since          BIGINT NOT NULL,
    until          BIGINT,
    source         TEXT NOT NULL,
    stored_unix_ms BIGINT NOT NULL,
    content        BYTEA NOT NULL,
    PRIMARY KEY (kind, since)
);
INSERT INTO navigation_records_in_force (kind, since, until, source, stored_unix_ms, content)
SELECT kind, 0, NULL, source, stored_unix_ms, content FROM navigation_records;
DROP TABLE navigation_records;
ALTER TABLE navigation_records_in_force RENAME TO navigation_records;

-- One row: the last push, and the first since which nothing has been forgotten.
CREATE TABLE navigation_pushes (
    newest         BIGINT NOT NULL,
    complete_since BIGINT NOT NULL
);
INSERT INTO navigation_pushes (newest, complete_since) VALUES (0, 0);
