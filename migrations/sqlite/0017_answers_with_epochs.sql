-- An epoch and its first answer are one row, and later answers are rows of `revisions`: a row and three
-- entries of indices less for each epoch. A time is found by its number, so there is no index of times.
-- The columns of the position, with those of its quality, serve readers of SQL too; `content` has the
-- epoch, `solution` what the columns leave of its answer.
--
-- Here the tables are made and filled; the next migration drops the former ones.
ALTER TABLE epochs RENAME TO former_epochs;

CREATE TABLE epochs (
    session         INTEGER NOT NULL, -- the commit of its head finds the session
    seq             INTEGER NOT NULL,
    gps_time_ns     INTEGER NOT NULL,
    navigation      INTEGER NOT NULL, -- push with which it was solved
    base            INTEGER, -- base with which it was solved, and which of its epochs were new then
    base_after      INTEGER,
    base_through    INTEGER,
    x_m             REAL, -- ECEF
    y_m             REAL,
    z_m             REAL,
    origin          INTEGER, -- see solution_origins; NULL where the bytes name it
    sigma_east_mm   INTEGER, -- standard deviations of the position
    sigma_north_mm  INTEGER,
    sigma_up_mm     INTEGER,
    ratio           REAL, -- of second-best to best integers
    base_age_ms     INTEGER, -- time of the epoch minus that of the base epoch
    status          INTEGER NOT NULL, -- 0 none, 10 single, 15 EKF, 20 FGO, 30 float, 40 fixed
    content         BLOB NOT NULL,
    solution        BLOB NOT NULL,
    UNIQUE (session, seq)
);
CREATE TABLE revisions (
    session         INTEGER NOT NULL,
    seq             INTEGER NOT NULL,
    gps_time_ns     INTEGER NOT NULL,
    x_m             REAL, -- ECEF
    y_m             REAL,
    z_m             REAL,
    origin          INTEGER, -- see solution_origins; NULL where the bytes name it
    sigma_east_mm   INTEGER, -- standard deviations of the position
    sigma_north_mm  INTEGER,
    sigma_up_mm     INTEGER,
    ratio           REAL, -- of second-best to best integers
    base_age_ms     INTEGER, -- time of the epoch minus that of the base epoch
    revision        INTEGER NOT NULL, -- from 1 on
    status          INTEGER NOT NULL,
    content         BLOB NOT NULL, -- whole, or relative to the first answer
    UNIQUE (session, seq, revision)
);

INSERT INTO epochs (session, seq, gps_time_ns, navigation, base, base_after, base_through, x_m, y_m, z_m,
                    origin, status, content, solution)
SELECT e.session, e.seq, e.gps_time_ns, e.navigation, e.base, e.base_after, e.base_through, s.x_m, s.y_m,
       s.z_m, s.origin, s.status, e.content, s.content
FROM former_epochs e
JOIN solutions s ON s.session = e.session AND s.seq = e.seq AND s.revision = 0;
INSERT INTO revisions (session, seq, gps_time_ns, x_m, y_m, z_m, origin, revision, status, content)
SELECT session, seq, gps_time_ns, x_m, y_m, z_m, origin, revision, status, content
FROM solutions WHERE revision > 0;

-- Sessions from before keep everything, as they did; the default of the service is now a number of days.
UPDATE sessions SET retention_days = 0 WHERE retention_days IS NULL;
