//! The content of the files of jobs: inputs and checkpoints for a run, results for users.
//!
//! An input in a bucket is fetched to a file without a name, and checked by its hash, before a run
//! reads it. A result in a bucket is passed on as it arrives. Checkpoints and figures are in memory
//! as a whole.

use std::fs::{self, File};
use std::io::{self, ErrorKind, Write};
use std::path::PathBuf;
use std::sync::Arc;

use bytes::Bytes;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use uuid::Uuid;

use super::JobError;
use super::bucket::{Bucket, BucketError, Listed, Patience};
use super::files::{CHECKPOINTS, INPUTS, JobFiles, RESULTS, sync};
use super::named::{checkpoint_name, figures_name};

/// Most chunks between the bucket and the reader.
const CHUNKS: usize = 4;
/// Bytes of a result that are read from the folder at a time.
pub const RESULT_CHUNK_BYTES: usize = 64 << 10;
/// Most bytes of the figures of a result.
pub(super) const FIGURES_BYTES: usize = 1 << 20;
/// Most memory of the page of a report while it is made (bytes): its figures, and the page.
pub const PAGE_BYTES: usize = 3 * FIGURES_BYTES;

/// The bytes of a result, from its first byte on.
pub struct ResultContent(Content);

enum Content {
    File(tokio::fs::File),
    Bucket {
        /// The chunk that was read first, to check that the object can be read.
        first: Option<Bytes>,
        chunks: mpsc::Receiver<Bytes>,
        /// The task that sends the chunks; `None` once it has ended.
        sending: Option<JoinHandle<Result<(), BucketError>>>,
    },
}

impl JobFiles {
    /// Opens an input of this size.
    ///
    /// # Errors
    /// It cannot be read, or its content has another hash.
    pub(super) async fn open_input(&self, hash: &str, bytes: u64) -> Result<File, JobError> {
        match self.bucket() {
            Some(bucket) => self.fetched(bucket, hash, bytes).await,
            None => File::open(self.input(hash)).map_err(JobError::disk("opening an input")),
        }
    }

    /// Fetches an input from the bucket.
    async fn fetched(&self, bucket: &Bucket, hash: &str, bytes: u64) -> Result<File, JobError> {
        let failed = || JobError::disk("writing an input of the bucket");
        let file = self.nameless().map_err(failed())?;
        let writer = file.try_clone().map_err(failed())?;
        let (name, (sender, mut chunks)) = (format!("{INPUTS}/{hash}"), mpsc::channel(CHUNKS));
        let downloading = async {
            let downloaded = bucket.download((&name, bytes), Patience::Run, &sender).await;
            drop(sender);
            downloaded
        };
        let writing = async {
            let (mut writer, mut hasher) =
                (tokio::fs::File::from_std(writer), blake3::Hasher::new());
            while let Some(chunk) = chunks.recv().await {
                hasher.update(&chunk);
                writer.write_all(&chunk).await?;
            }
            writer.flush().await?;
            Ok::<_, io::Error>(hasher.finalize())
        };
        let (downloaded, written) = tokio::join!(downloading, writing);
        let found = written.map_err(failed())?;
        downloaded?;
        if found.to_hex().as_str() != hash {
            let why = format!("its hash is {found}");
            return Err(BucketError::Damaged { name, why }.into());
        }
        Ok(file)
    }

    /// The content of a checkpoint, if there is one of this name.
    ///
    /// # Errors
    /// The disk or the bucket fails.
    pub(super) async fn checkpoint(&self, name: &str) -> Result<Option<Vec<u8>>, JobError> {
        self.whole(CHECKPOINTS, name).await
    }

    /// The figures of a result, as a part of an HTML page, if they are kept.
    ///
    /// # Errors
    /// The disk or the bucket fails.
    pub(super) async fn figures(&self, result: &str) -> Result<Option<String>, JobError> {
        let content = self.whole(RESULTS, &figures_name(result)).await?;
        let text = content.map(String::from_utf8).transpose();
        text.map_err(|error| JobError::disk("reading figures")(io::Error::other(error)))
    }

    /// The content of a small file.
    async fn whole(&self, inside: &str, name: &str) -> Result<Option<Vec<u8>>, JobError> {
        let Some(bucket) = self.bucket() else {
            return match tokio::fs::read(self.folder().join(inside).join(name)).await {
                Ok(content) => Ok(Some(content)),
                Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
                Err(error) => Err(JobError::disk("reading a small file")(error)),
            };
        };
        let name = format!("{inside}/{name}");
        let Some(bytes) = bucket.size(&name).await? else { return Ok(None) };
        let (sender, mut chunks) = mpsc::channel(CHUNKS);
        let downloading = async {
            let downloaded = bucket.download((&name, bytes), Patience::Call, &sender).await;
            drop(sender);
            downloaded
        };
        let collecting = async {
            let mut content = Vec::new();
            while let Some(chunk) = chunks.recv().await {
                content.extend_from_slice(&chunk);
            }
            content
        };
        let (downloaded, content) = tokio::join!(downloading, collecting);
        match downloaded {
            Ok(()) => Ok(Some(content)),
            Err(BucketError::Missing { .. }) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    /// Stores a checkpoint, and replaces one of the same name. It is durable when this returns.
    ///
    /// # Errors
    /// The space of all files is used up, or the disk or the bucket fails.
    pub(super) async fn store_checkpoint(
        &self,
        name: &str,
        content: &[u8],
    ) -> Result<(), JobError> {
        self.store_whole(CHECKPOINTS, name, content).await
    }

    /// Stores the figures of a result. They are removed together with the result.
    ///
    /// # Errors
    /// The space of all files is used up, or the disk or the bucket fails.
    pub(super) async fn store_figures(&self, result: &str, content: &str) -> Result<(), JobError> {
        self.store_whole(RESULTS, &figures_name(result), content.as_bytes()).await
    }

    /// Stores a small file, and replaces one of the same name.
    async fn store_whole(&self, inside: &str, name: &str, content: &[u8]) -> Result<(), JobError> {
        let bytes = content.len() as u64;
        self.reserve(bytes)?;
        let stored = match self.bucket() {
            None => self.write_whole(inside, name, content),
            Some(bucket) => {
                let written = self.nameless().and_then(|mut file| {
                    file.write_all(content)?;
                    Ok(Arc::new(file))
                });
                let file = written.map_err(JobError::disk("writing a small file"))?;
                let name = format!("{inside}/{name}");
                bucket.put(&name, (file, bytes), Patience::Call).await.map_err(JobError::from)
            }
        };
        stored.inspect_err(|_| self.release(bytes))
    }

    /// Writes a small file to the folder. A file with this name is always complete.
    fn write_whole(&self, inside: &str, name: &str, content: &[u8]) -> Result<(), JobError> {
        let path = self.folder().join(inside).join(name);
        let before = fs::metadata(&path).map_or(0, |metadata| metadata.len());
        let begun = self.arriving(&Uuid::new_v4().simple().to_string());
        let written = File::create_new(&begun)
            .and_then(|mut file| {
                file.write_all(content)?;
                file.sync_all()
            })
            .and_then(|()| fs::rename(&begun, &path))
            .and_then(|()| sync(&self.folder().join(inside)));
        // Err: it has its final name, or was never created.
        fs::remove_file(begun).ok();
        written.map_err(JobError::disk("writing a small file"))?;
        self.release(before);
        Ok(())
    }

    /// Removes the checkpoints of a job. Those that cannot be removed now are removed once they are
    /// old.
    pub(super) async fn remove_checkpoints(&self, job: &str) {
        let Some(bucket) = self.bucket() else {
            for part in 0.. {
                let path = self.in_checkpoints(&checkpoint_name(job, part));
                let Ok(metadata) = fs::metadata(&path) else { return };
                if fs::remove_file(path).is_ok() {
                    self.release(metadata.len());
                }
            }
            return;
        };
        let (begin, mut token) = (format!("{CHECKPOINTS}/{job}-"), None);
        while let Ok((page, next)) = bucket.page(&begin, token).await {
            for Listed { name, bytes, .. } in page {
                if bucket.delete(&name).await.is_ok() {
                    self.release(bytes);
                }
            }
            token = next;
            if token.is_none() {
                return;
            }
        }
    }

    fn in_checkpoints(&self, name: &str) -> PathBuf {
        self.folder().join(CHECKPOINTS).join(name)
    }

    /// Removes a result of `bytes` bytes with its figures, and gives their space back.
    pub(super) async fn remove_result(&self, name: &str, bytes: u64) {
        let figures = figures_name(name);
        match self.bucket() {
            // Err: the object is removed once it is old, because no job names it.
            Some(bucket) => {
                drop(bucket.delete(&format!("{RESULTS}/{name}")).await);
                let figures = format!("{RESULTS}/{figures}");
                if let Ok(Some(bytes)) = bucket.size(&figures).await
                    && bucket.delete(&figures).await.is_ok()
                {
                    self.release(bytes);
                }
            }
            // Err: the file was not written.
            None => {
                drop(fs::remove_file(self.result(name)));
                self.remove_from_results(&figures);
            }
        }
        self.release(bytes);
    }

    /// Removes a file of the folder's results, and gives its space back.
    pub(super) fn remove_from_results(&self, name: &str) {
        let path = self.result(name);
        let bytes = fs::metadata(&path).map_or(0, |metadata| metadata.len());
        // Err: it was not written.
        fs::remove_file(path).ok();
        self.release(bytes);
    }

    /// Opens a result of this size. When it returns, the first bytes have arrived.
    ///
    /// # Errors
    /// It cannot be read.
    pub(super) async fn open_result(
        &self,
        name: &str,
        bytes: u64,
    ) -> Result<ResultContent, JobError> {
        let Some(bucket) = self.bucket().cloned() else {
            let file = tokio::fs::File::open(self.result(name)).await;
            let file = file.map_err(JobError::disk("opening the result"))?;
            return Ok(ResultContent(Content::File(file)));
        };
        let (name, (sender, chunks)) = (format!("{RESULTS}/{name}"), mpsc::channel(CHUNKS));
        let sending =
            tokio::spawn(
                async move { bucket.download((&name, bytes), Patience::Call, &sender).await },
            );
        let mut content =
            ResultContent(Content::Bucket { first: None, chunks, sending: Some(sending) });
        let taken = content.chunk().await?;
        if let Content::Bucket { first, .. } = &mut content.0 {
            *first = taken;
        }
        Ok(content)
    }
}

impl ResultContent {
    /// The next bytes; `None` after the last ones.
    ///
    /// # Errors
    /// The disk or the bucket fails.
    pub async fn chunk(&mut self) -> Result<Option<Bytes>, JobError> {
        match &mut self.0 {
            Content::File(file) => {
                let mut chunk = Vec::with_capacity(RESULT_CHUNK_BYTES);
                let read = file.take(RESULT_CHUNK_BYTES as u64).read_to_end(&mut chunk).await;
                let count = read.map_err(JobError::disk("reading the result"))?;
                Ok((0 < count).then(|| chunk.into()))
            }
            Content::Bucket { first, chunks, sending } => {
                if let Some(chunk) = first.take() {
                    return Ok(Some(chunk));
                }
                if let Some(chunk) = chunks.recv().await {
                    return Ok(Some(chunk));
                }
                let Some(sending) = sending.take() else { return Ok(None) };
                let broken = |error| BucketError::Away { why: format!("{error}") };
                sending.await.map_err(broken)??;
                Ok(None)
            }
        }
    }
}
