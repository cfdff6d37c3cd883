//! Checkpoints: the data from which the next run of a job continues if a run is interrupted.
//!
//! They are a chain of parts in the files of jobs: `JOB-0`, `JOB-1` and so on. A part has the
//! answers since the part before it, the state of the estimator after them, and the hash of that
//! part. The next run writes these answers as if it had computed them. So the result has the same
//! bytes in every format.
//!
//! A process that was suspended may write a part of a job that another process has claimed
//! meanwhile. Its part belongs to the same computation, so any part that continues the part before
//! it is right. A part that does not continue it ends the chain.

use std::time::{Duration, Instant};

use crate::gnss::Solution;
use crate::snapshot::{Snapshot, SnapshotError, SnapshotReader, SnapshotWriter};

use super::JobError;
use super::files::JobFiles;
use super::named::checkpoint_name;

/// Layout of a part. Raise it when its content changes.
const LAYOUT: u16 = 1;
/// Size of encoded answers from which a part is written before its interval is over (bytes).
const PART_BYTES: usize = 8 << 20;
/// Version of this program. Another version may compute other bits, so it begins the job again.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// A chain, and the answers for its next part.
pub(super) struct Checkpoints {
    job: String,
    interval: Duration,
    /// Number of parts.
    parts: u64,
    /// Hash of the last part; zeros before the first.
    last: [u8; blake3::OUT_LEN],
    /// Number and bytes of the answers since the last part.
    answers: u64,
    encoded: SnapshotWriter,
    written: Instant,
}

/// What the next run continues from.
pub(super) struct Found {
    /// Number of parts.
    pub(super) parts: u64,
    /// State of the estimator after the last part.
    pub(super) state: Vec<u8>,
    /// Time that the earlier runs have taken (s).
    pub(super) seconds: f64,
}

/// A part that continues the one before it.
struct Part<'a> {
    seconds: f64,
    state: &'a [u8],
    answers: u64,
    encoded: &'a [u8],
}

impl Checkpoints {
    /// A chain without parts. A part is due after each `interval`.
    pub(super) fn new(job: String, interval: Duration) -> Self {
        Self {
            job,
            interval,
            parts: 0,
            last: [0; blake3::OUT_LEN],
            answers: 0,
            encoded: SnapshotWriter::new(LAYOUT),
            written: Instant::now(),
        }
    }

    /// The stored parts of its job, if there are any. The chain itself stays without parts.
    ///
    /// # Errors
    /// The disk or the bucket fails.
    pub(super) async fn found(&self, files: &JobFiles) -> Result<Option<Found>, JobError> {
        let mut chain = Self::new(self.job.clone(), self.interval);
        let mut found = None;
        while let Some(bytes) = files.checkpoint(&chain.next_name()).await? {
            let part = match chain.read(&bytes) {
                Ok(part) => part,
                Err(error) => {
                    tracing::warn!(job = chain.job, part = chain.parts, %error, "no checkpoint");
                    break;
                }
            };
            let (state, seconds) = (part.state.to_vec(), part.seconds);
            found = Some(Found { parts: chain.parts + 1, state, seconds });
            chain.append(&bytes);
        }
        Ok(found)
    }

    /// Adds the next stored part to the chain. Returns its answers; `None` if the part is not there
    /// any more.
    ///
    /// # Errors
    /// The disk or the bucket fails.
    pub(super) async fn take(
        &mut self,
        files: &JobFiles,
    ) -> Result<Option<Vec<Solution>>, JobError> {
        let Some(bytes) = files.checkpoint(&self.next_name()).await? else { return Ok(None) };
        // Err: another process has replaced it meanwhile.
        let Ok(answers) = self.read(&bytes).and_then(|part| part.answers()) else {
            return Ok(None);
        };
        self.append(&bytes);
        Ok(Some(answers))
    }

    /// Adds an answer to the next part.
    pub(super) fn add(&mut self, answer: &Solution) {
        answer.save(&mut self.encoded);
        self.answers += 1;
    }

    /// Whether a part is to be written.
    pub(super) fn is_due(&self) -> bool {
        PART_BYTES <= self.encoded.size() || self.interval <= self.written.elapsed()
    }

    /// Writes a part with the answers since the last part, the state after them, and the time that
    /// this run and the earlier ones have taken (s).
    ///
    /// # Errors
    /// The space of all files is used up, or the disk or the bucket fails. The answers are then
    /// lost, so no further part may be written.
    pub(super) async fn write(
        &mut self,
        files: &JobFiles,
        (state, seconds): (&[u8], f64),
    ) -> Result<(), JobError> {
        let encoded = std::mem::replace(&mut self.encoded, SnapshotWriter::new(LAYOUT));
        let answers = std::mem::take(&mut self.answers);
        let mut writer = SnapshotWriter::new(LAYOUT);
        VERSION.to_owned().save(&mut writer);
        writer.bytes(&self.last);
        seconds.save(&mut writer);
        writer.bytes(state);
        answers.save(&mut writer);
        writer.bytes(&encoded.finish_unsealed());
        let bytes = writer.finish();
        files.store_checkpoint(&self.next_name(), &bytes).await?;
        self.append(&bytes);
        self.written = Instant::now();
        Ok(())
    }

    fn next_name(&self) -> String {
        checkpoint_name(&self.job, self.parts)
    }

    fn append(&mut self, part: &[u8]) {
        self.parts += 1;
        self.last = blake3::hash(part).into();
    }

    /// Reads a part that must continue the last one.
    fn read<'a>(&self, bytes: &'a [u8]) -> Result<Part<'a>, SnapshotError> {
        let mut reader = SnapshotReader::open(bytes, LAYOUT)?;
        if String::load(&mut reader)? != VERSION {
            return Err(reader.invalid("version of the program"));
        }
        if reader.bytes()? != self.last {
            return Err(reader.invalid("hash of the part before"));
        }
        let (seconds, state) = (f64::load(&mut reader)?, reader.bytes()?);
        let part =
            Part { seconds, state, answers: u64::load(&mut reader)?, encoded: reader.bytes()? };
        reader.finish()?;
        Ok(part)
    }
}

impl Part<'_> {
    fn answers(&self) -> Result<Vec<Solution>, SnapshotError> {
        let mut reader = SnapshotReader::open_unsealed(self.encoded, LAYOUT)?;
        let answers = (0..self.answers).map(|_| Solution::load(&mut reader)).collect();
        reader.finish().and(answers)
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::config::JobsConfiguration;
    use crate::gnss::GpsTime;
    use crate::jobs::named::Named;

    async fn files(folder: &Path, total_bytes: u64) -> JobFiles {
        let limits = JobsConfiguration { total_bytes, ..JobsConfiguration::standard() };
        JobFiles::open(folder.to_owned(), limits, &Named::default(), true).await.unwrap()
    }

    fn chain() -> Checkpoints {
        Checkpoints::new("job_a".to_owned(), Duration::from_secs(3600))
    }

    fn answers(times_ns: std::ops::Range<i64>) -> Vec<Solution> {
        times_ns.map(|ns| Solution::none(GpsTime::from_ns(ns), Vec::new())).collect()
    }

    /// Writes a part with these answers. Its state is its number.
    async fn write(chain: &mut Checkpoints, files: &JobFiles, times_ns: std::ops::Range<i64>) {
        answers(times_ns).iter().for_each(|answer| chain.add(answer));
        let state = [chain.parts as u8];
        let seconds = chain.parts as f64 + 0.5;
        chain.write(files, (&state, seconds)).await.unwrap();
    }

    /// The answers of as many parts as are found, and the last state.
    async fn read(files: &JobFiles) -> Option<(Vec<Solution>, Vec<u8>, f64)> {
        let mut chain = chain();
        let Found { parts, state, seconds } = chain.found(files).await.unwrap()?;
        let mut all = Vec::new();
        for _ in 0..parts {
            all.extend(chain.take(files).await.unwrap().unwrap());
        }
        Some((all, state, seconds))
    }

    #[tokio::test]
    async fn a_chain_has_all_answers_and_goes_on() {
        let folder = tempfile::tempdir().unwrap();
        let files = files(folder.path(), 1 << 20).await;
        assert_eq!(read(&files).await, None);
        let mut first = chain();
        for times in [0..3, 3..3, 3..700] {
            write(&mut first, &files, times).await;
        }
        assert_eq!(read(&files).await, Some((answers(0..700), vec![2], 2.5)));
        let mut second = chain();
        while second.take(&files).await.unwrap().is_some() {}
        write(&mut second, &files, 700..702).await;
        assert_eq!(read(&files).await, Some((answers(0..702), vec![3], 3.5)));
        files.remove_checkpoints("job_a").await;
        assert_eq!(read(&files).await, None);
        // All of the space is free again.
        files.reserve(1 << 20).unwrap();
    }

    /// A part of a suspended process replaces another one. The chain ends after it, because the
    /// next part continues the replaced one.
    #[tokio::test]
    async fn a_part_that_continues_another_one_ends_the_chain() {
        let folder = tempfile::tempdir().unwrap();
        let files = files(folder.path(), 1 << 20).await;
        let (mut frozen, mut other) = (chain(), chain());
        write(&mut frozen, &files, 0..2).await;
        other.take(&files).await.unwrap().unwrap();
        write(&mut other, &files, 2..4).await;
        write(&mut other, &files, 4..6).await;
        write(&mut frozen, &files, 2..5).await;
        assert_eq!(read(&files).await, Some((answers(0..5), vec![1], 1.5)));
    }

    #[tokio::test]
    async fn damaged_parts_and_those_of_another_version_end_the_chain() {
        let folder = tempfile::tempdir().unwrap();
        let files = files(folder.path(), 1 << 20).await;
        let mut whole = chain();
        for times in [0..2, 2..4] {
            write(&mut whole, &files, times).await;
        }
        let path = folder.path().join("checkpoints/job_a-1");
        let content = std::fs::read(&path).unwrap();
        for damaged in [content[..content.len() - 1].to_vec(), Vec::new(), {
            let mut changed = content.clone();
            changed[20] ^= 1;
            changed
        }] {
            std::fs::write(&path, damaged).unwrap();
            assert_eq!(read(&files).await, Some((answers(0..2), vec![0], 0.5)));
        }
        let mut writer = SnapshotWriter::new(LAYOUT);
        "0.0.0".to_owned().save(&mut writer);
        std::fs::write(folder.path().join("checkpoints/job_a-0"), writer.finish()).unwrap();
        assert_eq!(read(&files).await, None);
    }

    #[tokio::test]
    async fn a_part_without_space_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let files = files(folder.path(), 100).await;
        let mut chain = chain();
        answers(0..100).iter().for_each(|answer| chain.add(answer));
        let refused = chain.write(&files, (&[], 0.0)).await;
        assert!(matches!(refused, Err(JobError::SpaceExhausted { limit: 100 })));
        assert_eq!(read(&files).await, None);
    }
}
