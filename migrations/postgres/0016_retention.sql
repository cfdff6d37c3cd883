-- For how long a session's epochs are kept (days); 0 for ever, NULL as the service is configured.
ALTER TABLE sessions ADD COLUMN retention_days BIGINT;

-- Number through which a session's epochs are removed; NULL if none are.
ALTER TABLE session_heads ADD COLUMN removed_through BIGINT;

-- The first state that a session stored on each day, from which it can be replayed once the epochs
-- before are removed. All epochs up to `seq` had arrived on this day.
CREATE TABLE kept_snapshots (
    session            BIGINT NOT NULL REFERENCES sessions (key),
    day                BIGINT NOT NULL, -- since 1970-01-01 UTC
    seq                BIGINT NOT NULL,
    configuration_hash TEXT   NOT NULL,
    content            BYTEA  NOT NULL,
    PRIMARY KEY (session, day)
);
