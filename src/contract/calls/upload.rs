//! Uploaded files: read on blocking threads.

use crate::contract::{Refusal, v1};
use crate::formats::rinex::SkippedEntry;
use crate::refusal::Code;

/// Runs `work` on a blocking thread, so that other calls need not wait.
pub(super) async fn in_background<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Refusal> {
    let done = tokio::task::spawn_blocking(work).await;
    done.map_err(|panic| Refusal::new(Code::Internal, panic.to_string()))
}

/// A skipped record, as a message.
pub(super) fn skipped_entry(entry: &SkippedEntry) -> v1::Skipped {
    v1::Skipped {
        what: entry.reason.to_string(),
        count: entry.count,
        first_line: entry.lines.first().copied().unwrap_or_default(),
    }
}
