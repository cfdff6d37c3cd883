-- Bytes of the files of jobs that each tenant may have; NULL for no limit.
ALTER TABLE tenants ADD COLUMN job_bytes INTEGER;
