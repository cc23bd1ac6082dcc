//! The artifact cache on disk: action key → record of output digests, digest → bytes.
//!
//! Always holds: a file under its final name was written whole and renamed into place; bytes are checked against their
//! digest whenever they are read, and dropped when they differ, so that damage costs a recomputation and nothing else.
//! No file is synced: after a power cut a torn file is found by its size or digest. Processes may share a cache.

mod sources;

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use crate::digest::Digest;
use serde::{Deserialize, Serialize};

/// Abandoned temporary files older than this are swept.
const STALE: Duration = Duration::from_secs(24 * 3600);

/// A cache folder.
#[derive(Clone, Debug)]
pub struct Cache {
    root: PathBuf,
}

/// What a node made, and what its key was made of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Outputs by port; optional outputs that were not written are absent.
    pub outputs: BTreeMap<String, Output>,
    /// What the node told the user.
    pub warnings: Vec<String>,
    /// How long it ran.
    pub seconds: f64,
    /// What the key is the digest of, a JSON text, to explain hits and misses.
    #[serde(skip)]
    pub preimage: String,
}

/// One output.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Output {
    /// Digest of the bytes.
    pub digest: Digest,
    /// Number of bytes.
    pub size: u64,
}

/// What can go wrong with the cache folder itself. Damaged content is not an error: it is recomputed.
#[derive(Debug, thiserror::Error, miette::Diagnostic)]
#[non_exhaustive]
pub enum CacheError {
    /// The system refused.
    #[error("the cache cannot {action} `{path}`: {source}")]
    #[diagnostic(help("check free space and permissions, or choose another folder with --cache DIR"))]
    Io {
        /// What was tried.
        action: &'static str,
        /// On which file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A record could not be expressed.
    #[error("the cache cannot write a record: {0}")]
    Json(#[from] serde_json::Error),
}

fn io(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> CacheError {
    let path = path.to_owned();
    move |source| CacheError::Io { action, path, source }
}

impl Cache {
    /// Opens or makes the folder.
    ///
    /// # Errors
    /// When it cannot be made.
    pub fn open(root: &Path) -> Result<Self, CacheError> {
        let cache = Self { root: root.to_owned() };
        let temporary = cache.temporary();
        std::fs::create_dir_all(&temporary).map_err(io("make", &temporary))?;
        cache.sweep();
        Ok(cache)
    }

    /// The folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    fn temporary(&self) -> PathBuf {
        self.root.join("tmp")
    }

    fn sharded(&self, kind: &str, digest: &Digest, extension: &str) -> PathBuf {
        let name = digest.to_string();
        self.root.join(kind).join(&name[..2]).join(format!("{name}.{extension}"))
    }

    /// Where the bytes of a digest lie, if they are there. For Python: a `safetensors` file.
    pub fn blob_path(&self, digest: &Digest) -> PathBuf {
        self.sharded("artifacts", digest, "safetensors")
    }

    /// Removes what killed runs left behind; a failure to do so harms nobody.
    fn sweep(&self) {
        let Ok(entries) = std::fs::read_dir(self.temporary()) else { return };
        for entry in entries.flatten() {
            let modified = entry.metadata().and_then(|metadata| metadata.modified());
            let age = modified.ok().and_then(|time| SystemTime::now().duration_since(time).ok());
            if age.is_some_and(|age| age > STALE) {
                let _ = std::fs::remove_file(entry.path());
            }
        }
    }

    fn write(&self, path: &Path, bytes: &[u8]) -> Result<(), CacheError> {
        let folder = path.parent().unwrap_or(&self.root);
        std::fs::create_dir_all(folder).map_err(io("make", folder))?;
        let temporary = self.temporary();
        std::fs::create_dir_all(&temporary).map_err(io("make", &temporary))?;
        let mut file = tempfile::NamedTempFile::new_in(&temporary).map_err(io("write in", &temporary))?;
        file.write_all(bytes).map_err(io("write", path))?;
        file.persist(path).map_err(|error| io("write", path)(error.error))?;
        Ok(())
    }

    /// The record of a key, if all its outputs are present in their full size.
    pub fn record(&self, key: &Digest) -> Option<Record> {
        let present = |output: &Output| {
            std::fs::metadata(self.blob_path(&output.digest)).is_ok_and(|metadata| metadata.len() == output.size)
        };
        self.recorded(key).filter(|record| record.outputs.values().all(present))
    }

    /// The record of a key, whether or not its outputs are still here.
    pub fn recorded(&self, key: &Digest) -> Option<Record> {
        let path = self.sharded("actions", key, "jsonl");
        let text = std::fs::read_to_string(&path).ok()?;
        let read = || {
            let (head, preimage) = text.split_once('\n')?;
            let record: Record = serde_json::from_str(head).ok()?;
            Some(Record { preimage: preimage.to_owned(), ..record })
        };
        let record = read();
        if record.is_none() {
            let _ = std::fs::remove_file(&path);
        }
        record
    }

    /// Stores a record: one line of JSON, then the preimage, whose digest is the key. Its outputs must be stored first,
    /// so that no reader sees it without them.
    ///
    /// # Errors
    /// When the folder cannot be written.
    pub fn put_record(&self, key: &Digest, record: &Record) -> Result<(), CacheError> {
        let mut text = serde_json::to_string(record)?;
        text.push('\n');
        text.push_str(&record.preimage);
        self.write(&self.sharded("actions", key, "jsonl"), text.as_bytes())
    }

    /// Stores bytes under their digest.
    ///
    /// # Errors
    /// When the folder cannot be written.
    pub fn put_bytes(&self, bytes: &[u8]) -> Result<Output, CacheError> {
        let output = Output { digest: Digest::of(bytes), size: bytes.len() as u64 };
        // Written even if a file of that name exists: it may be damaged, and this heals it.
        self.write(&self.blob_path(&output.digest), bytes)?;
        Ok(output)
    }

    /// The bytes of a digest, verified; damaged ones are deleted and count as absent.
    ///
    /// # Errors
    /// When they are there and cannot be read.
    pub fn bytes(&self, digest: &Digest) -> Result<Option<Vec<u8>>, CacheError> {
        let path = self.blob_path(digest);
        let bytes = match std::fs::read(&path) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(io("read", &path)(error)),
        };
        if Digest::of(&bytes) == *digest {
            return Ok(Some(bytes));
        }
        self.forget(digest);
        Ok(None)
    }

    /// Deletes the bytes of a digest, so that whoever needs them recomputes them.
    pub fn forget(&self, digest: &Digest) {
        let _ = std::fs::remove_file(self.blob_path(digest));
    }
}
