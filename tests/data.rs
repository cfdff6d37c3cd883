//! Where real data is found. None of it is in the repository.
//!
//! `GRAPHFIX_DATA` names the folder; without it `../shared/data` is tried. Where the variable is
//! set, a missing set fails the test; elsewhere the set is noted and `scripts/test` says at its end
//! which were not there.

use std::fs::OpenOptions;
use std::io::Write;
use std::path::{Path, PathBuf};

/// The folder of a data set, or `None` (noted) where it is absent and need not be there.
pub(crate) fn set(name: &str) -> Option<PathBuf> {
    let required = std::env::var_os("GRAPHFIX_DATA");
    let root = required.clone().map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
        PathBuf::from,
    );
    let folder = root.join(name);
    if folder.is_dir() {
        return Some(folder);
    }
    assert!(required.is_none(), "GRAPHFIX_DATA is set and {} is missing", folder.display());
    note_missing(&format!("data set {name}"));
    None
}

/// Notes what a test was skipped for, so that `scripts/test` can say it at its end.
pub(crate) fn note_missing(what: &str) {
    let note = Path::new(env!("CARGO_TARGET_TMPDIR")).join("missing-data-sets");
    let mut file =
        OpenOptions::new().create(true).append(true).open(note).expect("target is writable");
    writeln!(file, "{what}").expect("target is writable");
    eprintln!("skipped: {what} is not there");
}
