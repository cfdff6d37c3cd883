-- A job may have a webhook: a URL, in `request`, that is told of its end. `webhook_due_unix_ms` is when
-- it is tried next, once the job has ended; NULL if no attempt follows.
ALTER TABLE jobs ADD COLUMN webhook_secret TEXT; -- signs the messages; nothing shows it
ALTER TABLE jobs ADD COLUMN webhook_state TEXT; -- WAITING, DELIVERED, FAILED; NULL without a webhook
ALTER TABLE jobs ADD COLUMN webhook_attempts BIGINT NOT NULL DEFAULT 0;
ALTER TABLE jobs ADD COLUMN webhook_due_unix_ms BIGINT;
CREATE INDEX due_webhooks ON jobs (webhook_due_unix_ms) WHERE webhook_due_unix_ms IS NOT NULL;

-- One row for each attempt, written before it is made.
CREATE TABLE job_deliveries (
    job           BIGINT  NOT NULL REFERENCES jobs (key) ON DELETE CASCADE,
    number        BIGINT  NOT NULL, -- from 1
    begun_unix_ms BIGINT  NOT NULL,
    ended_unix_ms BIGINT, -- NULL while it is made, and if the service stopped meanwhile
    http_status   BIGINT, -- of the answer, if there was one
    code          TEXT, -- why it has failed; NULL if it has not
    message       TEXT,
    PRIMARY KEY (job, number)
);

-- An input may be a URL. Such a job waits until the service has fetched it.
ALTER TABLE jobs ADD COLUMN unfetched BIGINT NOT NULL DEFAULT 0; -- 1 while inputs are to be fetched
CREATE INDEX unfetched_jobs ON jobs (key) WHERE unfetched = 1;
