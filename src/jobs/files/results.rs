//! The results of jobs while they are written: in the folder under their name, or with a bucket in
//! a file without a name until they are whole.

use std::fs::{self, File};
use std::io;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use crate::jobs::JobError;
use crate::jobs::bucket::Patience;
use crate::jobs::named::{figures_name, result_name};

use super::{JobFiles, RESULTS, sync};

/// Most lost claims before one whose results are removed at once. Older ones expire.
const LOST_RESULTS: i64 = 16;

impl JobFiles {
    /// Begins a result.
    ///
    /// # Errors
    /// The disk fails.
    pub(in crate::jobs) fn begin_result(&self, name: &str) -> io::Result<File> {
        match &self.bucket {
            Some(_) => self.nameless(),
            None => File::create_new(self.result(name)),
        }
    }

    /// Takes `bytes` more of the space of all files for a result that is written.
    ///
    /// # Errors
    /// It has fewer left.
    pub(in crate::jobs) fn reserve_for_result(&self, bytes: u64) -> Result<(), JobError> {
        self.reserve(bytes)?;
        self.writing.fetch_add(bytes, Ordering::AcqRel);
        Ok(())
    }

    /// Makes a result of this size durable.
    ///
    /// # Errors
    /// The disk or the bucket fails.
    pub(in crate::jobs) async fn finish_result(
        &self,
        name: &str,
        (file, bytes): (File, u64),
    ) -> Result<(), JobError> {
        if let Some(bucket) = &self.bucket {
            let (name, file) = (format!("{RESULTS}/{name}"), (Arc::new(file), bytes));
            return Ok(bucket.put(&name, file, Patience::Run).await?);
        }
        let stored = file.sync_all().and_then(|()| sync(&self.folder.join(RESULTS)));
        stored.map_err(JobError::disk("writing the result"))
    }

    /// No more of a result is written. What is in the folder is removed unless it is done.
    pub(in crate::jobs) fn end_result(&self, name: &str, bytes: u64, is_done: bool) {
        let less = |writing: u64| Some(writing.saturating_sub(bytes));
        self.writing.fetch_update(Ordering::AcqRel, Ordering::Acquire, less).ok();
        if !is_done {
            if self.bucket.is_none() {
                // Err: it was not written.
                fs::remove_file(self.result(name)).ok();
            }
            self.release(bytes);
        }
    }

    /// Removes what lost claims of a job have written to the folder before this one. In a bucket it
    /// is removed once it is old.
    pub(in crate::jobs) fn remove_results_of_lost_claims(&self, job: &str, fence: i64) {
        if self.bucket.is_some() {
            return;
        }
        for lost in (fence - LOST_RESULTS).max(1)..fence {
            let name = result_name(job, lost);
            self.remove_from_results(&name);
            self.remove_from_results(&figures_name(&name));
        }
    }
}
