//! The folders of real data. None of it is in the repository.
//!
//! `GRAPHFIX_DATA` names the folder; without it `../shared/data` is tried. If the variable is set,
//! a missing data set fails the test. Otherwise the test is noted as not run, and `scripts/test`
//! lists all such tests at its end.

use std::fs::OpenOptions;
use std::io::Write;
use std::panic::Location;
use std::path::{Path, PathBuf};

/// The folder of all data sets, which may be absent, and whether it must be there.
pub(crate) fn root() -> (PathBuf, bool) {
    let required = std::env::var_os("GRAPHFIX_DATA");
    let is_required = required.is_some();
    let sibling = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    (required.map_or_else(sibling, PathBuf::from), is_required)
}

/// The folder of a data set, or `None` (noted) if it is absent and not required.
#[track_caller]
pub(crate) fn set(name: &str) -> Option<PathBuf> {
    let (root, is_required) = root();
    let folder = root.join(name);
    if folder.is_dir() {
        return Some(folder);
    }
    assert!(!is_required, "GRAPHFIX_DATA is set and {} is missing", folder.display());
    note_missing(&format!("data set {name}"));
    None
}

/// Notes that the calling test does not run, or not completely, because `what` is absent.
#[track_caller]
pub(crate) fn note_missing(what: &str) {
    // The harness names the thread of a test after it, unless there is a single thread for all.
    let thread = std::thread::current();
    let place = Location::caller().to_string();
    let test = thread.name().filter(|name| name.contains("::")).unwrap_or(&place);
    let note = Path::new(env!("CARGO_TARGET_TMPDIR")).join("tests-not-run");
    let mut file =
        OpenOptions::new().create(true).append(true).open(note).expect("target is writable");
    // One write, so that lines of tests that run at the same time do not mix.
    file.write_all(format!("{test}: no {what}\n").as_bytes()).expect("target is writable");
    eprintln!("not run: no {what}");
}
