-- A client may name the request that creates a session or base, so that its repetition creates
-- nothing. The name is free again when what it has created is deleted.
ALTER TABLE sessions ADD COLUMN request_name TEXT;
ALTER TABLE sessions ADD COLUMN request_hash TEXT;
CREATE UNIQUE INDEX named_sessions ON sessions (tenant, request_name);
ALTER TABLE bases ADD COLUMN request_name TEXT;
ALTER TABLE bases ADD COLUMN request_hash TEXT;
CREATE UNIQUE INDEX named_bases ON bases (tenant, request_name);
