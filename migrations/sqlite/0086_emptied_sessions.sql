-- 1: the retention has removed all that was stored of a closed session. Nothing comes after its end, so the hourly
-- removal need not look at it again. Services of earlier versions do not set it.
ALTER TABLE sessions ADD COLUMN emptied INTEGER NOT NULL DEFAULT 0;

-- Closed sessions by the time at which they expire: those with the retention of the service, and those with one of
-- their own.
CREATE INDEX sessions_to_empty ON sessions (closed_unix_ms)
    WHERE retention_days IS NULL AND emptied = 0 AND closed_unix_ms IS NOT NULL;
CREATE INDEX sessions_to_empty_by_own_retention ON sessions ((closed_unix_ms + 86400000 * CAST(retention_days AS BIGINT)))
    WHERE retention_days > 0 AND emptied = 0 AND closed_unix_ms IS NOT NULL;
