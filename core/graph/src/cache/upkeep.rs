//! Looking after a cache: what is in it, how much room it takes, and whether all of it is whole.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use serde::Serialize;

use crate::digest::Digest;

use super::{Cache, Output, Record};

/// One record, with when it was last used.
#[derive(Clone, Debug)]
pub struct CacheEntry {
    /// The action key.
    pub key: Digest,
    /// What it says.
    pub record: Record,
    /// The kind of node, as the preimage names it.
    pub kind: String,
    /// When a run used it last; when it was made, if no run that is remembered did.
    pub used: SystemTime,
}

/// Room taken.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Usage {
    /// Records and bytes of artifacts by kind of node; an artifact that several records share counts for the first.
    pub kinds: BTreeMap<String, (u64, u64)>,
    /// Bytes of artifacts that records name.
    pub artifacts: u64,
    /// Bytes of artifacts that no record names.
    pub unused: u64,
    /// Bytes of records.
    pub records: u64,
    /// Bytes of states of unfinished nodes.
    pub checkpoints: u64,
    /// Bytes of everything else: files half written by killed runs, lists of runs, digests of source files.
    pub other: u64,
}

/// What a check of every byte found. Damaged records and artifacts are deleted: the next run that needs them makes
/// them again.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct VerifyReport {
    /// Records read.
    pub records: u64,
    /// Artifacts read.
    pub artifacts: u64,
    /// Bytes of artifacts read.
    pub bytes: u64,
    /// Records whose text was damaged.
    pub damaged_records: Vec<Digest>,
    /// Artifacts whose bytes did not have their digest.
    pub damaged_artifacts: Vec<Digest>,
    /// Records some of whose artifacts are not there; their nodes will run again.
    pub incomplete_records: u64,
}

/// A file of a sharded folder: its digest, path, size and time.
pub(crate) struct Stored {
    pub digest: Digest,
    pub path: PathBuf,
    pub size: u64,
    pub modified: SystemTime,
}

impl Usage {
    /// Bytes in all.
    pub fn total(&self) -> u64 {
        self.artifacts + self.unused + self.records + self.checkpoints + self.other
    }
}

impl CacheEntry {
    /// Bytes of its artifacts.
    pub fn size(&self) -> u64 {
        self.record.outputs.values().map(|output| output.size).sum()
    }
}

impl Cache {
    /// All files of a sharded folder.
    pub(crate) fn stored(&self, folder: &str) -> Vec<Stored> {
        let shards = std::fs::read_dir(self.root.join(folder)).into_iter().flatten().flatten();
        let files = shards.flat_map(|shard| std::fs::read_dir(shard.path()).into_iter().flatten().flatten());
        let stored = files.filter_map(|entry| {
            let (path, metadata) = (entry.path(), entry.metadata().ok()?);
            let digest = blake3::Hash::from_hex(path.file_stem()?.to_str()?).ok()?.into();
            let modified = metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH);
            Some(Stored { digest, path, size: metadata.len(), modified })
        });
        stored.collect()
    }

    /// All readable records, the latest used first.
    pub fn entries(&self) -> Vec<CacheEntry> {
        let mut used: HashMap<Digest, SystemTime> = HashMap::new();
        for run in self.used_keys() {
            for key in run.keys {
                let time = used.entry(key).or_insert(run.used);
                *time = run.used.max(*time);
            }
        }
        let entry = |stored: Stored| {
            let record = self.recorded(&stored.digest)?;
            let kind = kind_of(&record.preimage);
            let used = used.get(&stored.digest).copied().unwrap_or(stored.modified);
            Some(CacheEntry { key: stored.digest, record, kind, used })
        };
        let mut entries: Vec<CacheEntry> = self.stored("actions").into_iter().filter_map(entry).collect();
        entries.sort_by(|a, b| b.used.cmp(&a.used).then(a.key.cmp(&b.key)));
        entries
    }

    /// Median seconds that a node of each kind ran, as far as the cache remembers.
    pub fn typical_seconds(&self) -> BTreeMap<String, f64> {
        let mut times: BTreeMap<String, Vec<f64>> = BTreeMap::new();
        for entry in self.entries() {
            times.entry(entry.kind).or_default().push(entry.record.seconds);
        }
        let median = |mut times: Vec<f64>| {
            times.sort_by(f64::total_cmp);
            times[times.len() / 2]
        };
        times.into_iter().map(|(kind, times)| (kind, median(times))).collect()
    }

    /// How much room the cache takes, and what for.
    pub fn usage(&self) -> Usage {
        let mut usage = Usage::default();
        let sizes: HashMap<Digest, u64> =
            self.stored("artifacts").into_iter().map(|stored| (stored.digest, stored.size)).collect();
        let mut counted = BTreeSet::new();
        for entry in self.entries() {
            let kind = usage.kinds.entry(entry.kind).or_default();
            kind.0 += 1;
            for Output { digest, .. } in entry.record.outputs.values() {
                if counted.insert(*digest) {
                    let size = sizes.get(digest).copied().unwrap_or(0);
                    kind.1 += size;
                    usage.artifacts += size;
                }
            }
        }
        usage.unused = sizes.values().sum::<u64>() - usage.artifacts;
        let sum = |folder| self.stored(folder).iter().map(|stored| stored.size).sum();
        (usage.records, usage.checkpoints) = (sum("actions"), sum("checkpoints"));
        let flat = ["tmp", "runs", "locks"].iter().map(|folder| flat_size(&self.root.join(folder))).sum::<u64>();
        usage.other = flat + sum("sources");
        usage
    }

    /// Reads everything and compares it with its digest; deletes what is damaged.
    pub fn verify(&self) -> VerifyReport {
        let mut report = VerifyReport::default();
        for stored in self.stored("artifacts") {
            report.artifacts += 1;
            report.bytes += stored.size;
            if !matches!(self.open_verified(&stored.digest), Ok(Some(_))) {
                report.damaged_artifacts.push(stored.digest);
            }
        }
        for stored in self.stored("actions") {
            report.records += 1;
            let record = self.recorded(&stored.digest);
            let whole = record.as_ref().is_some_and(|record| Digest::of(record.preimage.as_bytes()) == stored.digest);
            if !whole {
                let _ = std::fs::remove_file(&stored.path);
                report.damaged_records.push(stored.digest);
            } else if self.record(&stored.digest).is_none() {
                report.incomplete_records += 1;
            }
        }
        report.damaged_artifacts.sort();
        report.damaged_records.sort();
        report
    }
}

/// Bytes of the files in a folder without folders.
fn flat_size(folder: &Path) -> u64 {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.filter_map(|entry| entry.metadata().ok()).map(|metadata| metadata.len()).sum()
}

/// The kind of node a preimage names.
fn kind_of(preimage: &str) -> String {
    #[derive(serde::Deserialize)]
    struct Kind {
        kind: String,
    }
    serde_json::from_str::<Kind>(preimage).map_or_else(|_| "unknown".to_owned(), |found| found.kind)
}
