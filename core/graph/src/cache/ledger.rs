//! Which keys each run used, so that old runs' results can be told from those still wanted.
//!
//! `runs/FINGERPRINT.keys` holds the keys of the last run of that fingerprint, 32 bytes each; its time is the time of
//! use. While a run goes on its file is `FINGERPRINT-NONCE.part` and locked; a killed run leaves it unlocked, and it
//! counts like a finished one.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::SystemTime;

use crate::digest::Digest;

use super::Cache;

/// Bytes of a key.
const KEY: usize = 32;

/// The list of keys of a run that goes on.
#[derive(Debug)]
pub(crate) struct Ledger {
    file: BufWriter<File>,
    part: PathBuf,
    finished: PathBuf,
}

/// A run's list, read back.
pub(super) struct UsedKeys {
    pub path: PathBuf,
    pub used: SystemTime,
    /// The run goes on.
    pub active: bool,
    pub keys: Vec<Digest>,
}

impl Cache {
    /// Opens the list of a run; without one the run only loses its say in what is kept.
    pub(crate) fn ledger(&self, fingerprint: &Digest) -> Option<Ledger> {
        static NONCE: AtomicU32 = AtomicU32::new(0);
        let folder = self.root.join("runs");
        let nonce = NONCE.fetch_add(1, Ordering::Relaxed);
        let part = folder.join(format!("{fingerprint}-{}-{nonce}.part", std::process::id()));
        let create = || File::create(&part);
        let file = create().or_else(|_| std::fs::create_dir_all(&folder).and_then(|()| create())).ok()?;
        // Unlocked, it is only kept less surely.
        let _ = file.try_lock();
        let finished = folder.join(format!("{fingerprint}.keys"));
        Some(Ledger { file: BufWriter::new(file), part, finished })
    }

    /// All runs' lists, the latest used first.
    pub(super) fn used_keys(&self) -> Vec<UsedKeys> {
        let entries = std::fs::read_dir(self.root.join("runs")).into_iter().flatten().flatten();
        let mut found: Vec<UsedKeys> = entries.filter_map(|entry| read(entry.path())).collect();
        found.sort_by(|a, b| (b.active, b.used).cmp(&(a.active, a.used)).then_with(|| a.path.cmp(&b.path)));
        found
    }
}

fn read(path: PathBuf) -> Option<UsedKeys> {
    let file = File::options().read(true).write(true).open(&path).ok()?;
    let active = path.extension().is_some_and(|extension| extension == "part") && file.try_lock().is_err();
    let used = file.metadata().and_then(|metadata| metadata.modified()).unwrap_or(SystemTime::UNIX_EPOCH);
    let bytes = std::fs::read(&path).ok()?;
    let keys = bytes.as_chunks::<KEY>().0.iter().map(|key| Digest::from(*key)).collect();
    Some(UsedKeys { path, used, active, keys })
}

impl Ledger {
    /// Notes that the run uses a key.
    pub fn note(&mut self, key: &Digest) {
        let _ = self.file.write_all(key.as_bytes());
    }

    /// Makes what was noted known to other processes.
    pub fn publish(&mut self) {
        let _ = self.file.flush();
    }

    /// The run is over.
    pub fn finish(mut self) {
        self.publish();
        let _ = std::fs::rename(&self.part, &self.finished);
    }
}
