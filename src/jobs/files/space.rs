//! The space that the files of jobs take: it is counted, taken and given back, and files that no
//! job names are removed.

use std::fs;
use std::io;
use std::sync::atomic::Ordering;
use std::time::Duration;

use crate::jobs::JobError;
use crate::jobs::bucket::Listed;
use crate::jobs::named::Named;

use super::{CHECKPOINTS, FOLDERS, INPUTS, JobFiles, RESULTS, local};

/// Age from which a file that arrives is removed. A file is written more often than this.
const ARRIVES_FOR: Duration = Duration::from_secs(3600);
/// Age from which a file that no job names is removed. A job may be stored shortly after its files.
const UNNAMED_FOR: Duration = Duration::from_secs(600);
/// The folders whose files are in a bucket, if there is one.
const IN_BUCKET: [&str; 3] = [INPUTS, RESULTS, CHECKPOINTS];
/// Ages from which files that no job names are removed, by folder.
pub(super) type Ages = [Duration; FOLDERS.len()];
pub(super) const AGES: Ages = [ARRIVES_FOR, UNNAMED_FOR, UNNAMED_FOR, UNNAMED_FOR];
/// The age in a bucket, whose clock and that of a client may differ by a quarter of an hour.
const UNNAMED_IN_BUCKET_FOR: Duration = Duration::from_secs(1800);

impl JobFiles {
    /// Counts the bytes of all files. Files written meanwhile are counted the next time.
    ///
    /// # Errors
    /// The folder or the bucket cannot be read.
    pub(in crate::jobs) async fn count(&self) -> Result<(), JobError> {
        let before = self.used.load(Ordering::Acquire);
        let mut bytes = self.counted_in_folder().map_err(JobError::disk("counting files"))?;
        if let Some(bucket) = &self.bucket {
            bytes += self.writing.load(Ordering::Acquire);
            for inside in IN_BUCKET {
                let mut token = None;
                loop {
                    let (page, next) = bucket.page(&format!("{inside}/"), token).await?;
                    bytes += page.iter().map(|object| object.bytes).sum::<u64>();
                    token = next;
                    if token.is_none() {
                        break;
                    }
                }
            }
        }
        let recounted = |used: u64| Some((used + bytes).saturating_sub(before));
        self.used.fetch_update(Ordering::AcqRel, Ordering::Acquire, recounted).ok();
        Ok(())
    }

    fn counted_in_folder(&self) -> io::Result<u64> {
        let mut bytes = 0;
        for inside in local(self.bucket.as_deref()) {
            for entry in fs::read_dir(self.folder.join(inside))? {
                // Err: the file was removed meanwhile.
                bytes += entry?.metadata().map_or(0, |metadata| metadata.len());
            }
        }
        Ok(bytes)
    }

    /// Takes `bytes` of the space of all files.
    ///
    /// # Errors
    /// Fewer bytes are left.
    pub(in crate::jobs) fn reserve(&self, bytes: u64) -> Result<(), JobError> {
        let limit = self.limits.total_bytes;
        let add = |used: u64| used.checked_add(bytes).filter(|used| *used <= limit);
        let added = self.used.fetch_update(Ordering::AcqRel, Ordering::Acquire, add);
        added.map(drop).map_err(|_| JobError::SpaceExhausted { limit })
    }

    /// Gives `bytes` of the space back.
    pub(in crate::jobs) fn release(&self, bytes: u64) {
        let released = |used: u64| Some(used.saturating_sub(bytes));
        self.used.fetch_update(Ordering::AcqRel, Ordering::Acquire, released).ok();
    }

    /// Removes files that no job names once they are old.
    ///
    /// # Errors
    /// The folder or the bucket cannot be read.
    pub(in crate::jobs) async fn remove_old(&self, named: &Named) -> Result<(), JobError> {
        self.remove_unnamed(named, AGES).await
    }

    /// Removes files that no job names and that have at least these ages, by folder.
    pub(super) async fn remove_unnamed(&self, named: &Named, ages: Ages) -> Result<(), JobError> {
        let removed = self.remove_from_folder(named, ages);
        removed.map_err(JobError::disk("removing files of expired jobs"))?;
        let Some(bucket) = &self.bucket else { return Ok(()) };
        for inside in IN_BUCKET {
            let (begin, mut token) = (format!("{inside}/"), None);
            loop {
                let (page, next) = bucket.page(&begin, token).await?;
                for Listed { name, bytes, age } in page {
                    let file = name.strip_prefix(&begin).unwrap_or_default();
                    let is_held = self.held().contains_key(file);
                    if UNNAMED_IN_BUCKET_FOR <= age && !named.has(file) && !is_held {
                        bucket.delete(&name).await?;
                        self.release(bytes);
                    }
                }
                token = next;
                if token.is_none() {
                    break;
                }
            }
        }
        Ok(())
    }

    /// The part of [`Self::remove_unnamed`] in the folder.
    fn remove_from_folder(&self, named: &Named, ages: Ages) -> io::Result<()> {
        for (inside, age) in local(self.bucket.as_deref()).iter().zip(ages) {
            for entry in fs::read_dir(self.folder.join(inside))? {
                let entry = entry?;
                let name = entry.file_name().to_string_lossy().into_owned();
                // Err: another process has removed it.
                let Ok(metadata) = entry.metadata() else { continue };
                let is_old =
                    age.is_zero() || metadata.modified()?.elapsed().is_ok_and(|since| age <= since);
                let held = self.held();
                if is_old && !named.has(&name) && !held.contains_key(&name) {
                    match fs::remove_file(entry.path()) {
                        Ok(()) => self.release(metadata.len()),
                        // Another process has removed it first.
                        Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                        Err(error) => return Err(error),
                    }
                }
            }
        }
        Ok(())
    }
}
