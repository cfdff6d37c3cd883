//! The Python that `scripts/test` prepares for independent programs.

use std::process::Command;

use super::data;

/// Python with a package; `None` (noted) if it is absent.
#[track_caller]
pub(crate) fn with(package: &str) -> Option<String> {
    let python = std::env::var("GRAPHFIX_TEST_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let import = format!("import {package}");
    let tried = Command::new(&python).args(["-c", &import]).output();
    if tried.is_ok_and(|output| output.status.success()) {
        return Some(python);
    }
    data::note_missing(&format!("Python with {package}"));
    None
}
