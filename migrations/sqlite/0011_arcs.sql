-- Where sessions began a new arc: the epochs after it are positioned without those before.
CREATE TABLE session_arcs (
    session         INTEGER NOT NULL REFERENCES sessions (key),
    after_seq       INTEGER NOT NULL,
    created_unix_ms INTEGER NOT NULL,
    PRIMARY KEY (session, after_seq)
);
