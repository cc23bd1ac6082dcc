//! Digests of source files and folders, remembered by size, time and inode so that reruns do not read them again.

use std::fs::Metadata;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use crate::digest::Digest;

use super::Cache;

/// A file changed this recently may change again within its time stamp's resolution, so its digest is not remembered.
const RACY: Duration = Duration::from_secs(2);
/// Folders are read this deep.
const DEPTH_LIMIT: usize = 16;

#[derive(Serialize, Deserialize)]
struct Memo {
    /// Digest of names, sizes, times and inodes.
    stamp: Digest,
    /// Digest of the content.
    content: Digest,
}

/// One file below a source.
struct Entry {
    /// Path below the source, `/` between parts; empty for the source itself.
    name: String,
    path: PathBuf,
    metadata: Metadata,
}

impl Cache {
    /// The digest of a file's content, or of a folder's file names and contents. Links are followed.
    ///
    /// # Errors
    /// When something cannot be read.
    pub fn source_digest(&self, path: &Path) -> io::Result<Digest> {
        let path = std::fs::canonicalize(path)?;
        let entries = entries(&path)?;
        let stamp = stamp(&entries);
        let memo_path = self.sharded("sources", &Digest::of(path.as_os_str().as_encoded_bytes()), "json");
        let memo = std::fs::read(&memo_path).ok().and_then(|bytes| serde_json::from_slice::<Memo>(&bytes).ok());
        if let Some(memo) = memo.filter(|memo| memo.stamp == stamp) {
            return Ok(memo.content);
        }
        let content = content(&entries)?;
        let settled = |entry: &Entry| {
            let age = entry.metadata.modified().ok().and_then(|time| SystemTime::now().duration_since(time).ok());
            age.is_some_and(|age| age > RACY)
        };
        if entries.iter().all(settled)
            && let Ok(bytes) = serde_json::to_vec(&Memo { stamp, content })
        {
            // Only a memo: without it the next run reads the file again.
            let _ = self.write(&memo_path, &[&bytes]);
        }
        Ok(content)
    }
}

fn entries(root: &Path) -> io::Result<Vec<Entry>> {
    let mut found = Vec::new();
    let mut waiting = vec![(String::new(), root.to_owned(), 0)];
    while let Some((name, path, depth)) = waiting.pop() {
        let metadata = std::fs::metadata(&path)?;
        if !metadata.is_dir() {
            found.push(Entry { name, path, metadata });
            continue;
        }
        if depth >= DEPTH_LIMIT {
            return Err(io::Error::other(format!("`{}` lies deeper than {DEPTH_LIMIT} folders", path.display())));
        }
        for entry in std::fs::read_dir(&path)? {
            let entry = entry?;
            let part = entry.file_name().to_string_lossy().into_owned();
            let below = if name.is_empty() { part } else { format!("{name}/{part}") };
            waiting.push((below, entry.path(), depth + 1));
        }
    }
    found.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(found)
}

#[cfg(unix)]
fn inode(metadata: &Metadata) -> u64 {
    std::os::unix::fs::MetadataExt::ino(metadata)
}

#[cfg(not(unix))]
fn inode(_: &Metadata) -> u64 {
    0
}

fn stamp(entries: &[Entry]) -> Digest {
    let mut hasher = blake3::Hasher::new();
    for entry in entries {
        let modified = entry.metadata.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok());
        let nanoseconds = modified.map_or(0, |time| time.as_nanos());
        hasher.update(&(entry.name.len() as u64).to_le_bytes());
        hasher.update(entry.name.as_bytes());
        hasher.update(&entry.metadata.len().to_le_bytes());
        hasher.update(&nanoseconds.to_le_bytes());
        hasher.update(&inode(&entry.metadata).to_le_bytes());
    }
    hasher.finalize().into()
}

fn content(entries: &[Entry]) -> io::Result<Digest> {
    let mut whole = blake3::Hasher::new();
    let mut buffer = vec![0; 1 << 20];
    for entry in entries {
        let mut hasher = blake3::Hasher::new();
        let mut file = std::fs::File::open(&entry.path)?;
        loop {
            let count = file.read(&mut buffer)?;
            if count == 0 {
                break;
            }
            hasher.update(&buffer[..count]);
        }
        if entry.name.is_empty() {
            return Ok(hasher.finalize().into());
        }
        whole.update(&(entry.name.len() as u64).to_le_bytes());
        whole.update(entry.name.as_bytes());
        whole.update(hasher.finalize().as_bytes());
    }
    Ok(whole.finalize().into())
}
