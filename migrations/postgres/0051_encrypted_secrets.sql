-- Secrets may be encrypted with a key of the operator's, whose id stands beside each; NULL if the
-- secret is as it is sent.
ALTER TABLE base_feeds ADD COLUMN password_key TEXT;
ALTER TABLE jobs ADD COLUMN webhook_secret_key TEXT;
