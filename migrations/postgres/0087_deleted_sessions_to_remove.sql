-- Deleted sessions of which something is left. The others are marked as emptied, so that the removal looks at none
-- of them again. The index deleted_sessions is no longer read.
UPDATE sessions SET emptied = CASE WHEN EXISTS
    (SELECT 1 FROM session_heads WHERE session_heads.session = sessions.key) THEN 0 ELSE 1 END
    WHERE deleted_unix_ms IS NOT NULL;
CREATE INDEX sessions_to_remove ON sessions (key) WHERE deleted_unix_ms IS NOT NULL AND emptied = 0;
