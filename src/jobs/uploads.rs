//! Uploads that continue after an interruption: a file that arrives in several requests.
//!
//! Its bytes are appended to one file, whose length is the number of bytes that have arrived. So no
//! byte is sent again. When the last byte has arrived, the file is stored under the hash of its
//! content, like every input. Jobs then name it by the upload's id until the upload expires.

use std::fs::OpenOptions;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;

use rustix::fs::{FlockOperation, flock};
use tokio::fs::File;
use tokio::io::AsyncWriteExt;
use tokio::task::spawn_blocking;

use crate::id::{Id, Kind};
use crate::store::JobUploadRow;

use super::files::{JobFiles, StoredFile};
use super::state::Desk;
use super::{JobError, Jobs};

const MS_PER_HOUR: i64 = 3_600_000;

/// Marks an [`Id`] as an upload's.
#[derive(Debug)]
pub struct OfUpload;

impl Kind for OfUpload {
    const PREFIX: &str = "upl_";
}

/// The id of an upload, `upl_` and 32 hexadecimal digits.
pub type UploadId = Id<OfUpload>;

/// An upload.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UploadInfo {
    /// Its id.
    pub id: UploadId,
    /// Name of the file on the user's side.
    pub name: String,
    /// Size of the whole file (bytes).
    pub length: u64,
    /// Bytes that are stored.
    pub offset: u64,
    /// Hash of the content, once it is complete: BLAKE3, hexadecimal.
    pub hash: Option<String>,
    /// When it is removed (ms since 1970-01-01 UTC).
    pub expires_unix_ms: i64,
}

/// A request that appends bytes to an upload. No other request appends to it meanwhile.
pub struct Appending {
    desk: Arc<Desk>,
    upload: UploadInfo,
    /// Offset of the upload before this request.
    begun: u64,
    /// The file, locked until it is closed; `None` if the upload is complete, because its file has
    /// been moved.
    file: Option<File>,
}

impl Jobs {
    /// Begins an upload of a file of this size.
    ///
    /// # Errors
    /// The service takes no jobs, the file is too large, the tenant's limit of uploads is
    /// reached, its quota of bytes has no room for this one, or the store fails.
    pub async fn begin_upload(&self, name: &str, length: u64) -> Result<UploadInfo, JobError> {
        let (desk, limits) = (&self.desk, &self.desk.limits);
        let files = desk.files()?;
        if desk.is_stopping() {
            return Err(JobError::Draining);
        }
        let limit = limits.file_bytes;
        if limit < length {
            return Err(JobError::FileTooLarge { limit });
        }
        desk.allowance(&self.tenant).await?.take(length)?;
        let kept_ms = i64::from(limits.upload_hours) * MS_PER_HOUR;
        let row = JobUploadRow {
            id: UploadId::random().to_string(),
            name: name.to_owned(),
            bytes: i64::try_from(length).unwrap_or(i64::MAX),
            hash: None,
            expires_unix_ms: self.unix_ms() + kept_ms,
        };
        let limit = limits.open_uploads;
        if !desk.store.create_upload(&self.tenant, &row, limit).await? {
            return Err(JobError::TooManyUploads { limit });
        }
        info(files, row).await
    }

    /// An upload.
    ///
    /// # Errors
    /// The tenant has no upload with this id, or the store or the disk fails.
    pub async fn upload_info(&self, id: &UploadId) -> Result<UploadInfo, JobError> {
        let unknown = || JobError::UploadNotFound { id: id.to_string() };
        let row = self.desk.store.upload(&self.tenant, id.as_str()).await?;
        let row = row.filter(|row| self.unix_ms() < row.expires_unix_ms);
        info(self.desk.files()?, row.ok_or_else(unknown)?).await
    }

    /// Begins to append bytes to an upload, from this offset on.
    ///
    /// # Errors
    /// The offset is not that of the upload, another request appends to it, the tenant has no such
    /// upload, or the store or the disk fails.
    pub async fn append_upload(&self, id: &UploadId, offset: u64) -> Result<Appending, JobError> {
        let files = self.desk.files()?;
        let upload = self.upload_info(id).await?;
        let (stored, file) = match upload.hash {
            Some(_) => (upload.length, None),
            None => {
                let opened = opened(files.arriving(id.as_str())).await?;
                opened.ok_or_else(|| JobError::UploadBusy { id: id.to_string() })?
            }
        };
        if stored != offset {
            return Err(JobError::UploadOffset { offset: stored });
        }
        let upload = UploadInfo { offset, ..upload };
        Ok(Appending { desk: self.desk.clone(), upload, begun: offset, file })
    }

    /// Removes an upload. Jobs that name its file keep it.
    ///
    /// # Errors
    /// The tenant has no upload with this id, or the store fails.
    pub async fn remove_upload(&self, id: &UploadId) -> Result<(), JobError> {
        let files = self.desk.files()?;
        if !self.desk.store.delete_upload(&self.tenant, id.as_str()).await? {
            return Err(JobError::UploadNotFound { id: id.to_string() });
        }
        files.remove_arriving(id.as_str());
        Ok(())
    }

    /// The file of a complete upload, and its name on the user's side.
    ///
    /// # Errors
    /// Bytes are missing, the tenant has no such upload, or the store fails.
    pub async fn uploaded(&self, id: &UploadId) -> Result<(String, StoredFile), JobError> {
        let mut upload = self.upload_info(id).await?;
        if upload.hash.is_none() && upload.offset == upload.length {
            // All its bytes have arrived, but it could not be stored then.
            upload = self.append_upload(id, upload.length).await?.finish().await?;
        }
        let UploadInfo { name, length, offset, hash, .. } = upload;
        let incomplete = || JobError::UploadIncomplete { id: id.to_string(), offset, length };
        let hash = hash.ok_or_else(incomplete)?;
        Ok((name, self.desk.files()?.hold(hash, length)))
    }
}

/// An upload with its offset.
async fn info(files: &Arc<JobFiles>, row: JobUploadRow) -> Result<UploadInfo, JobError> {
    let id = UploadId::parse(&row.id).ok_or_else(|| JobError::UploadNotFound { id: row.id })?;
    let length = row.bytes.unsigned_abs();
    let offset = match row.hash {
        Some(_) => length,
        None => arrived(files.arriving(id.as_str())).await,
    };
    let (name, hash, expires_unix_ms) = (row.name, row.hash, row.expires_unix_ms);
    Ok(UploadInfo { id, name, length, offset, hash, expires_unix_ms })
}

/// The file of an upload that is not complete, locked, and its length; `None` if another request
/// has the lock.
async fn opened(path: PathBuf) -> Result<Option<(u64, Option<File>)>, JobError> {
    let opening = spawn_blocking(move || {
        let mut options = OpenOptions::new();
        let file = options.append(true).create(true).open(path)?;
        match flock(&file, FlockOperation::NonBlockingLockExclusive) {
            Ok(()) => Ok(Some((file.metadata()?.len(), Some(File::from_std(file))))),
            Err(_) => Ok(None),
        }
    });
    let opened = opening.await.unwrap_or_else(|error| Err(io::Error::other(error)));
    opened.map_err(JobError::disk("opening the file of an upload"))
}

/// Number of bytes of a file that have arrived. The file is opened, because a shared file system
/// then reads what other nodes have written.
async fn arrived(path: PathBuf) -> u64 {
    let length = async { File::open(path).await?.metadata().await.map(|metadata| metadata.len()) };
    // Err: nothing has arrived.
    length.await.unwrap_or(0)
}

impl Appending {
    /// Appends bytes.
    ///
    /// # Errors
    /// They exceed the size of the file, all files exceed their limit, or the disk fails.
    pub async fn write(&mut self, bytes: &[u8]) -> Result<(), JobError> {
        let (more, length) = (bytes.len() as u64, self.upload.length);
        if length < self.upload.offset + more {
            self.take_back().await?;
            return Err(JobError::UploadTooLong { length });
        }
        // A complete upload takes no byte.
        let Some(file) = &mut self.file else { return Ok(()) };
        self.desk.files()?.reserve(more)?;
        file.write_all(bytes).await.map_err(failed)?;
        self.upload.offset += more;
        Ok(())
    }

    /// Removes the bytes that this request has appended. It has sent more bytes than the file still
    /// needs, so they may belong to another file or to another offset.
    async fn take_back(&mut self) -> Result<(), JobError> {
        let Some(file) = &mut self.file else { return Ok(()) };
        file.flush().await.map_err(failed)?;
        file.set_len(self.begun).await.map_err(failed)?;
        self.desk.files()?.release(self.upload.offset - self.begun);
        self.upload.offset = self.begun;
        Ok(())
    }

    /// Makes the bytes that have arrived durable, also after an interruption. If the file is
    /// complete, it is stored under its hash.
    ///
    /// # Errors
    /// The disk or the store fails.
    pub async fn finish(mut self) -> Result<UploadInfo, JobError> {
        let Some(file) = &mut self.file else { return Ok(self.upload) };
        file.flush().await.map_err(failed)?;
        file.sync_all().await.map_err(failed)?;
        if self.upload.offset == self.upload.length {
            let files = self.desk.files()?;
            let path = files.arriving(self.upload.id.as_str());
            let (arrived, hashed) = (path.clone(), path.clone());
            let hashing = spawn_blocking(move || {
                let mut hasher = blake3::Hasher::new();
                hasher.update_reader(std::fs::File::open(hashed)?)?;
                Ok(hasher.finalize().to_hex().to_string())
            });
            let hash = hashing.await.unwrap_or_else(|error| Err(io::Error::other(error)));
            let hash = hash.map_err(failed)?;
            let (stored, is_new) = files.store(path, hash, self.upload.length).await?;
            if !is_new {
                files.release(self.upload.length); // Equal files are one.
            }
            self.desk.store.complete_upload(self.upload.id.as_str(), &stored.hash).await?;
            // Only now: until then the bytes that have arrived are those of this file. Err: it is
            // removed as an old one.
            tokio::fs::remove_file(arrived).await.ok();
            self.upload.hash = Some(stored.hash.clone());
        }
        Ok(self.upload)
    }
}

fn failed(error: io::Error) -> JobError {
    JobError::disk("writing the file of an upload")(error)
}
