//! The lease of a database: one service writes to it.
//!
//! On SQLite it is a lock on the file `DATABASE.lock`, which ends with the process. On Postgres it
//! is an advisory lock of the committer's connection, so that no other service can commit; see
//! `committer::link`. Both name the holder.

use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::PoisonError;

use rustix::fs::{FlockOperation, flock};

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
        let mut name = database.as_os_str().to_owned();
        name.push(".lock");
        let path = PathBuf::from(name);
        let failed = |error: std::io::Error| StoreError::Lease {
            why: format!("{}: {error}", path.display()),
        };
        let mut options = OpenOptions::new();
        options.read(true).write(true).create(true).truncate(false);
        let mut file = options.open(&path).map_err(failed)?;
        let mut holder = String::new();
        if flock(&file, FlockOperation::NonBlockingLockExclusive).is_err() {
            file.read_to_string(&mut holder).map_err(failed)?;
            return Err(StoreError::InUse { holder: holder.trim().to_owned() });
        }
        file.set_len(0).and_then(|()| file.rewind()).map_err(failed)?;
        writeln!(file, "{node}").map_err(failed)?;
        Ok(Self { file: Mutex::new(Some(file)) })
    }

    /// Ends the lease.
    pub(super) fn end(&self) {
        self.file.lock().unwrap_or_else(PoisonError::into_inner).take();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
