//! The artifact cache on disk: action key → record of output digests, digest → bytes.
//!
//! Always holds: a file under its final name was written whole and renamed into place; bytes are checked against their
//! digest whenever they are read, and dropped when they differ, so that damage costs a recomputation and nothing else.
//! No file is synced: after a power cut a torn file is found by its size or digest. Processes may share a cache.
//!
//! A hit is not read, only looked at: its record remembers inode and change time of each file as it was stored. Where
//! they differ the bytes are digested again before they count, so that a file changed behind the cache's back, even with
//! its size and modification time restored, is found at the next run.

mod checkpoints;
mod claim;
mod gc;
mod ledger;
mod sources;
mod stamp;
mod upkeep;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use serde::{Deserialize, Serialize};

use crate::digest::Digest;

pub use gc::{GcOptions, GcReport};
pub use upkeep::{CacheEntry, Usage, VerifyReport};

pub(crate) use claim::Claim;
pub(crate) use ledger::Ledger;

use stamp::Stamp;

/// Abandoned temporary files older than this are swept.
const STALE: Duration = Duration::from_secs(24 * 3600);
/// Files are compared in pieces of this many bytes.
const PIECE: usize = 1 << 16;

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
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Output {
    /// Digest of the bytes.
    pub digest: Digest,
    /// Number of bytes.
    pub size: u64,
    /// The file as it was when its bytes were last known to be right.
    #[serde(default)]
    stamp: Stamp,
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
        source: io::Error,
    },
    /// A record could not be expressed.
    #[error("the cache cannot write a record: {0}")]
    Json(#[from] serde_json::Error),
}

fn io(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> CacheError {
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
        self.root.join(format!("{kind}/{}/{name}.{extension}", &name[..2]))
    }

    /// Where the bytes of a digest lie, if they are there. For Python: a `safetensors` file.
    pub fn blob_path(&self, digest: &Digest) -> PathBuf {
        self.sharded("artifacts", digest, "safetensors")
    }

    fn record_path(&self, key: &Digest) -> PathBuf {
        self.sharded("actions", key, "jsonl")
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

    /// Writes a file beside its place and renames it into it; what cannot be written whole is not there at all.
    fn write(&self, path: &Path, parts: &[&[u8]]) -> Result<(), CacheError> {
        let temporary = self.temporary();
        let mut builder = tempfile::Builder::new();
        readable(&mut builder);
        let mut file = match builder.tempfile_in(&temporary) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                std::fs::create_dir_all(&temporary).map_err(io("make", &temporary))?;
                builder.tempfile_in(&temporary)
            }
            made => made,
        }
        .map_err(io("write in", &temporary))?;
        parts.iter().try_for_each(|part| file.write_all(part)).map_err(io("write", path))?;
        let Err(refused) = file.persist(path) else { return Ok(()) };
        if refused.error.kind() != io::ErrorKind::NotFound {
            return Err(io("write", path)(refused.error));
        }
        let folder = path.parent().unwrap_or(&self.root);
        std::fs::create_dir_all(folder).map_err(io("make", folder))?;
        refused.file.persist(path).map_err(|error| io("write", path)(error.error))?;
        Ok(())
    }

    /// The record of a key, if all its outputs are present and, as far as their files tell, unchanged.
    pub fn record(&self, key: &Digest) -> Option<Record> {
        let mut record = self.recorded(key)?;
        let mut moved = false;
        for output in record.outputs.values_mut() {
            let path = self.blob_path(&output.digest);
            let metadata = std::fs::metadata(&path).ok()?;
            if metadata.len() != output.size {
                return None;
            }
            let stamp = Stamp::of(&metadata);
            if stamp != output.stamp {
                // Copied, restored or tampered with: the bytes decide.
                self.open_verified(&output.digest).ok()??;
                (output.stamp, moved) = (stamp, true);
            }
        }
        if moved {
            // Only so that the next run need not look again.
            let _ = self.put_record(key, &record);
        }
        Some(record)
    }

    /// The record of a key, whether or not its outputs are still here.
    pub fn recorded(&self, key: &Digest) -> Option<Record> {
        let path = self.record_path(key);
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
        let head = serde_json::to_string(record)?;
        self.write(&self.record_path(key), &[head.as_bytes(), b"\n", record.preimage.as_bytes()])
    }

    /// Stores the bytes of pieces, joined, under their digest. A file that holds them already stays as it is.
    ///
    /// # Errors
    /// When the folder cannot be written.
    pub fn put(&self, pieces: &[&[u8]]) -> Result<Output, CacheError> {
        let digest = Digest::of_pieces(pieces.iter().copied());
        let size = pieces.iter().map(|piece| piece.len() as u64).sum();
        let path = self.blob_path(&digest);
        if !holds(&path, pieces, size).unwrap_or(false) {
            self.write(&path, pieces)?;
        }
        let stamp = std::fs::metadata(&path).map(|metadata| Stamp::of(&metadata)).unwrap_or_default();
        Ok(Output { digest, size, stamp })
    }

    /// The file of a digest, its bytes verified and to be read from the start; a damaged one is deleted and counts as
    /// absent. However large it is, little of it is in memory at once.
    ///
    /// # Errors
    /// When it is there and cannot be read.
    pub fn open_verified(&self, digest: &Digest) -> Result<Option<File>, CacheError> {
        let path = self.blob_path(digest);
        let mut file = match File::open(&path) {
            Ok(file) => file,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(io("read", &path)(error)),
        };
        if Digest::of_rest(&file).map_err(io("read", &path))? == *digest {
            file.rewind().map_err(io("read", &path))?;
            return Ok(Some(file));
        }
        self.forget(digest);
        Ok(None)
    }

    /// Deletes the bytes of a digest, so that whoever needs them recomputes them.
    pub fn forget(&self, digest: &Digest) {
        let _ = std::fs::remove_file(self.blob_path(digest));
    }
}

/// Whether the file holds exactly these bytes, so many in all.
fn holds(path: &Path, pieces: &[&[u8]], size: u64) -> io::Result<bool> {
    let mut file = File::open(path)?;
    if file.metadata()?.len() != size {
        return Ok(false);
    }
    let mut piece = vec![0; PIECE];
    for expected in pieces.iter().flat_map(|piece| piece.chunks(PIECE)) {
        let piece = &mut piece[..expected.len()];
        file.read_exact(piece)?;
        if piece != expected {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Temporary files are the owner's alone; those of a cache are for whoever may read the folder.
#[cfg(unix)]
fn readable(builder: &mut tempfile::Builder<'_, '_>) {
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
}

#[cfg(not(unix))]
fn readable(_: &mut tempfile::Builder<'_, '_>) {}
