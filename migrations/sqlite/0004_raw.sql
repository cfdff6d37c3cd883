-- How far the raw bytes of a session's receiver are stored, as offsets from the device's first byte.
CREATE TABLE raw_streams (
    session          INTEGER PRIMARY KEY REFERENCES sessions (key),
    stream           INTEGER NOT NULL, -- first byte of the stream in force
    header_end       INTEGER NOT NULL, -- end of its header, where it is RINEX
    tail             INTEGER NOT NULL, -- what restores it: header and the bytes from here on
    through          INTEGER NOT NULL, -- end of what is stored
    gps_time_ns      INTEGER NOT NULL, -- newest time known
    received_unix_ms INTEGER NOT NULL,
    piece            INTEGER NOT NULL, -- first byte of the last piece
    piece_ends       INTEGER NOT NULL, -- whether that one ended its stream
    first_seq        INTEGER NOT NULL, -- epochs that it completed, none where the first is larger
    last_seq         INTEGER NOT NULL
);

-- The bytes that restore the stream, and the last piece.
CREATE TABLE raw_pieces (
    session INTEGER NOT NULL REFERENCES sessions (key),
    start   INTEGER NOT NULL,
    through INTEGER NOT NULL,
    content BLOB    NOT NULL,
    PRIMARY KEY (session, start)
);
