//! One computation at a time for each key, over all threads and processes that share a cache.
//!
//! A claim is an exclusive lock on a file of the key's name. The system drops it with the process that holds it, so a
//! killed run claims nothing. The file is deleted before the lock is released; whoever locked a deleted file sees that
//! the name stands for another file, or none, and tries again. Where the file system has no locks, nothing is claimed
//! and two runs may do the same work twice, with the same result.

use std::fs::{File, TryLockError};
use std::path::PathBuf;

use crate::digest::Digest;

use super::{Cache, CacheError, io};

/// The right to compute a key, until dropped.
#[derive(Debug)]
pub(crate) struct Claim {
    path: PathBuf,
    /// Locked; nothing where the file system has no locks.
    _file: Option<File>,
}

impl Cache {
    /// Claims a key; nothing while someone else has it.
    ///
    /// # Errors
    /// When the lock's file cannot be made.
    pub(crate) fn try_claim(&self, key: &Digest) -> Result<Option<Claim>, CacheError> {
        let folder = self.root.join("locks");
        let path = folder.join(key.to_string());
        let open = || File::options().create(true).write(true).truncate(false).open(&path);
        loop {
            let file = match open() {
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                    std::fs::create_dir_all(&folder).map_err(io("make", &folder))?;
                    open()
                }
                opened => opened,
            }
            .map_err(io("write", &path))?;
            match file.try_lock() {
                Ok(()) if is_at(&file, &path) => return Ok(Some(Claim { path, _file: Some(file) })),
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => return Ok(None),
                Err(TryLockError::Error(_)) => return Ok(Some(Claim { path, _file: None })),
            }
        }
    }

    /// Deletes lock files that nobody holds; killed runs leave them.
    pub(super) fn sweep_locks(&self) {
        let entries = std::fs::read_dir(self.root.join("locks")).into_iter().flatten().flatten();
        for entry in entries {
            let path = entry.path();
            let file = File::options().write(true).open(&path);
            if let Ok(file) = file
                && file.try_lock().is_ok()
                && is_at(&file, &path)
            {
                drop(Claim { path, _file: Some(file) });
            }
        }
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        // While the lock is held: see the top of the file.
        let _ = std::fs::remove_file(&self.path);
    }
}

/// Whether the path still names the open file.
#[cfg(unix)]
fn is_at(file: &File, path: &std::path::Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let inode = |metadata: std::io::Result<std::fs::Metadata>| metadata.ok().map(|metadata| metadata.ino());
    let open = inode(file.metadata());
    open.is_some() && open == inode(std::fs::metadata(path))
}

/// Where open files cannot be deleted the name stays with the file.
#[cfg(not(unix))]
fn is_at(_: &File, _: &std::path::Path) -> bool {
    true
}
