//! The lease of a database: one service writes to it.
//!
//! On SQLite it is a lock on the file `DATABASE.lock`, which ends with the process. `DATABASE` is
//! the file to which symbolic links lead. A file with a second hard link is refused: each name
//! would have a lock, and a write-ahead log, of its own. On Postgres it is an advisory lock of the
//! committer's connection, so that no other service can commit; see `committer::link`. Both name
//! the holder.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{ErrorKind, Read, Seek, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::PoisonError;

use super::StoreError;

/// A locked file beside the database.
#[derive(Debug)]
pub(super) struct FileLease {
    file: Mutex<Option<File>>,
}

impl FileLease {
    /// Locks the file beside `database` for the service `node`.
    ///
    /// # Errors
    /// Another service has locked the file, or it cannot be written.
    pub(super) fn take(database: &Path, node: &str) -> Result<Self, StoreError> {
        let lease = |path: &Path, why: &dyn std::fmt::Display| StoreError::Lease {
            why: format!("{}: {why}", path.display()),
        };
        let mut name = target(database).map_err(|error| lease(database, &error))?.into_os_string();
        if std::fs::metadata(&name).is_ok_and(|file| 1 < file.nlink()) {
            return Err(lease(database, &"the file has another name, by a hard link"));
        }
        name.push(".lock");
        let path = PathBuf::from(name);
        let failed = |error: std::io::Error| lease(&path, &error);
        let mut options = OpenOptions::new();
        options.read(true).write(true).create(true).truncate(false);
        let mut file = options.open(&path).map_err(failed)?;
        let mut holder = String::new();
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                file.read_to_string(&mut holder).map_err(failed)?;
                return Err(StoreError::InUse { holder: holder.trim().to_owned() });
            }
            Err(TryLockError::Error(error)) => return Err(failed(error)),
        }
        file.set_len(0).and_then(|()| file.rewind()).map_err(failed)?;
        writeln!(file, "{node}").map_err(failed)?;
        Ok(Self { file: Mutex::new(Some(file)) })
    }

    /// Ends the lease.
    pub(super) fn end(&self) {
        let ended = self.file.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(file) = ended {
            // Closing does not unlock the file while a child process still has it open, as each
            // child does between its fork and its program's start. Err: closing must suffice.
            file.unlock().ok();
        }
    }
}

impl Drop for FileLease {
    fn drop(&mut self) {
        self.end();
    }
}

/// The file to which a path leads, also before it exists.
fn target(path: &Path) -> std::io::Result<PathBuf> {
    match path.canonicalize() {
        Err(error) if error.kind() == ErrorKind::NotFound => match path.read_link() {
            Ok(next) => target(&path.parent().unwrap_or("".as_ref()).join(next)),
            Err(_) => Ok(path.to_owned()),
        },
        found => found,
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    /// Before the database exists, and after.
    #[test]
    fn a_database_has_one_lease_by_all_of_its_names() {
        let folder = tempfile::tempdir().unwrap();
        let [database, link, far, hard] =
            ["graphfix.db", "link.db", "far.db", "hard.db"].map(|name| folder.path().join(name));
        symlink("graphfix.db", &link).unwrap();
        symlink(&link, &far).unwrap();
        for exists in [false, true] {
            if exists {
                std::fs::write(&database, "").unwrap();
            }
            let lease = FileLease::take(&far, "first").unwrap();
            for name in [&database, &link, &far] {
                let refused = FileLease::take(name, "second").unwrap_err();
                assert!(matches!(refused, StoreError::InUse { .. }), "{exists} {refused:?}");
            }
            drop(lease);
        }
        std::fs::hard_link(&database, &hard).unwrap();
        for name in [&hard, &far] {
            let refused = FileLease::take(name, "first").unwrap_err().to_string();
            assert!(refused.ends_with("the file has another name, by a hard link"), "{refused}");
        }
    }

    #[test]
    fn a_lease_has_one_holder_who_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let database = folder.path().join("graphfix.db");
        let first = FileLease::take(&database, "a longer name").unwrap();
        let refused = FileLease::take(&database, "other").unwrap_err();
        let is_named =
            matches!(&refused, StoreError::InUse { holder } if holder == "a longer name");
        assert!(is_named, "{refused:?}");
        first.end();
        let second = FileLease::take(&database, "other").unwrap();
        let refused = FileLease::take(&database, "third").unwrap_err();
        assert!(matches!(&refused, StoreError::InUse { holder } if holder == "other"));
        drop(second);
        FileLease::take(&database, "third").unwrap();
    }

    #[test]
    fn a_lease_ends_although_a_child_process_has_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let database = folder.path().join("graphfix.db");
        let first = FileLease::take(&database, "first").unwrap();
        // Like a child, a clone has the same open file.
        let childs = first.file.lock().unwrap().as_ref().unwrap().try_clone().unwrap();
        first.end();
        FileLease::take(&database, "second").unwrap();
        drop(childs);
    }
}
