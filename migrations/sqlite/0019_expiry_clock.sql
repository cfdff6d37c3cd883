-- One row: the time (ms since 1970-01-01 UTC) by which the ages of epochs are counted. It follows the clock
-- of the service, but never a step of it; NULL before the first count. Where something is stored, the
-- count begins when that came.
CREATE TABLE expiry_clock (unix_ms INTEGER);
INSERT INTO expiry_clock (unix_ms)
SELECT MAX(unix_ms) FROM (
    SELECT MAX(created_unix_ms) AS unix_ms FROM sessions
    UNION ALL SELECT MAX(closed_unix_ms) FROM session_heads
    UNION ALL SELECT 86400000 * MAX(day) FROM kept_snapshots
) AS stored;
