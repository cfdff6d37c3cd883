-- A row that the committer changes to see whether it can commit.
CREATE TABLE committer (
    probes BIGINT NOT NULL
);
INSERT INTO committer (probes) VALUES (0);
