-- Batch jobs. `request` has options and input files, `report` and `failure` what came of them, all as
-- JSON. `fence` rises with each claim: only the last claimant ends the job.
CREATE TABLE jobs (
    key               BIGINT  GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
    id                TEXT    NOT NULL UNIQUE,
    state             TEXT    NOT NULL, -- QUEUED, RUNNING, SUCCEEDED, FAILED, CANCELLED
    request           TEXT    NOT NULL,
    request_hash      TEXT    NOT NULL,
    idempotency_key   TEXT    UNIQUE,
    created_unix_ms   BIGINT  NOT NULL,
    started_unix_ms   BIGINT,
    ended_unix_ms     BIGINT,
    node              TEXT    NOT NULL DEFAULT '',
    fence             BIGINT  NOT NULL DEFAULT 0,
    heartbeat_unix_ms BIGINT,
    epochs            BIGINT  NOT NULL DEFAULT 0,
    answered          BIGINT  NOT NULL DEFAULT 0,
    read_bytes        BIGINT  NOT NULL DEFAULT 0,
    result            TEXT, -- name of the file
    result_bytes      BIGINT,
    report            TEXT,
    failure           TEXT
);
CREATE INDEX waiting_jobs ON jobs (key) WHERE ended_unix_ms IS NULL;
CREATE INDEX ended_jobs ON jobs (ended_unix_ms) WHERE ended_unix_ms IS NOT NULL;
