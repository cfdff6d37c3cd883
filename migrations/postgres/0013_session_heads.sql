-- The newest service that had the lease: a commit of an older one is refused.
ALTER TABLE committer ADD COLUMN fence BIGINT NOT NULL DEFAULT 0;

-- One row per session, which each commit compares and sets: what was committed last, and by whom.
CREATE TABLE session_heads (
    session          BIGINT PRIMARY KEY REFERENCES sessions (key),
    owner            TEXT NOT NULL, -- node
    fence            BIGINT NOT NULL, -- of the lease of that node
    last_seq         BIGINT,
    last_gps_time_ns BIGINT,
    raw_through      BIGINT,
    status           SMALLINT, -- of the last epoch
    x_m              DOUBLE PRECISION, -- the latest position, ECEF
    y_m              DOUBLE PRECISION,
    z_m              DOUBLE PRECISION,
    closed_unix_ms   BIGINT
);
INSERT INTO session_heads (session, owner, fence, last_seq, last_gps_time_ns, raw_through, status,
                           x_m, y_m, z_m, closed_unix_ms)
SELECT s.key, '', 0, l.seq, l.gps_time_ns, r.through, l.status, p.x_m, p.y_m, p.z_m,
       s.closed_unix_ms
FROM sessions s
LEFT JOIN raw_streams r ON r.session = s.key
LEFT JOIN solutions l ON l.session = s.key AND l.revision = 0
    AND l.seq = (SELECT MAX(seq) FROM epochs e WHERE e.session = s.key)
LEFT JOIN solutions p ON p.session = s.key AND p.revision = 0
    AND p.seq = (SELECT MAX(seq) FROM solutions q
                 WHERE q.session = s.key AND q.revision = 0 AND q.x_m IS NOT NULL);
