//! One computation at a time for each key, over all threads and processes that share a cache.
//!
//! A claim is an exclusive lock on one of 4096 files, chosen by the key. The system drops it with the process that holds
//! it, so a killed run claims nothing. The files stay: file systems are slow to make files where many were just deleted.
//! Two keys that share a file wait for each other, which is rare and harms nobody: whoever holds a claim waits for no
//! other. Where the file system has no locks nothing is claimed, and two runs may do the same work twice with the same
//! result.

use std::fs::{File, TryLockError};

use crate::digest::Digest;

use super::{Cache, CacheError, io};

/// Hexadecimal digits of the key that choose the file.
const DIGITS: usize = 3;

/// The right to compute a key, until dropped: closing the file ends the lock.
#[derive(Debug)]
pub(crate) struct Claim {
    _file: File,
}

impl Cache {
    /// Claims a key; nothing while someone else has it.
    ///
    /// # Errors
    /// When the lock's file cannot be made.
    pub(crate) fn try_claim(&self, key: &Digest) -> Result<Option<Claim>, CacheError> {
        let folder = self.root.join("locks");
        let path = folder.join(&key.to_string()[..DIGITS]);
        let open = || File::options().create(true).write(true).truncate(false).open(&path);
        let file = match open() {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                std::fs::create_dir_all(&folder).map_err(io("make", &folder))?;
                open()
            }
            opened => opened,
        }
        .map_err(io("write", &path))?;
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => Ok(None),
            Ok(()) | Err(TryLockError::Error(_)) => Ok(Some(Claim { _file: file })),
        }
    }
}
