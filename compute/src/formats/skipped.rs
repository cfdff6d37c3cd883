//! Counts of what a reader of text left out, with the first lines.

use std::fmt;

/// Number of positions stored for one reason.
const POSITIONS_LIMIT: usize = 10;
/// Number of reasons stored; reasons that quote the file could be many.
const REASONS_LIMIT: usize = 64;

/// One reason, with count and first lines.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SkippedEntry<R> {
    /// Why parts were left out.
    pub reason: R,
    /// How often this happened.
    pub count: u64,
    /// The first lines (from 1), at most ten, each once.
    pub lines: Vec<u64>,
    /// Whether there are lines besides those.
    pub has_more: bool,
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
            entry.has_more |= !note_position(&mut entry.lines, line);
        } else if self.entries.len() < REASONS_LIMIT {
            let lines = vec![line];
            self.entries.push(SkippedEntry { reason, count: 1, lines, has_more: false });
        }
    }
}

/// Adds a position to the first ones, unless it is one of them. Returns whether it is one of them
/// now: at most ten are stored.
pub(super) fn note_position(first: &mut Vec<u64>, position: u64) -> bool {
    let is_known = first.contains(&position);
    let has_room = first.len() < POSITIONS_LIMIT;
    if !is_known && has_room {
        first.push(position);
    }
    is_known || has_room
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_listed_once_and_counted_each_time() {
        let mut skipped = Skipped::default();
        for line in [3, 3, 3, 7] {
            skipped.note("reason", line);
        }
        let entry =
            |lines, count, has_more| SkippedEntry { reason: "reason", count, lines, has_more };
        assert_eq!(skipped.entries(), [entry(vec![3, 7], 4, false)]);
        for line in [8, 9, 10, 11, 12, 13, 14, 15, 15] {
            skipped.note("reason", line);
        }
        let lines = vec![3, 7, 8, 9, 10, 11, 12, 13, 14, 15];
        assert_eq!(skipped.entries(), [entry(lines.clone(), 13, false)]);
        skipped.note("reason", 16);
        assert_eq!(skipped.entries(), [entry(lines, 14, true)]);
    }
}
