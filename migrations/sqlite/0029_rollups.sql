-- Sums of a session's first answers, written with them: a row for each minute and each hour of its epochs'
-- times. They begin with this schema; nothing is computed of epochs that are stored already. Rows of
-- minutes are removed with their epochs, those of hours after limits.history_days.
CREATE TABLE rollups (
    session           INTEGER NOT NULL, -- the commit of its head finds the session
    seconds           INTEGER NOT NULL, -- length of the bucket: 60 or 3600
    begin_s           INTEGER NOT NULL, -- begin of the bucket, GPS time since 1980-01-06
    day               INTEGER, -- of the last arrival, since 1970-01-01 UTC
    first_time_ns     INTEGER NOT NULL, -- earliest and latest time tag
    last_time_ns      INTEGER NOT NULL,
    last_seq          INTEGER NOT NULL, -- number of the last epoch
    n_none            INTEGER NOT NULL, -- epochs of each status
    n_single          INTEGER NOT NULL,
    n_ekf             INTEGER NOT NULL,
    n_fgo             INTEGER NOT NULL,
    n_float           INTEGER NOT NULL,
    n_fixed           INTEGER NOT NULL,
    status            INTEGER NOT NULL, -- of the last epoch
    latitude_deg      REAL, -- the last position
    longitude_deg     REAL,
    positions         INTEGER NOT NULL, -- epochs with a position
    ages              INTEGER NOT NULL, -- epochs with a base
    south_deg         REAL, -- box around the positions; west and east are the least and greatest longitude
    west_deg          REAL,
    north_deg         REAL,
    east_deg          REAL,
    height_min_m      REAL, -- above the ellipsoid
    height_max_m      REAL,
    height_sum_m      REAL NOT NULL,
    height_last_m     REAL,
    sigma_min_m       REAL, -- standard deviation along the worst horizontal direction
    sigma_max_m       REAL,
    sigma_sum_m       REAL NOT NULL,
    sigma_last_m      REAL,
    satellites_min    REAL, -- used
    satellites_max    REAL,
    satellites_sum    REAL NOT NULL,
    satellites_last   REAL,
    age_min_s         REAL, -- of the base epoch
    age_max_s         REAL,
    age_sum_s         REAL NOT NULL,
    age_last_s        REAL,
    PRIMARY KEY (session, seconds, begin_s)
) WITHOUT ROWID;
-- To find what has expired.
CREATE INDEX rollups_by_day ON rollups (day) WHERE seconds = 3600;

-- Sums of these hours over all sessions of a tenant.
CREATE TABLE fleet_hours (
    tenant            TEXT NOT NULL,
    begin_s           INTEGER NOT NULL, -- as in rollups
    day               INTEGER, -- as in rollups
    sessions          INTEGER NOT NULL, -- with epochs in this hour
    n_none            INTEGER NOT NULL,
    n_single          INTEGER NOT NULL,
    n_ekf             INTEGER NOT NULL,
    n_fgo             INTEGER NOT NULL,
    n_float           INTEGER NOT NULL,
    n_fixed           INTEGER NOT NULL,
    positions         INTEGER NOT NULL,
    ages              INTEGER NOT NULL,
    sigma_sum_m       REAL NOT NULL,
    satellites_sum    REAL NOT NULL,
    age_sum_s         REAL NOT NULL,
    PRIMARY KEY (tenant, begin_s)
) WITHOUT ROWID;
CREATE INDEX fleet_hours_by_day ON fleet_hours (day);
