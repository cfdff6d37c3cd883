-- What each tenant may use; NULL for no limit. `changed` is the number of the last change.
ALTER TABLE tenants ADD COLUMN sessions INTEGER;
ALTER TABLE tenants ADD COLUMN epochs_per_s REAL;
ALTER TABLE tenants ADD COLUMN cpu_s_per_minute REAL;
ALTER TABLE tenants ADD COLUMN stored_bytes INTEGER;
ALTER TABLE tenants ADD COLUMN changed INTEGER NOT NULL DEFAULT 0;
CREATE INDEX tenants_by_change ON tenants (changed);
CREATE TABLE tenant_changes (number INTEGER NOT NULL);
INSERT INTO tenant_changes (number) VALUES (0);

-- Bytes of the stored epochs and solutions of each session, approximately; those stored before are
-- not counted.
ALTER TABLE session_heads ADD COLUMN stored_bytes INTEGER NOT NULL DEFAULT 0;
