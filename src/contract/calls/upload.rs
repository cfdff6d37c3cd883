//! Uploaded files: unpacked and read within limits, on few blocking threads.

use crate::contract::{Caller, Lease, Refusal, in_background, v1};
use crate::formats::rinex::SkippedEntry;

/// Reads a file with `work` on a blocking thread, when one of the few for files is free. `bytes`
/// is the most memory that the file's content can use.
pub(super) async fn read_file<T: Send + 'static>(
    caller: &Caller,
    bytes: usize,
    work: impl FnOnce() -> Result<T, Refusal> + Send + 'static,
) -> Result<T, Refusal> {
    let reader = caller.file_reader().await;
    let lease = Lease::current();
    lease.as_ref().map_or(Ok(()), |lease| lease.reserve(bytes))?;
    let work = move || {
        // Kept until the file is read, also if the caller no longer waits.
        let _kept = (reader, lease);
        work()
    };
    in_background(work).await?
}

/// A skipped record, as a message.
pub(super) fn skipped_entry(entry: &SkippedEntry) -> v1::Skipped {
    v1::Skipped {
        what: entry.reason.to_string(),
        count: entry.count,
        first_line: entry.lines.first().copied().unwrap_or_default(),
    }
}
