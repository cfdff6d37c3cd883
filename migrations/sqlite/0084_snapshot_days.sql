-- The epochs after a snapshot arrived on this day or later (days since 1970-01-01 UTC). NULL: not known, as for
-- the snapshots of earlier versions.
ALTER TABLE snapshots ADD COLUMN since_day INTEGER;
