-- Who has done what: one row for each administrative act, written with it, and for each that was
-- refused. Rows are removed by age; none is changed.
CREATE TABLE audit_entries (
    key          INTEGER PRIMARY KEY,
    id           TEXT    NOT NULL UNIQUE,
    unix_ms      INTEGER NOT NULL,
    tenant       TEXT    NOT NULL, -- to whom the object belongs; of a refused act, who asked
    actor        TEXT    NOT NULL, -- id of a key, or 'loopback', 'command-line', 'unknown'
    actor_tenant TEXT    NOT NULL,
    call         TEXT    NOT NULL, -- such as 'Keys.Create'
    object       TEXT    NOT NULL, -- id of what is changed; empty if there is none
    outcome      TEXT    NOT NULL, -- 'DONE', or the code of the refusal
    request      TEXT    NOT NULL, -- id of the request, as in the log; empty without one
    node         TEXT    NOT NULL,
    change       TEXT    NOT NULL  -- for people
);
CREATE INDEX audit_entries_of_tenants ON audit_entries (tenant, key);
CREATE INDEX audit_entries_by_time ON audit_entries (unix_ms);

CREATE TRIGGER audit_entries_stay BEFORE UPDATE ON audit_entries
BEGIN
    SELECT RAISE(ABORT, 'entries of the audit log are not changed');
END;
