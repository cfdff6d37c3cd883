-- Calibrations of antennas that sessions or bases apply, by the hash of their content.
CREATE TABLE antenna_calibrations (
    hash    TEXT PRIMARY KEY,
    content BLOB NOT NULL
);

-- The calibration of the rover's antenna, and its type and radome; NULL where none is corrected.
ALTER TABLE sessions ADD COLUMN antenna TEXT;
ALTER TABLE sessions ADD COLUMN calibration TEXT;

-- The calibration of the rover's antenna, which is part of what the hash covers.
ALTER TABLE configurations ADD COLUMN calibration TEXT;

-- The calibration of the base's antenna; NULL where it is not known.
ALTER TABLE base_sites ADD COLUMN calibration TEXT;
