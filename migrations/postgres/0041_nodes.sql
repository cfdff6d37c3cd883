-- The nodes of a cluster. A node is alive while it has a row: it renews its lease, and another node
-- removes the row once the lease has ended by the clock of this server. No fence comes again.
CREATE TABLE nodes (
    fence      BIGINT PRIMARY KEY,
    name       TEXT NOT NULL UNIQUE,
    address    TEXT NOT NULL, -- where the other nodes reach it
    secret     TEXT NOT NULL, -- shows the others that a request comes from it
    process    INTEGER NOT NULL, -- of the committer's connection
    expires_at TIMESTAMPTZ NOT NULL
);
-- The node that leads: its fence, in one row.
CREATE TABLE leader (
    fence BIGINT NOT NULL
);
INSERT INTO leader (fence) VALUES (0);
