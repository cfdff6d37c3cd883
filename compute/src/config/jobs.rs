//! Options of batch jobs: where their files are, and their limits.

use std::path::PathBuf;

use serde::Deserialize;

use super::s3::S3Configuration;

/// Options of batch jobs.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct JobsConfiguration {
    /// Folder of the uploaded files and of the results. If absent, `DATABASE.jobs` beside a SQLite
    /// database; a service on Postgres then takes no jobs. The nodes of a cluster need the same.
    pub folder: Option<PathBuf>,
    /// Bucket in which the files are, in place of the folder. The folder then has only what is on
    /// its way; each process may have its own.
    pub s3: Option<S3Configuration>,
    /// Bytes of one uploaded file.
    pub file_bytes: u64,
    /// Bytes of one uploaded file after unpacking.
    pub unpacked_bytes: u64,
    /// Bytes of all files in the folder together.
    pub total_bytes: u64,
    /// Files in one upload.
    pub files: usize,
    /// Jobs that wait or run.
    pub waiting: usize,
    /// Jobs that this process runs at the same time; 0 leaves them to workers.
    pub running: usize,
    /// Time without heartbeat after which a job is given to another process (s).
    pub silent_s: u64,
    /// Uploads at the same time.
    pub uploads: usize,
    /// Uploads of several requests that a tenant may have, until they expire.
    pub open_uploads: usize,
    /// Time for which such an upload is kept (hours).
    pub upload_hours: u32,
    /// Time that one job may run (s).
    pub run_s: u64,
    /// Time of a run between two checkpoints (s). A run that is cut off goes on after the last one.
    pub checkpoint_s: u64,
    /// Time for which a job that has ended is kept, with its files (hours).
    pub keep_hours: u32,
    /// Time in which one input that is a URL must arrive (s).
    pub fetch_s: u64,
    /// Attempts to tell a webhook of the end of a job.
    pub webhook_attempts: u32,
    /// First delay between two attempts (s). Each further one is twice as long, up to an hour.
    pub webhook_delay_s: u64,
    /// Time after the end of a job for which attempts are made (hours).
    pub webhook_hours: u32,
}

impl JobsConfiguration {
    /// Limits for one small machine.
    pub const fn standard() -> Self {
        Self {
            folder: None,
            s3: None,
            file_bytes: 1 << 30,
            unpacked_bytes: 4 << 30,
            total_bytes: 16 << 30,
            files: 16,
            waiting: 256,
            running: 1,
            silent_s: 15,
            uploads: 8,
            open_uploads: 64,
            upload_hours: 24,
            run_s: 3600,
            checkpoint_s: 10,
            keep_hours: 168,
            fetch_s: 1800,
            webhook_attempts: 12,
            webhook_delay_s: 10,
            webhook_hours: 24,
        }
    }

    /// The name of a limit that is zero and would refuse everything.
    pub(crate) fn zero(&self) -> Option<&'static str> {
        let limits = [
            ("file_bytes", self.file_bytes),
            ("unpacked_bytes", self.unpacked_bytes),
            ("total_bytes", self.total_bytes),
            ("files", self.files as u64),
            ("waiting", self.waiting as u64),
            ("silent_s", self.silent_s),
            ("uploads", self.uploads as u64),
            ("open_uploads", self.open_uploads as u64),
            ("upload_hours", u64::from(self.upload_hours)),
            ("run_s", self.run_s),
            ("checkpoint_s", self.checkpoint_s),
            ("keep_hours", u64::from(self.keep_hours)),
            ("fetch_s", self.fetch_s),
            ("webhook_attempts", u64::from(self.webhook_attempts)),
            ("webhook_delay_s", self.webhook_delay_s),
            ("webhook_hours", u64::from(self.webhook_hours)),
        ];
        limits.into_iter().find(|(_, value)| *value == 0).map(|(name, _)| name)
    }
}

// `serde(default)` asks for `Default`. Nothing else uses it.
impl Default for JobsConfiguration {
    fn default() -> Self {
        Self::standard()
    }
}
