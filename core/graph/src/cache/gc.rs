//! Making room: what no wanted run uses goes, while other runs may go on.
//!
//! Always holds: what a running run has used or made so far stays. What it looks up at the very moment it is deleted
//! counts as damaged, and is made again; no run fails and no result changes.

use std::collections::{HashMap, HashSet};
use std::time::{Duration, SystemTime};

use serde::Serialize;

use crate::digest::Digest;

use super::ledger::UsedKeys;
use super::upkeep::Stored;
use super::{Cache, Record};

/// What to keep. With neither limit only leftovers go: artifacts that no record names, states and files of killed runs.
#[derive(Clone, Copy, Debug, Default)]
pub struct GcOptions {
    /// Keep what the last so many runs used, and drop the rest.
    pub keep_runs: Option<usize>,
    /// Drop the longest unused until what is left takes at most so many bytes.
    pub max_bytes: Option<u64>,
    /// Only say what would go.
    pub dry_run: bool,
}

/// What went.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct GcReport {
    /// Records kept.
    pub kept_records: u64,
    /// Bytes of artifacts kept.
    pub kept_bytes: u64,
    /// Records dropped.
    pub dropped_records: u64,
    /// Artifacts dropped.
    pub dropped_artifacts: u64,
    /// Bytes freed.
    pub dropped_bytes: u64,
    /// How long it took to make what was dropped.
    pub dropped_seconds: f64,
}

/// A record under judgement.
struct Candidate {
    stored: Stored,
    record: Record,
    /// Place among the runs, the latest first; past the last when no run remembers it.
    run: usize,
    /// A running run uses it, or made it.
    pinned: bool,
}

/// Files are stamped by a clock that stands still for up to this long: what a run wrote just after it began may carry a
/// time just before.
const TICK: Duration = Duration::from_millis(10);

impl Cache {
    /// Drops what `options` do not keep.
    pub fn gc(&self, options: &GcOptions) -> GcReport {
        let started = SystemTime::now();
        let runs = self.used_keys();
        let active_since = runs.iter().filter(|run| run.active).map(began).min().unwrap_or(started);
        let active_since = active_since.checked_sub(TICK).unwrap_or(active_since);
        let mut candidates = self.candidates(&runs, active_since);
        // The longest unused first; of one run's, what is quickest to make again for its size.
        candidates.sort_by(|a, b| b.run.cmp(&a.run).then_with(|| worth(a).total_cmp(&worth(b))));
        let blobs = self.stored("artifacts");
        let sizes: HashMap<Digest, u64> = blobs.iter().map(|blob| (blob.digest, blob.size)).collect();
        let mut references: HashMap<Digest, u32> = HashMap::new();
        for output in candidates.iter().flat_map(|candidate| candidate.record.outputs.values()) {
            *references.entry(output.digest).or_default() += 1;
        }
        let size = |digest: &Digest| sizes.get(digest).copied().unwrap_or(0);
        let mut kept_bytes: u64 = references.keys().map(&size).sum();
        let mut report = GcReport::default();
        for candidate in &candidates {
            let beyond_runs = options.keep_runs.is_some_and(|keep| candidate.run >= keep);
            let beyond_size = options.max_bytes.is_some_and(|most| kept_bytes > most);
            if candidate.pinned || !(beyond_runs || beyond_size) {
                report.kept_records += 1;
                continue;
            }
            for output in candidate.record.outputs.values() {
                if let Some(count) = references.get_mut(&output.digest) {
                    *count -= 1;
                    if *count == 0 {
                        kept_bytes -= size(&output.digest);
                    }
                }
            }
            report.dropped_records += 1;
            report.dropped_seconds += candidate.record.seconds;
            remove(&candidate.stored, options);
        }
        for blob in &blobs {
            let named = references.get(&blob.digest).is_some_and(|count| *count > 0);
            if !named && blob.modified < active_since {
                report.dropped_artifacts += 1;
                report.dropped_bytes += blob.size;
                remove(blob, options);
            }
        }
        report.kept_bytes = kept_bytes;
        if !options.dry_run {
            self.drop_leftovers(&runs, options, active_since);
        }
        report
    }

    fn candidates(&self, runs: &[UsedKeys], active_since: SystemTime) -> Vec<Candidate> {
        let mut last: HashMap<Digest, usize> = HashMap::new();
        let mut pinned = HashSet::new();
        // Runs that go on do not use up the number of runs to keep.
        let active = runs.iter().filter(|run| run.active).count();
        for (at, run) in runs.iter().enumerate() {
            for key in &run.keys {
                last.entry(*key).or_insert(at.saturating_sub(active));
                if run.active {
                    pinned.insert(*key);
                }
            }
        }
        let candidate = |stored: Stored| {
            let record = self.recorded(&stored.digest)?;
            let run = last.get(&stored.digest).copied().unwrap_or(usize::MAX);
            let pinned = pinned.contains(&stored.digest) || stored.modified >= active_since;
            Some(Candidate { stored, record, run, pinned })
        };
        self.stored("actions").into_iter().filter_map(candidate).collect()
    }

    /// Files of killed runs, states of nodes nobody runs, lists of runs that are not kept.
    fn drop_leftovers(&self, runs: &[UsedKeys], options: &GcOptions, active_since: SystemTime) {
        for state in self.stored("checkpoints").iter().filter(|state| state.modified < active_since) {
            // A node on its way holds its claim.
            if matches!(self.try_claim(&state.digest), Ok(Some(_))) {
                let _ = std::fs::remove_file(&state.path);
            }
        }
        for entry in std::fs::read_dir(self.temporary()).into_iter().flatten().flatten() {
            let modified = entry.metadata().and_then(|metadata| metadata.modified());
            if modified.is_ok_and(|time| time < active_since) {
                let _ = std::fs::remove_file(entry.path());
            }
        }
        let finished = runs.iter().filter(|run| !run.active);
        for run in finished.skip(options.keep_runs.unwrap_or(usize::MAX)) {
            let _ = std::fs::remove_file(&run.path);
        }
    }
}

/// Since when a run may have made things.
fn began(run: &UsedKeys) -> SystemTime {
    let created = std::fs::metadata(&run.path).and_then(|metadata| metadata.created());
    created.unwrap_or(SystemTime::UNIX_EPOCH)
}

/// Seconds of work that each byte saves.
fn worth(candidate: &Candidate) -> f64 {
    let bytes: u64 = candidate.record.outputs.values().map(|output| output.size).sum();
    candidate.record.seconds / bytes.max(1) as f64
}

fn remove(stored: &Stored, options: &GcOptions) {
    if !options.dry_run {
        // What stays is only not freed.
        let _ = std::fs::remove_file(&stored.path);
    }
}
