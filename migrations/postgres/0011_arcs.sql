-- Where sessions began a new arc: the epochs after it are positioned without those before.
CREATE TABLE session_arcs (
    session         BIGINT NOT NULL REFERENCES sessions (key),
    after_seq       BIGINT NOT NULL,
    created_unix_ms BIGINT NOT NULL,
    PRIMARY KEY (session, after_seq)
);
