-- How far the raw bytes of a session's receiver are stored, as offsets from the device's first byte.
CREATE TABLE raw_streams (
    session          BIGINT PRIMARY KEY REFERENCES sessions (key),
    stream           BIGINT NOT NULL, -- first byte of the stream in force
    header_end       BIGINT NOT NULL, -- end of its header, where it is RINEX
    tail             BIGINT NOT NULL, -- what restores it: header and the bytes from here on
    through          BIGINT NOT NULL, -- end of what is stored
    gps_time_ns      BIGINT NOT NULL, -- newest time known
    received_unix_ms BIGINT NOT NULL,
    piece            BIGINT NOT NULL, -- first byte of the last piece
    piece_ends       BIGINT NOT NULL, -- whether that one ended its stream
    first_seq        BIGINT NOT NULL, -- epochs that it completed, none where the first is larger
    last_seq         BIGINT NOT NULL
);

-- The bytes that restore the stream, and the last piece.
CREATE TABLE raw_pieces (
    session BIGINT NOT NULL REFERENCES sessions (key),
    start   BIGINT NOT NULL,
    through BIGINT NOT NULL,
    content BYTEA   NOT NULL,
    PRIMARY KEY (session, start)
);
