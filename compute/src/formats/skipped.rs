//! Counts of what a reader of text left out, with the first lines.

use std::fmt;

/// Number of line numbers stored for one reason.
const PLACES_LIMIT: usize = 10;
/// Number of reasons stored; reasons that quote the file could be many.
const REASONS_LIMIT: usize = 64;

/// One reason, with count and first lines.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SkippedEntry<R> {
    /// Why parts were left out.
    pub reason: R,
    /// How often this happened.
    pub count: u64,
    /// The first lines (from 1), at most ten.
    pub lines: Vec<u64>,
}

/// Counts of what a reader left out, by reason.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Skipped<R> {
    entries: Vec<SkippedEntry<R>>,
}

/// Nothing left out.
impl<R> Default for Skipped<R> {
    fn default() -> Self {
        Self { entries: Vec::new() }
    }
}

impl<R: Copy + PartialEq + fmt::Display> Skipped<R> {
    /// All reasons, in order of first appearance.
    pub fn entries(&self) -> &[SkippedEntry<R>] {
        &self.entries
    }

    /// How often parts were left out for this reason.
    pub fn count(&self, reason: R) -> u64 {
        self.entries.iter().find(|e| e.reason == reason).map_or(0, |e| e.count)
    }

    /// Whether nothing was left out.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    pub(super) fn note(&mut self, reason: R, line: u64) {
        if let Some(entry) = self.entries.iter_mut().find(|e| e.reason == reason) {
            entry.count += 1;
            if entry.lines.len() < PLACES_LIMIT {
                entry.lines.push(line);
            }
        } else if self.entries.len() < REASONS_LIMIT {
            self.entries.push(SkippedEntry { reason, count: 1, lines: vec![line] });
        }
    }
}
