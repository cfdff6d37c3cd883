-- How far earlier runs of a job were where its present run went on, so that its rate is that of the run.
ALTER TABLE jobs ADD COLUMN resumed_epochs INTEGER NOT NULL DEFAULT 0;
ALTER TABLE jobs ADD COLUMN resumed_bytes INTEGER NOT NULL DEFAULT 0;
