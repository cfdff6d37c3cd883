//! Uploaded files: unpacked and read within limits, on few blocking threads.
//!
//! If the gzip stream of a file is cut off, the file is read up to its last whole line, as if it
//! ended there, and the answer reports it. If the gzip stream is damaged, the file is refused: the
//! data before the damage may have hidden errors, and uploads serve every session of the tenant.

use std::io::BufRead;

use crate::contract::{Caller, Lease, Refusal, in_background, v1};
use crate::formats::rinex::{Skipped, SkippedEntry};
use crate::formats::{GzipDamage, WholeLines, unpack_within};
use crate::refusal::Code;

/// The content of a file, and the point at which it is cut off.
pub(super) struct Upload<T> {
    pub(super) content: T,
    cut: Option<GzipDamage>,
    /// Number of bytes received.
    bytes: u64,
}

/// Reads a file with `work` on a blocking thread, once one of the few threads for files is free.
/// `bytes` is the most memory that the file's content can use.
pub(super) async fn read_file<T: Send + 'static>(
    caller: &Caller,
    bytes: usize,
    work: impl FnOnce() -> Result<T, Refusal> + Send + 'static,
) -> Result<T, Refusal> {
    let reader = caller.file_reader().await;
    let lease = Lease::current();
    lease.as_ref().map_or(Ok(()), |lease| lease.reserve(bytes))?;
    let work = move || {
        // Kept until the file is read, even if the caller no longer waits.
        let _kept = (reader, lease);
        work()
    };
    in_background(work).await?
}

/// Reads an uploaded RINEX text, plain or gzip, with `work`. `limit` is the most unpacked bytes.
///
/// # Errors
/// Those of `work`. If the file is cut off, the cut may be the cause, and the error names it.
pub(super) fn read_text<T, E: Into<Refusal>>(
    content: &[u8],
    limit: u64,
    work: impl FnOnce(&mut dyn BufRead) -> Result<T, E>,
) -> Result<Upload<T>, Refusal> {
    let mut text = WholeLines::new(unpack_within(content, limit));
    let (report, bytes) = (text.report(), content.len() as u64);
    let read = work(&mut text);
    let cut = report.get().cloned();
    match read {
        Ok(content) => Ok(Upload { content, cut, bytes }),
        Err(error) => Err(Upload { content: (), cut, bytes }.blamed(error.into())),
    }
}

impl<T> Upload<T> {
    /// A refusal that names the cut, which may be its cause.
    pub(super) fn blamed(&self, refusal: Refusal) -> Refusal {
        let Some(cut) = &self.cut else { return refusal };
        let code = match refusal.code {
            // The missing part of the file could have changed the header.
            Code::RinexNotRinex | Code::RinexHeaderInvalid => Code::RinexTruncated,
            code => code,
        };
        let message = format!("{}; {cut}", refusal.message);
        Refusal { code, message, ..refusal }.on_byte(self.bytes)
    }

    /// Whether its gzip stream is cut off.
    pub(super) const fn is_cut(&self) -> bool {
        self.cut.is_some()
    }

    /// The skipped parts for the answer: records, and the part after a cut.
    pub(super) fn skipped(&self, records: &Skipped) -> Vec<v1::Skipped> {
        let cut = self.cut.iter().map(|cut| v1::Skipped {
            what: format!("{cut}: what follows is missing"),
            count: 1,
            first_line: 0,
        });
        records.entries().iter().map(skipped_entry).chain(cut).collect()
    }
}

/// A skipped record, as a message.
fn skipped_entry(entry: &SkippedEntry) -> v1::Skipped {
    v1::Skipped {
        what: entry.reason.to_string(),
        count: entry.count,
        first_line: entry.lines.first().copied().unwrap_or_default(),
    }
}
