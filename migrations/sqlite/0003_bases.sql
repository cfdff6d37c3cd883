-- Base stations. `key` is the short form of `id`; a base that was deleted keeps its row, for the
-- sessions and solutions that name it.
CREATE TABLE bases (
    key             INTEGER PRIMARY KEY AUTOINCREMENT,
    id              TEXT    NOT NULL UNIQUE,
    label           TEXT    NOT NULL,
    created_unix_ms INTEGER NOT NULL,
    deleted_unix_ms INTEGER
);

-- Where a base stands, from its epoch number `since` on.
CREATE TABLE base_sites (
    base     INTEGER NOT NULL REFERENCES bases (key),
    since    INTEGER NOT NULL,
    x_m      REAL    NOT NULL, -- marker, ECEF
    y_m      REAL    NOT NULL,
    z_m      REAL    NOT NULL,
    height_m REAL    NOT NULL, -- antenna reference point above, east, north of it
    east_m   REAL    NOT NULL,
    north_m  REAL    NOT NULL,
    antenna  TEXT    NOT NULL,
    source   TEXT    NOT NULL, -- given, header, message
    PRIMARY KEY (base, since)
);

-- What bases observed, in order of time; `content` is the encoding of `epochs`.
CREATE TABLE base_epochs (
    base           INTEGER NOT NULL REFERENCES bases (key),
    number         INTEGER NOT NULL,
    gps_time_ns    INTEGER NOT NULL,
    stored_unix_ms INTEGER NOT NULL,
    content        BLOB    NOT NULL,
    PRIMARY KEY (base, number)
);

-- The base in force; NULL for none.
ALTER TABLE sessions ADD COLUMN base INTEGER REFERENCES bases (key);

-- The base an epoch was solved with, and which of its epochs were new then: those numbered above
-- `base_after`, up to `base_through`.
ALTER TABLE epochs ADD COLUMN base INTEGER;
ALTER TABLE epochs ADD COLUMN base_after INTEGER;
ALTER TABLE epochs ADD COLUMN base_through INTEGER;
