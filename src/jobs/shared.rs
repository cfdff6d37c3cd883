//! Checks that all nodes of a cluster have the same folder of jobs, or the same bucket.
//!
//! A node writes a file named after its fence before it states in the store that it has a folder.
//! A node that starts looks for the files of the others in its own folder. They are missing in a
//! folder of the same name on another disk, and in a copy of the folder. In a bucket there are
//! objects instead of these files.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use tokio::task::spawn_blocking;

use crate::store::Store;

use super::JobError;
use super::bucket::Bucket;
use super::files::{JobFiles, sync};

/// Prefix of the name of a node's file.
const PREFIX: &str = "node.";

/// States in the store that this node has this folder, if all other nodes with jobs have it, too.
///
/// # Errors
/// Another node has another folder, or the store, the disk or the bucket fails.
pub(super) async fn join(store: &Store, files: &JobFiles) -> Result<(), JobError> {
    let Some(own) = store.fence() else { return Ok(()) };
    let location = Location::of(files);
    location.write(own).await?;
    let others = store.note_job_folder(Some(files.id())).await?;
    for other in others {
        if !location.has(other.fence).await? {
            store.note_job_folder(None).await?;
            let (folder, node) = (location.name(), other.name);
            return Err(JobError::FolderNotShared { folder, node });
        }
    }
    let found = location.fences().await?;
    // Read after the files, because only nodes that are alive already write a file.
    let (alive, _) = store.nodes().await?;
    for fence in found.into_iter().filter(|fence| !alive.iter().any(|node| node.fence == *fence)) {
        location.remove(fence).await;
    }
    Ok(())
}

/// The location of the files of the nodes.
enum Location<'a> {
    Folder(&'a Path),
    Bucket(&'a Bucket),
}

impl<'a> Location<'a> {
    fn of(files: &'a JobFiles) -> Self {
        files.bucket().map_or(Self::Folder(files.folder()), |bucket| Self::Bucket(bucket))
    }

    /// Its name in messages.
    fn name(&self) -> String {
        match self {
            Self::Folder(folder) => folder.display().to_string(),
            Self::Bucket(bucket) => bucket.name(),
        }
    }

    async fn write(&self, own: i64) -> Result<(), JobError> {
        match self {
            Self::Folder(folder) => {
                write(folder, own).map_err(JobError::disk("writing to the folder of jobs"))
            }
            Self::Bucket(bucket) => Ok(bucket.put_text(&name_of(own), "").await?),
        }
    }

    async fn has(&self, fence: i64) -> Result<bool, JobError> {
        match self {
            Self::Folder(folder) => {
                let file = mark(folder, fence);
                let looked = spawn_blocking(move || file.try_exists()).await;
                let looked = looked.unwrap_or_else(|error| Err(io::Error::other(error)));
                looked.map_err(JobError::disk("reading the folder of jobs"))
            }
            Self::Bucket(bucket) => Ok(bucket.size(&name_of(fence)).await?.is_some()),
        }
    }

    /// The fences of the nodes whose files are there.
    async fn fences(&self) -> Result<Vec<i64>, JobError> {
        match self {
            Self::Folder(folder) => {
                marks(folder).map_err(JobError::disk("reading the folder of jobs"))
            }
            // A later node removes files beyond the first page.
            Self::Bucket(bucket) => {
                let (page, _) = bucket.page(PREFIX, None).await?;
                Ok(page.iter().filter_map(|object| fence_of(&object.name)).collect())
            }
        }
    }

    async fn remove(&self, fence: i64) {
        match self {
            // Err: another node has removed it first.
            Self::Folder(folder) => drop(fs::remove_file(mark(folder, fence))),
            // Err: a later node removes it.
            Self::Bucket(bucket) => drop(bucket.delete(&name_of(fence)).await),
        }
    }
}

fn name_of(fence: i64) -> String {
    format!("{PREFIX}{fence}")
}

fn mark(folder: &Path, fence: i64) -> PathBuf {
    folder.join(name_of(fence))
}

fn write(folder: &Path, fence: i64) -> io::Result<()> {
    fs::write(mark(folder, fence), [])?;
    sync(folder)
}

/// The fences of the nodes whose files are there.
fn marks(folder: &Path) -> io::Result<Vec<i64>> {
    let mut fences: Vec<i64> = Vec::new();
    for entry in fs::read_dir(folder)? {
        let name = entry?.file_name();
        fences.extend(name.to_str().and_then(fence_of));
    }
    Ok(fences)
}

/// The fence of the node whose file has this name.
fn fence_of(name: &str) -> Option<i64> {
    name.strip_prefix(PREFIX)?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_files_of_nodes_are_found() {
        let folder = tempfile::tempdir().unwrap();
        for other in ["folder.id", "node.", "node.x", "nodes.3"] {
            fs::write(folder.path().join(other), []).unwrap();
        }
        write(folder.path(), 7).unwrap();
        write(folder.path(), 12).unwrap();
        let mut found = marks(folder.path()).unwrap();
        found.sort_unstable();
        assert_eq!(found, [7, 12]);
    }
}
