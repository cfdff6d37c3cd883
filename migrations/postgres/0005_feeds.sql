-- The stream of a caster that fills a base.
CREATE TABLE base_feeds (
    base       BIGINT PRIMARY KEY REFERENCES bases (key),
    caster     TEXT    NOT NULL, -- such as ntrip://caster.example.org:2101
    mountpoint TEXT    NOT NULL,
    name       TEXT    NOT NULL, -- of the caster's user; empty for none
    password   TEXT    NOT NULL, -- as it is sent; nothing shows it
    version    INTEGER NOT NULL, -- of NTRIP: 1 or 2
    near_ns    BIGINT,          -- dates a stream that is played later than observed
    x_m        DOUBLE PRECISION,             -- what the caster is told of the rover's place, ECEF
    y_m        DOUBLE PRECISION,
    z_m        DOUBLE PRECISION
);
