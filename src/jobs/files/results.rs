//! The results of jobs while they are written: in the folder under their name. With a bucket they
//! are in a file without a name until they are complete.

use std::fs::{self, File};
use std::io;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use crate::jobs::JobError;
use crate::jobs::bucket::Patience;
use crate::jobs::named::{figures_name, result_name};

use super::{JobFiles, RESULTS, sync};

/// Number of lost claims before a claim whose results are removed at once. Older ones expire.
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

    /// Ends the writing of a result. Its file in the folder is removed unless the result is
    /// complete.
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

    /// Removes the results in the folder that earlier, lost claims of a job have written. In a
    /// bucket they are removed once they are old.
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
