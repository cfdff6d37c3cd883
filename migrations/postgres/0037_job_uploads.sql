-- Files that arrive in several requests, before a job names them. `hash` is NULL until all bytes are there.
CREATE TABLE job_uploads (
    id              TEXT   PRIMARY KEY,
    tenant          TEXT   NOT NULL,
    name            TEXT   NOT NULL,
    bytes           BIGINT NOT NULL, -- of the whole file
    hash            TEXT,
    expires_unix_ms BIGINT NOT NULL
);
CREATE INDEX tenant_uploads ON job_uploads (tenant);
