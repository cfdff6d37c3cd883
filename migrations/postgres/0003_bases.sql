-- Base stations. `key` is the short form of `id`; a base that was deleted keeps its row, for the
-- sessions and solutions that name it.
CREATE TABLE bases (
    key             BIGINT  GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
    id              TEXT    NOT NULL UNIQUE,
    label           TEXT    NOT NULL,
    created_unix_ms BIGINT NOT NULL,
    deleted_unix_ms BIGINT
);

-- Where a base stands, from its epoch number `since` on.
CREATE TABLE base_sites (
    base     BIGINT NOT NULL REFERENCES bases (key),
    since    BIGINT NOT NULL,
    x_m      DOUBLE PRECISION NOT NULL, -- marker, ECEF
    y_m      DOUBLE PRECISION NOT NULL,
    z_m      DOUBLE PRECISION NOT NULL,
    height_m DOUBLE PRECISION NOT NULL, -- antenna reference point above, east, north of it
    east_m   DOUBLE PRECISION NOT NULL,
    north_m  DOUBLE PRECISION NOT NULL,
    antenna  TEXT    NOT NULL,
    source   TEXT    NOT NULL, -- given, header, message
    PRIMARY KEY (base, since)
);

-- What bases observed, in order of time; `content` is the encoding of `epochs`.
CREATE TABLE base_epochs (
    base           BIGINT NOT NULL REFERENCES bases (key),
    number         BIGINT NOT NULL,
    gps_time_ns    BIGINT NOT NULL,
    stored_unix_ms BIGINT NOT NULL,
    content        BYTEA   NOT NULL,
    PRIMARY KEY (base, number)
);

-- The base in force; NULL for none.
ALTER TABLE sessions ADD COLUMN base BIGINT REFERENCES bases (key);

-- The base an epoch was solved with, and which of its epochs were new then: those numbered above
-- `base_after`, up to `base_through`.
ALTER TABLE epochs ADD COLUMN base BIGINT;
ALTER TABLE epochs ADD COLUMN base_after BIGINT;
ALTER TABLE epochs ADD COLUMN base_through BIGINT;
