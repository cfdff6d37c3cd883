-- Whether a caster is told where the base's rovers are: 0 or 1.
ALTER TABLE base_feeds ADD COLUMN follows_rover INTEGER NOT NULL DEFAULT 0;
