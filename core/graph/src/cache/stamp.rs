//! What a file looks like from outside: inode and change time, which a program cannot set back.

use std::fs::Metadata;

use serde::{Deserialize, Serialize};

/// Inode, and change time in seconds and nanoseconds. Two equal stamps of one path mean nobody wrote to the file, short
/// of turning the clock back or writing to the disk itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Stamp([i64; 3]);

impl Stamp {
    #[cfg(unix)]
    pub fn of(metadata: &Metadata) -> Self {
        use std::os::unix::fs::MetadataExt;
        Self([metadata.ino() as i64, metadata.ctime(), metadata.ctime_nsec()])
    }

    /// Elsewhere the modification time has to do.
    #[cfg(not(unix))]
    pub fn of(metadata: &Metadata) -> Self {
        let age = metadata.modified().ok().and_then(|time| time.duration_since(std::time::UNIX_EPOCH).ok());
        let age = age.unwrap_or_default();
        Self([0, age.as_secs() as i64, i64::from(age.subsec_nanos())])
    }
}
