-- What two pushes of navigation data differ by is found by their numbers.
CREATE INDEX begun_ephemerides ON ephemerides (since);
