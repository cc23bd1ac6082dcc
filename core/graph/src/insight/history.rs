//! What the cache remembers of earlier work: every record with its time, and how two keys differ.
//!
//! Records are compared by their preimages, field by field; nothing here reads an artifact.

use std::collections::HashMap;
use std::time::SystemTime;

use serde::Serialize;
use serde_json::Value;

use crate::cache::{Cache, Record};
use crate::digest::Digest;

/// Of one kind, only so many records, the latest, are compared.
const CANDIDATES: usize = 1000;

/// One remembered piece of work.
#[derive(Clone, Debug)]
pub struct Entry {
    /// Its action key.
    pub key: Digest,
    /// When it was finished.
    pub made: SystemTime,
    /// The record.
    pub record: Record,
    /// The key's preimage, parsed.
    pub fields: Value,
}

/// One field in which two keys differ.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Change {
    /// `params.heart_rate_bpm`, `inputs.clip[0]`, `revision`.
    pub field: String,
    /// What it was; nothing when it was not there.
    pub from: Option<Value>,
    /// What it is; nothing when it is no longer there.
    pub to: Option<Value>,
}

impl Change {
    /// The parameter it is about, if it is about one.
    pub fn parameter(&self) -> Option<&str> {
        let rest = self.field.strip_prefix("params.").or(self.field.strip_prefix("sources."))?;
        rest.split(['.', '[']).next()
    }

    /// The digests of an input, before and after, if it is one that changed.
    pub fn input(&self) -> Option<(Digest, Digest)> {
        self.field.strip_prefix("inputs.")?;
        let digest = |value: &Option<Value>| serde_json::from_value::<Digest>(value.clone()?).ok();
        Some((digest(&self.from)?, digest(&self.to)?))
    }
}

/// All records of a cache.
#[derive(Debug, Default)]
pub struct History {
    entries: Vec<Entry>,
    by_kind: HashMap<String, Vec<usize>>,
    by_key: HashMap<Digest, usize>,
    by_output: HashMap<Digest, Vec<usize>>,
}

impl History {
    /// Reads all records; what cannot be read is left out.
    pub fn read(cache: &Cache) -> Self {
        let mut history = Self::default();
        for stored in cache.stored("actions") {
            let (key, made) = (stored.digest, stored.modified);
            let Some(record) = cache.recorded(&key) else { continue };
            let Ok(fields) = serde_json::from_str::<Value>(&record.preimage) else { continue };
            history.entries.push(Entry { key, made, record, fields });
        }
        history.entries.sort_by_key(|entry| (std::cmp::Reverse(entry.made), entry.key));
        for (index, entry) in history.entries.iter().enumerate() {
            let kind = entry.fields["kind"].as_str().unwrap_or_default().to_owned();
            history.by_kind.entry(kind).or_default().push(index);
            history.by_key.insert(entry.key, index);
            for output in entry.record.outputs.values() {
                history.by_output.entry(output.digest).or_default().push(index);
            }
        }
        history
    }

    /// How many records there are.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// The record of a key.
    pub fn get(&self, key: &Digest) -> Option<&Entry> {
        self.by_key.get(key).map(|index| &self.entries[*index])
    }

    /// The earlier record of that kind that differs in the fewest fields from a preimage, the latest of equals; and the
    /// differences. `until` leaves out what was made later, and the preimage's own record is left out too. Two short runs
    /// may finish within one tick of the file system's clock, so what was made at the same time counts as earlier.
    pub fn nearest(&self, kind: &str, fields: &Value, until: Option<SystemTime>) -> Option<(&Entry, Vec<Change>)> {
        let earlier = |index: &&usize| until.is_none_or(|until| self.entries[**index].made <= until);
        let candidates = self.by_kind.get(kind)?.iter().filter(earlier).take(CANDIDATES);
        let compared = candidates.map(|index| (&self.entries[*index], changes(&self.entries[*index].fields, fields)));
        compared.filter(|(_, changes)| !changes.is_empty()).min_by_key(|(_, changes)| changes.len())
    }

    /// The record that wrote some bytes and differs in the fewest fields from a preimage; and the differences.
    pub fn writer(&self, digest: &Digest, fields: &Value) -> Option<(&Entry, Vec<Change>)> {
        let writers = self.by_output.get(digest)?.iter().take(CANDIDATES);
        let compared = writers.map(|index| (&self.entries[*index], changes(&self.entries[*index].fields, fields)));
        compared.filter(|(_, changes)| !changes.is_empty()).min_by_key(|(_, changes)| changes.len())
    }

    /// How long a node of that kind took with the parameters nearest to these, in seconds.
    pub fn seconds(&self, kind: &str, params: &serde_json::Map<String, Value>) -> Option<f64> {
        let candidates = self.by_kind.get(kind)?.iter().take(CANDIDATES).map(|index| &self.entries[*index]);
        let misses = |entry: &&Entry| {
            let known = entry.fields["params"].as_object();
            known.map_or(usize::MAX, |known| {
                known.iter().filter(|(name, value)| params.get(*name) != Some(value)).count()
            })
        };
        candidates.min_by_key(misses).map(|entry| entry.record.seconds)
    }
}

/// Field by field, how `from` became `to`.
pub fn changes(from: &Value, to: &Value) -> Vec<Change> {
    let mut found = Vec::new();
    compare("", (Some(from), Some(to)), &mut found);
    found
}

/// Depth is bounded by the JSON reader's limit.
fn compare(field: &str, (from, to): (Option<&Value>, Option<&Value>), found: &mut Vec<Change>) {
    match (from, to) {
        (Some(Value::Object(old)), Some(Value::Object(new))) => {
            let mut names: Vec<&String> = old.keys().chain(new.keys()).collect();
            names.sort();
            names.dedup();
            for name in names {
                let inner = if field.is_empty() { name.clone() } else { format!("{field}.{name}") };
                compare(&inner, (old.get(name), new.get(name)), found);
            }
        }
        // Values of a parameter are shown whole; lists of digests one by one.
        (Some(Value::Array(old)), Some(Value::Array(new))) if !field.starts_with("params.") => {
            for index in 0..old.len().max(new.len()) {
                compare(&format!("{field}[{index}]"), (old.get(index), new.get(index)), found);
            }
        }
        (from, to) if from != to => {
            found.push(Change { field: field.to_owned(), from: from.cloned(), to: to.cloned() });
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn changes_name_the_field_and_both_values() {
        let old = json!({"kind": "A", "params": {"x": 1, "list": [1, 2]}, "inputs": {"in": ["aa", "bb"]}, "seed": 0});
        let new =
            json!({"kind": "A", "params": {"x": 2, "list": [1, 3], "y": true}, "inputs": {"in": ["aa"]}, "seed": 0});
        let found: Vec<(String, Option<Value>, Option<Value>)> =
            changes(&old, &new).into_iter().map(|change| (change.field, change.from, change.to)).collect();
        let expected = [
            ("inputs.in[1]".to_owned(), Some(json!("bb")), None),
            ("params.list".to_owned(), Some(json!([1, 2])), Some(json!([1, 3]))),
            ("params.x".to_owned(), Some(json!(1)), Some(json!(2))),
            ("params.y".to_owned(), None, Some(json!(true))),
        ];
        assert_eq!(found, expected);
        assert_eq!(changes(&old, &old), []);
    }
}
