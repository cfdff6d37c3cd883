-- The node that has the lease of the database, or had it last.
ALTER TABLE committer ADD COLUMN node TEXT NOT NULL DEFAULT '';
