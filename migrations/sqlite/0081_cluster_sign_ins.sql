-- Sign-ins of browsers, so that each node of a cluster knows them, and a service after a restart. The
-- cookie is not stored.
CREATE TABLE sign_ins (
    cookie_sha256   BLOB    PRIMARY KEY,
    api_key         TEXT    NOT NULL, -- id of the key that the browser signed in with
    expires_unix_ms INTEGER NOT NULL, -- the row is removed then
    ended           INTEGER NOT NULL DEFAULT 0, -- 1 for one that was ended: others are to learn of it
    changed         INTEGER NOT NULL -- number of the last change, counted with those of keys
);
CREATE INDEX sign_ins_by_change ON sign_ins (changed);
