//! Uploaded files: unpacked within limits, on blocking threads.

use std::io::Read;

use crate::contract::{Refusal, v1};
use crate::formats::decompress;
use crate::formats::rinex::SkippedEntry;
use crate::refusal::Code;

/// Runs `work` on a blocking thread, so that other calls need not wait.
pub(super) async fn in_background<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Refusal> {
    let done = tokio::task::spawn_blocking(work).await;
    done.map_err(|panic| Refusal::new(Code::Internal, panic.to_string()))
}

/// A file's content, unpacked if it is gzip.
pub(super) fn unpacked(content: &[u8], bytes_max: u64) -> Result<Vec<u8>, Refusal> {
    let mut text = Vec::new();
    let unpacked = decompress(content).take(bytes_max + 1).read_to_end(&mut text);
    unpacked.map_err(|error| Refusal::new(Code::RinexReadFailed, error.to_string()))?;
    if bytes_max < text.len() as u64 {
        let message = format!("unpacked, the file exceeds {bytes_max} bytes");
        return Err(Refusal::new(Code::DecompressedTooLarge, message));
    }
    Ok(text)
}

/// A skipped record, as a message.
pub(super) fn skipped_entry(entry: &SkippedEntry) -> v1::Skipped {
    v1::Skipped {
        what: entry.reason.to_string(),
        count: entry.count,
        first_line: entry.lines.first().copied().unwrap_or_default(),
    }
}
