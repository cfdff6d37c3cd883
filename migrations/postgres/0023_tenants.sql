-- Everything belongs to a tenant; what was stored before, to the operator's.
CREATE TABLE tenants (
    name            TEXT    PRIMARY KEY,
    created_unix_ms BIGINT  NOT NULL
);
INSERT INTO tenants (name, created_unix_ms) VALUES ('default', 0);
INSERT INTO tenants (name, created_unix_ms)
SELECT tenant, MIN(created_unix_ms) FROM api_keys WHERE tenant <> 'default' GROUP BY tenant;

ALTER TABLE sessions ADD COLUMN tenant TEXT NOT NULL DEFAULT 'default';
CREATE INDEX sessions_of_tenants ON sessions (tenant, key);
ALTER TABLE bases ADD COLUMN tenant TEXT NOT NULL DEFAULT 'default';

-- Each tenant names its requests itself. As on SQLite, the name is in a column of its own from now
-- on; `idempotency_key` stays as it was, and is no longer written.
ALTER TABLE jobs ADD COLUMN tenant TEXT NOT NULL DEFAULT 'default';
ALTER TABLE jobs ADD COLUMN request_name TEXT;
UPDATE jobs SET request_name = idempotency_key;
CREATE UNIQUE INDEX named_jobs ON jobs (tenant, request_name);
CREATE INDEX jobs_of_tenants ON jobs (tenant, key);
