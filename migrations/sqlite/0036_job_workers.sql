-- Jobs are claimed by services and workers. `cpu_ms` is the processor time of the present or last claim,
-- `lost_claims` how often a claimant has vanished without ending or returning the job.
ALTER TABLE jobs ADD COLUMN cpu_ms INTEGER NOT NULL DEFAULT 0;
ALTER TABLE jobs ADD COLUMN lost_claims INTEGER NOT NULL DEFAULT 0;

-- The tenants with jobs that wait or run, and the processor time that these have used while others had jobs,
-- too: a tenant that comes begins with the least of those that are there.
CREATE TABLE job_turns (
    tenant  TEXT   PRIMARY KEY,
    used_ms INTEGER NOT NULL
);

-- Identifies the folder with the files of jobs; one row.
CREATE TABLE job_folder (
    one  INTEGER PRIMARY KEY CHECK (one = 1),
    id   TEXT   NOT NULL
);
