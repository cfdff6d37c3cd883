//! Files that arrive, until they are stored under the hash of their content.
//!
//! A file that does not become an input leaves nothing: no file, and no bytes in the space of all
//! files or in the quota of the tenant.

use std::fs;
use std::path::PathBuf;
use std::sync::Arc;

use tokio::fs::File;
use tokio::io::AsyncWriteExt;
use uuid::Uuid;

use crate::tenant::Tenant;

use super::JobError;
use super::allowance::Allowance;
use super::files::{JobFiles, StoredFile};
use super::permits::Permit;

/// Files that arrive together. A file that does not become part of a job leaves nothing.
pub struct Upload {
    files: Arc<JobFiles>,
    allowance: Arc<Allowance>,
    begun: usize,
    /// The right to upload; `None` if the service fetches the files itself.
    _permit: Option<Permit>,
}

/// A file that arrives.
pub struct ArrivingFile {
    files: Arc<JobFiles>,
    file: File,
    hasher: blake3::Hasher,
    leftover: Leftover,
}

/// A file and its bytes in the space of all files and in the tenant's quota. On drop, the file is
/// removed and the bytes are given back.
struct Leftover {
    files: Arc<JobFiles>,
    allowance: Arc<Allowance>,
    path: PathBuf,
    bytes: u64,
    /// Bytes of the tenant's quota.
    taken: u64,
}

impl Upload {
    /// Begins an upload of a tenant to a folder.
    ///
    /// # Errors
    /// As many uploads arrive as allowed, in all or of the tenant.
    pub(super) fn begin_at(
        files: &Arc<JobFiles>,
        tenant: &Tenant,
        allowance: Allowance,
    ) -> Result<Self, JobError> {
        let permit = Some(files.permit(tenant)?);
        Ok(Self { _permit: permit, ..Self::fetch_to(files, allowance) })
    }

    /// Begins to fetch files to a folder. It does not count as an upload.
    pub(super) fn fetch_to(files: &Arc<JobFiles>, allowance: Allowance) -> Self {
        Self { files: files.clone(), allowance: Arc::new(allowance), begun: 0, _permit: None }
    }

    /// Begins a file.
    ///
    /// # Errors
    /// The upload has as many as allowed, or the disk fails.
    pub async fn begin(&mut self) -> Result<ArrivingFile, JobError> {
        self.count()?;
        self.begin_again().await
    }

    /// Counts a file.
    ///
    /// # Errors
    /// The upload has as many as allowed.
    pub fn count(&mut self) -> Result<(), JobError> {
        let limit = self.files.limits().files;
        if limit <= self.begun {
            return Err(JobError::TooManyFiles { limit });
        }
        self.begun += 1;
        Ok(())
    }

    /// Begins a file that is already counted, for another attempt.
    ///
    /// # Errors
    /// The disk fails.
    pub(super) async fn begin_again(&mut self) -> Result<ArrivingFile, JobError> {
        let path = self.files.arriving(&Uuid::new_v4().simple().to_string());
        let file = File::create_new(&path).await;
        let file = file.map_err(JobError::disk("creating the file of an upload"))?;
        let (files, allowance) = (self.files.clone(), self.allowance.clone());
        let leftover = Leftover { files, allowance, path, bytes: 0, taken: 0 };
        Ok(ArrivingFile {
            files: self.files.clone(),
            file,
            hasher: blake3::Hasher::new(),
            leftover,
        })
    }
}

impl ArrivingFile {
    /// Appends bytes.
    ///
    /// # Errors
    /// The file, those of the tenant or all files together exceed their limit, or the disk fails.
    pub async fn write(&mut self, bytes: &[u8]) -> Result<(), JobError> {
        let (more, limit) = (bytes.len() as u64, self.files.limits().file_bytes);
        if limit < self.leftover.bytes + more {
            return Err(JobError::FileTooLarge { limit });
        }
        self.leftover.allowance.take(more)?;
        self.leftover.taken += more;
        self.files.reserve(more)?;
        self.leftover.bytes += more;
        self.hasher.update(bytes);
        let written = self.file.write_all(bytes).await;
        written.map_err(JobError::disk("writing the file of an upload"))
    }

    /// Stores the file under its hash. It is on the disk when this returns.
    ///
    /// # Errors
    /// The disk fails.
    pub async fn finish(mut self) -> Result<StoredFile, JobError> {
        let failed = JobError::disk;
        self.file.flush().await.map_err(failed("writing the file of an upload"))?;
        self.file.sync_all().await.map_err(failed("writing the file of an upload"))?;
        let hash = self.hasher.finalize().to_hex().to_string();
        let (path, bytes) = (self.leftover.path.clone(), self.leftover.bytes);
        let (stored, is_new) = self.files.store(path, hash, bytes).await?;
        self.leftover.taken = 0; // A job is to name it, whether or not it has the bytes alone.
        if is_new {
            self.leftover.bytes = 0; // It stays.
        }
        Ok(stored)
    }
}

impl Drop for Leftover {
    fn drop(&mut self) {
        // If it is stored, it has the name of its hash, too. Err: there is nothing to remove.
        fs::remove_file(&self.path).ok();
        self.files.release(self.bytes);
        self.allowance.give_back(self.taken);
    }
}
