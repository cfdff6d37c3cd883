-- What each tenant may use; NULL for no limit. `changed` is the number of the last change.
ALTER TABLE tenants ADD COLUMN sessions BIGINT;
ALTER TABLE tenants ADD COLUMN epochs_per_s DOUBLE PRECISION;
ALTER TABLE tenants ADD COLUMN cpu_s_per_minute DOUBLE PRECISION;
ALTER TABLE tenants ADD COLUMN stored_bytes BIGINT;
ALTER TABLE tenants ADD COLUMN changed BIGINT NOT NULL DEFAULT 0;
CREATE INDEX tenants_by_change ON tenants (changed);
CREATE TABLE tenant_changes (number BIGINT NOT NULL);
INSERT INTO tenant_changes (number) VALUES (0);

-- Bytes of the stored epochs and solutions of each session, approximately; those stored before are
-- not counted.
ALTER TABLE session_heads ADD COLUMN stored_bytes BIGINT NOT NULL DEFAULT 0;
