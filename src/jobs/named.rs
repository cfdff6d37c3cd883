//! The files in the folder that jobs name, according to the store.

use std::collections::{HashMap, HashSet};

use crate::store::Store;

use super::JobError;
use super::request::JobRequest;

/// End of the name of a result's figures.
const FIGURES: &str = "-figures";

/// The files in the folder that jobs name.
#[derive(Debug, Default)]
pub(super) struct Named {
    files: HashSet<String>,
    /// The number of the last claim of each job that has not ended.
    fences: HashMap<String, i64>,
}

impl Named {
    /// Reads the names.
    ///
    /// # Errors
    /// The store fails.
    pub(super) async fn read(store: &Store) -> Result<Self, JobError> {
        let mut named = Self::default();
        for row in store.job_files().await? {
            named.files.extend(row.result);
            // A request that cannot be read is reported when its job is read.
            let request: Option<JobRequest> = serde_json::from_str(&row.request).ok();
            named
                .files
                .extend(request.into_iter().flat_map(|request| request.inputs).map(|i| i.hash));
            if !row.is_ended {
                named.fences.insert(row.id, row.fence);
            }
        }
        for (upload, hash) in store.upload_files().await? {
            named.files.insert(upload);
            named.files.extend(hash);
        }
        Ok(named)
    }

    /// These files, and the numbers of the last claims of jobs that have not ended.
    #[cfg(test)]
    pub(super) fn of<const N: usize, const M: usize>(
        files: [String; N],
        fences: [(String, i64); M],
    ) -> Self {
        Self { files: files.into(), fences: fences.into() }
    }

    /// Whether the file belongs to a stored job: a job names it; or it is a result that the last
    /// claim, or a later one, of a job writes; or it is a checkpoint of a job that has not ended.
    /// Figures belong to the same job as their result.
    pub(super) fn has(&self, file: &str) -> bool {
        let file = file.strip_suffix(FIGURES).unwrap_or(file);
        let writes = || {
            let (job, fence) = file.rsplit_once('.')?;
            Some(*self.fences.get(job)? <= fence.parse().ok()?)
        };
        let has_job = |(job, _): (&str, &str)| self.fences.contains_key(job);
        let continues = || file.rsplit_once('-').is_some_and(has_job);
        self.files.contains(file) || writes().unwrap_or(false) || continues()
    }
}

/// Name of the file of a result that a claim writes.
pub(super) fn result_name(job: &str, fence: i64) -> String {
    format!("{job}.{fence}")
}

/// Name of the file of a result's figures.
pub(super) fn figures_name(result: &str) -> String {
    format!("{result}{FIGURES}")
}

/// Name of a part of a job's checkpoints.
pub(super) fn checkpoint_name(job: &str, part: u64) -> String {
    format!("{job}-{part}")
}
