-- The reference frame of a base's coordinates, and the epoch to which they belong (decimal year);
-- NULL while unknown.
ALTER TABLE bases ADD COLUMN frame TEXT;
ALTER TABLE bases ADD COLUMN frame_epoch_year REAL;
