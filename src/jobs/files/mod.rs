//! The files of jobs: inputs, named after the hash of their content, and results.
//!
//! They are in the folder of jobs, or in a bucket under the same names.
//!
//! The folder has four folders: `incoming` for uploads that arrive, `inputs`, `results`, and
//! `checkpoints` of runs. The store contains the names of `inputs` and `results`. A name in
//! `checkpoints` begins with the id of a job. A file that belongs to no stored job is removed once
//! it is old, and at the start of a service that is alone. Other processes may write there, so the
//! bytes of all files are counted again at an interval. The file `folder.id` identifies the folder.
//! Each node of a cluster has a file there (`shared`).
//!
//! With a bucket the folder has only files in transit, so each process may have its own folder. It
//! has arriving uploads in `incoming`. Inputs that a run reads and results that it writes are files
//! without a name, of which nothing is left when the process ends.

mod results;
mod space;

use std::collections::HashMap;
use std::fs::{self, File};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::task::spawn_blocking;
use uuid::Uuid;

use crate::config::JobsConfiguration;
use crate::store::disk_free_bytes;
use crate::tenant::Tenant;

use super::JobError;
use super::bucket::{Bucket, BucketError, Patience};
use super::named::Named;
use super::permits::{Permit, Permits};

use space::AGES;

const INCOMING: &str = "incoming";
pub(super) const INPUTS: &str = "inputs";
pub(super) const RESULTS: &str = "results";
pub(super) const CHECKPOINTS: &str = "checkpoints";
const FOLDER_ID: &str = "folder.id";
const FOLDERS: [&str; 4] = [INCOMING, INPUTS, RESULTS, CHECKPOINTS];

/// The files of jobs.
pub(super) struct JobFiles {
    folder: PathBuf,
    bucket: Option<Arc<Bucket>>,
    id: String,
    limits: JobsConfiguration,
    /// Bytes of all files.
    used: AtomicU64,
    /// Bytes of results that are being written and are not in the folder or bucket yet.
    writing: AtomicU64,
    /// Number of uploads, not yet jobs, that need each input.
    held: Mutex<HashMap<String, usize>>,
    uploads: Permits,
}

/// An uploaded file that is stored. It is kept while this value exists, or a job names it.
pub struct StoredFile {
    files: Arc<JobFiles>,
    /// Hash of its bytes, BLAKE3, hexadecimal.
    pub hash: String,
    /// Its size (bytes).
    pub bytes: u64,
}

impl JobFiles {
    /// Opens the folder of a service, which is created if absent, and its bucket, if it has one.
    /// Files that no job names are removed: all of them if the service is alone, otherwise the old
    /// ones.
    ///
    /// # Errors
    /// The folder or the bucket cannot be read or written.
    pub(super) async fn open(
        folder: PathBuf,
        limits: JobsConfiguration,
        named: &Named,
        is_alone: bool,
    ) -> Result<Self, JobError> {
        let bucket = Self::bucket_of(&limits)?;
        let made = local(bucket.as_deref())
            .iter()
            .try_for_each(|inside| fs::create_dir_all(folder.join(inside)));
        made.map_err(JobError::disk("opening the folder of jobs"))?;
        let id = match &bucket {
            Some(bucket) => identified_in(bucket).await?,
            None => identified(&folder).map_err(JobError::disk("opening the folder of jobs"))?,
        };
        let files = Self::of(folder, bucket, id, limits).await?;
        let ages = if is_alone { [Duration::ZERO; FOLDERS.len()] } else { AGES };
        files.remove_unnamed(named, ages).await?;
        Ok(files)
    }

    /// The files of a service for another process. Its folder or bucket must have this identity.
    ///
    /// # Errors
    /// The identity differs, or it cannot be read.
    pub(super) async fn join(
        folder: PathBuf,
        limits: JobsConfiguration,
        id: Option<&str>,
    ) -> Result<Self, JobError> {
        let bucket = Self::bucket_of(&limits)?;
        let (read, name) = match &bucket {
            Some(bucket) => (bucket.text(FOLDER_ID).await?, bucket.name()),
            None => {
                let read = fs::read_to_string(folder.join(FOLDER_ID)).ok();
                (read, folder.display().to_string())
            }
        };
        match read.filter(|read| Some(read.as_str()) == id) {
            None => Err(JobError::FolderDiffers { folder: name }),
            Some(id) => {
                let made = local(bucket.as_deref())
                    .iter()
                    .try_for_each(|inside| fs::create_dir_all(folder.join(inside)));
                made.map_err(JobError::disk("opening the folder of jobs"))?;
                Self::of(folder, bucket, id, limits).await
            }
        }
    }

    fn bucket_of(limits: &JobsConfiguration) -> Result<Option<Arc<Bucket>>, JobError> {
        let bucket = limits.s3.as_ref().map(Bucket::open).transpose()?;
        Ok(bucket.map(Arc::new))
    }

    async fn of(
        folder: PathBuf,
        bucket: Option<Arc<Bucket>>,
        id: String,
        limits: JobsConfiguration,
    ) -> Result<Self, JobError> {
        let uploads = Permits::new(limits.uploads);
        let (used, writing, held) = (AtomicU64::new(0), AtomicU64::new(0), Mutex::default());
        let files = Self { folder, bucket, id, limits, used, writing, held, uploads };
        files.count().await?;
        Ok(files)
    }

    /// The folder.
    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Bytes that the folder's disk has left; `None` if unknown.
    pub(super) fn free_bytes(&self) -> Option<u64> {
        disk_free_bytes(&self.folder)
    }

    /// The bucket, if the files are in one.
    pub(super) fn bucket(&self) -> Option<&Arc<Bucket>> {
        self.bucket.as_ref()
    }

    /// The identity of the folder or bucket.
    pub(super) fn id(&self) -> &str {
        &self.id
    }

    /// A tenant's right to upload files.
    ///
    /// # Errors
    /// As many uploads arrive as allowed, in all or of the tenant.
    pub(super) fn permit(&self, tenant: &Tenant) -> Result<Permit, JobError> {
        self.uploads.take(tenant)
    }

    /// The limits of files.
    pub(super) const fn limits(&self) -> &JobsConfiguration {
        &self.limits
    }

    /// The path of an input in the folder.
    pub(super) fn input(&self, hash: &str) -> PathBuf {
        self.folder.join(INPUTS).join(hash)
    }

    /// The path of a result in the folder.
    pub(super) fn result(&self, name: &str) -> PathBuf {
        self.folder.join(RESULTS).join(name)
    }

    /// The path of an upload of several requests.
    pub(super) fn arriving(&self, id: &str) -> PathBuf {
        self.folder.join(INCOMING).join(id)
    }

    /// Removes the bytes that have arrived of an upload of several requests.
    pub(super) fn remove_arriving(&self, id: &str) {
        let path = self.arriving(id);
        let bytes = fs::metadata(&path).map_or(0, |metadata| metadata.len());
        // Err: nothing has arrived, or it is complete.
        fs::remove_file(path).ok();
        self.release(bytes);
    }

    /// A stored input, which is kept while the returned value exists.
    pub(super) fn hold(self: &Arc<Self>, hash: String, bytes: u64) -> StoredFile {
        *self.held().entry(hash.clone()).or_default() += 1;
        StoredFile { files: self.clone(), hash, bytes }
    }

    /// Stores a file under the hash of its content, too. Returns whether no equal file was stored.
    /// The caller removes `from` once it is known elsewhere that the file is stored.
    ///
    /// # Errors
    /// The disk or the bucket fails.
    pub(super) async fn store(
        self: &Arc<Self>,
        from: PathBuf,
        hash: String,
        bytes: u64,
    ) -> Result<(StoredFile, bool), JobError> {
        let stored = self.hold(hash, bytes);
        if let Some(bucket) = &self.bucket {
            let name = format!("{INPUTS}/{}", stored.hash);
            let is_new = bucket.size(&name).await?.is_none();
            let opened = File::open(&from).map_err(JobError::disk("reading an upload"))?;
            // Replaces an equal object, so that its age begins again.
            bucket.put(&name, (Arc::new(opened), bytes), Patience::Call).await?;
            return Ok((stored, is_new));
        }
        let (path, folder) = (self.input(&stored.hash), self.folder.join(INPUTS));
        let link = self.arriving(&Uuid::new_v4().simple().to_string());
        let storing = spawn_blocking(move || {
            let inode = fs::metadata(&from)?.ino();
            // The same file if an earlier attempt to complete the upload has failed.
            let is_new = fs::metadata(&path).map_or(true, |known| known.ino() == inode);
            // Replaces an equal file, so that its age begins again.
            fs::hard_link(&from, &link).and_then(|()| fs::rename(&link, &path))?;
            // Err: it was moved, as the stored file was another one.
            fs::remove_file(&link).ok();
            sync(&folder).map(|()| is_new)
        });
        let is_new = storing.await.unwrap_or_else(|error| Err(io::Error::other(error)));
        Ok((stored, is_new.map_err(JobError::disk("storing the file of an upload"))?))
    }

    /// A new file in the folder without a name.
    pub(super) fn nameless(&self) -> io::Result<File> {
        let path = self.arriving(&Uuid::new_v4().simple().to_string());
        let file = File::options().read(true).write(true).create_new(true).open(&path)?;
        fs::remove_file(path)?;
        Ok(file)
    }

    fn held(&self) -> MutexGuard<'_, HashMap<String, usize>> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The identity of a folder. A folder without one gets one.
fn identified(folder: &Path) -> io::Result<String> {
    let path = folder.join(FOLDER_ID);
    if !path.exists() {
        let begun = folder.join(format!("{FOLDER_ID}.{}", Uuid::new_v4().simple()));
        fs::write(&begun, Uuid::new_v4().simple().to_string())?;
        // Err: another process was first.
        fs::hard_link(&begun, &path).ok();
        fs::remove_file(&begun)?;
    }
    fs::read_to_string(path)
}

/// The identity of a bucket. A bucket without one gets one.
async fn identified_in(bucket: &Bucket) -> Result<String, JobError> {
    if let Some(id) = bucket.text(FOLDER_ID).await? {
        return Ok(id);
    }
    bucket.put_text(FOLDER_ID, &Uuid::new_v4().simple().to_string()).await?;
    let missing = || BucketError::Missing { name: FOLDER_ID.to_owned() };
    // Another process may have been first.
    Ok(bucket.text(FOLDER_ID).await?.ok_or_else(missing)?)
}

/// The folders within the folder of jobs.
const fn local(bucket: Option<&Bucket>) -> &'static [&'static str] {
    if bucket.is_some() { &[INCOMING] } else { &FOLDERS }
}

/// Makes a folder's entries durable.
pub(super) fn sync(folder: &Path) -> io::Result<()> {
    fs::File::open(folder)?.sync_all()
}

impl Drop for StoredFile {
    fn drop(&mut self) {
        let mut held = self.files.held();
        if let Some(count) = held.get_mut(&self.hash) {
            *count -= 1;
            if *count == 0 {
                held.remove(&self.hash);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::Ordering;

    use super::super::allowance::Allowance;
    use super::super::arriving::Upload;
    use super::*;

    async fn files(folder: &Path, total_bytes: u64) -> Arc<JobFiles> {
        let limits = JobsConfiguration {
            file_bytes: 100,
            total_bytes,
            files: 2,
            uploads: 1,
            ..JobsConfiguration::standard()
        };
        let named = Named::default();
        Arc::new(JobFiles::open(folder.to_owned(), limits, &named, true).await.unwrap())
    }

    fn begin(files: &Arc<JobFiles>) -> Result<Upload, JobError> {
        Upload::begin_at(files, &Tenant::operator(), Allowance::unlimited())
    }

    async fn stored(upload: &mut Upload, bytes: &[u8]) -> Result<StoredFile, JobError> {
        let mut file = upload.begin().await?;
        file.write(bytes).await?;
        file.finish().await
    }

    fn count(folder: &Path) -> usize {
        let inside = FOLDERS.map(|name| fs::read_dir(folder.join(name)));
        inside.into_iter().map(|entries| entries.unwrap().count()).sum()
    }

    #[tokio::test]
    async fn equal_files_are_one_and_limits_leave_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let files = files(folder.path(), 150).await;
        let mut upload = begin(&files).unwrap();
        assert!(matches!(begin(&files), Err(JobError::TooManyArriving { limit: 1 })));
        let first = stored(&mut upload, &[7; 90]).await.unwrap();
        let again = stored(&mut upload, &[7; 60]).await.unwrap();
        assert_ne!(first.hash, again.hash);
        assert!(matches!(upload.begin().await, Err(JobError::TooManyFiles { limit: 2 })));
        drop(upload);
        let mut upload = begin(&files).unwrap();
        // 150 bytes are used.
        let refused = stored(&mut upload, &[7; 60]).await;
        assert!(matches!(refused, Err(JobError::SpaceExhausted { limit: 150 })));
        let refused = stored(&mut upload, &[7; 101]).await;
        assert!(matches!(refused, Err(JobError::FileTooLarge { limit: 100 })));
        assert_eq!(count(folder.path()), 2);
        assert_eq!(files.used.load(Ordering::Acquire), 150);
    }

    /// Files of the last claim of a job are kept, even if another process claims the job meanwhile.
    #[tokio::test]
    async fn results_that_are_written_stay() {
        let folder = tempfile::tempdir().unwrap();
        let files = files(folder.path(), 1000).await;
        let names = ["job_a.1", "job_a.2", "job_a.3", "job_b.7", "job_c.1"];
        names.iter().for_each(|name| fs::write(files.result(name), b"result").unwrap());
        files.count().await.unwrap();
        assert_eq!(files.used.load(Ordering::Acquire), 30);
        let named = Named::of(["job_c.1".to_owned()], [("job_a".to_owned(), 2)]);
        files.remove_unnamed(&named, [Duration::from_nanos(1); FOLDERS.len()]).await.unwrap();
        let stays = |name: &&str| files.result(name).exists();
        let kept: Vec<_> = names.into_iter().filter(stays).collect();
        assert_eq!(kept, ["job_a.2", "job_a.3", "job_c.1"]);
        files.remove_results_of_lost_claims("job_a", 3);
        assert!(!files.result("job_a.2").exists() && files.result("job_a.3").exists());
        assert_eq!(files.used.load(Ordering::Acquire), 12);
    }

    #[tokio::test]
    async fn a_process_joins_the_folder_of_its_service_only() {
        let folder = tempfile::tempdir().unwrap();
        let id = files(folder.path(), 1000).await.id().to_owned();
        assert_eq!(files(folder.path(), 1000).await.id(), id);
        let join = async |id: Option<&str>| {
            let limits = JobsConfiguration::standard();
            JobFiles::join(folder.path().to_owned(), limits, id).await.map(drop)
        };
        assert!(join(Some(&id)).await.is_ok());
        for other in [None, Some("another")] {
            assert!(matches!(join(other).await, Err(JobError::FolderDiffers { .. })));
        }
    }

    #[tokio::test]
    async fn a_file_stays_while_it_is_held_or_named() {
        let folder = tempfile::tempdir().unwrap();
        let files = files(folder.path(), 1000).await;
        let mut upload = begin(&files).unwrap();
        let held = stored(&mut upload, b"held").await.unwrap();
        let named = stored(&mut upload, b"named").await.unwrap().hash.clone();
        drop(upload);
        let names = Named::of([named.clone()], []);
        let young = [Duration::from_nanos(1); FOLDERS.len()];
        files.remove_unnamed(&names, young).await.unwrap();
        assert_eq!(count(folder.path()), 2);
        drop(held);
        // Young files stay: their job may be about to be stored.
        files.remove_old(&Named::default()).await.unwrap();
        assert_eq!(count(folder.path()), 2);
        files.remove_unnamed(&names, young).await.unwrap();
        assert_eq!(count(folder.path()), 1);
        assert_eq!(fs::read(files.input(&named)).unwrap(), b"named");
        assert_eq!(files.used.load(Ordering::Acquire), 5);
        let mut twice = begin(&files).unwrap();
        stored(&mut twice, b"named").await.unwrap();
        assert_eq!((count(folder.path()), files.used.load(Ordering::Acquire)), (1, 5));
    }
}
