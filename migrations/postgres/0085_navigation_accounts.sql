-- Superseded navigation data are counted by account: '' for the data that serve all sessions, 'device' for those
-- of the operator's devices, and the source of each other tenant. Earlier versions count all together; rows of
-- theirs that are not moved here are counted with the data that serve all.
ALTER TABLE ephemerides ADD COLUMN account TEXT NOT NULL DEFAULT '';
ALTER TABLE navigation_records ADD COLUMN account TEXT NOT NULL DEFAULT '';
UPDATE ephemerides SET account = CASE WHEN source LIKE 'device tenant %' THEN source ELSE 'device' END
    WHERE source LIKE 'device %';
UPDATE navigation_records SET account = CASE WHEN source LIKE 'device tenant %' THEN source ELSE 'device' END
    WHERE source LIKE 'device %';
CREATE INDEX ephemerides_of_accounts ON ephemerides (account, until) WHERE until IS NOT NULL;
CREATE INDEX navigation_records_of_accounts ON navigation_records (account, until) WHERE until IS NOT NULL;

-- The first push since which nothing of an account has been forgotten. Without a row it is that of
-- navigation_pushes, before which the data that serve all are forgotten.
CREATE TABLE navigation_accounts (
    account        TEXT PRIMARY KEY,
    complete_since BIGINT NOT NULL
);
