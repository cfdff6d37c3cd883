-- When a session was deleted. What it stored is removed piece by piece, its head last; its row stays,
-- so that its id is never used again.
ALTER TABLE sessions ADD COLUMN deleted_unix_ms INTEGER;
CREATE INDEX deleted_sessions ON sessions (key) WHERE deleted_unix_ms IS NOT NULL;
