//! What is read of the files of jobs: inputs by a run, results by users.
//!
//! An input of a bucket is fetched to a file without a name, and checked by its hash, before a run
//! reads it. A result of a bucket is passed on as it comes.

use std::fs::File;
use std::io;

use bytes::Bytes;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

use super::JobError;
use super::bucket::{Bucket, BucketError, Patience};
use super::files::{INPUTS, JobFiles, RESULTS};

/// Chunks between the bucket and who takes them.
const CHUNKS: usize = 4;
/// Bytes of a result that are read from the folder at a time.
pub const RESULT_CHUNK_BYTES: usize = 64 << 10;

/// The bytes of a result, from the first one on.
pub struct ResultContent(Content);

enum Content {
    File(tokio::fs::File),
    Bucket {
        /// What was taken already, to see whether there is anything.
        first: Option<Bytes>,
        chunks: mpsc::Receiver<Bytes>,
        /// Sends them; `None` once it has ended.
        sending: Option<JoinHandle<Result<(), BucketError>>>,
    },
}

impl JobFiles {
    /// Opens an input of this size.
    ///
    /// # Errors
    /// It cannot be read, or its content is another one.
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

    /// Opens a result of this size. Its first bytes are there when this returns.
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
