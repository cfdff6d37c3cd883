-- The address of the archive whose files fill the base, with placeholders for their times.
ALTER TABLE bases ADD COLUMN archive TEXT;
