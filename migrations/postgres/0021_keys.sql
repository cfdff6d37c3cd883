-- API keys. A key is never removed, so that an old one is never taken for none.
CREATE TABLE api_keys (
    key               BIGINT GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
    id                TEXT    NOT NULL UNIQUE,
    tenant            TEXT    NOT NULL DEFAULT 'default',
    rights            TEXT    NOT NULL, -- names, separated by spaces
    label             TEXT    NOT NULL,
    secret_sha256     BYTEA   NOT NULL UNIQUE,
    created_unix_ms   BIGINT  NOT NULL,
    expires_unix_ms   BIGINT, -- NULL for never
    revoked_unix_ms   BIGINT,
    last_used_unix_ms BIGINT, -- written once a minute at most
    changed           BIGINT  NOT NULL -- number of the last change but that of the last use
);
CREATE INDEX api_keys_by_change ON api_keys (changed);

-- Number of the last change of any key. Who changes a key counts it up first, so that changes become
-- visible in the order of their numbers.
CREATE TABLE api_key_changes (number BIGINT NOT NULL);
INSERT INTO api_key_changes (number) VALUES (0);
