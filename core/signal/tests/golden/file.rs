//! Reading the golden folder, and comparing against it. Shared by the tests of the crates that have goldens.
#![allow(dead_code, reason = "each of the test binaries uses its part")]

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use serde_json::Value;

/// Result of a test helper.
pub type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// One file of the manifest.
pub struct Entry {
    /// Path within the folder.
    pub file: String,
    tolerance: Value,
    arrays: Vec<String>,
}

/// The golden folder, if there is one.
pub fn folder() -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/golden");
    let folder = std::env::var_os("HEARTIAN_GOLDEN").map_or_else(beside, PathBuf::from);
    folder.join("manifest.json").is_file().then_some(folder)
}

/// The entries of the folder's manifest.
pub fn manifest(folder: &Path) -> Outcome<Vec<Entry>> {
    let manifest: Value = serde_json::from_slice(&std::fs::read(folder.join("manifest.json"))?)?;
    let items = manifest["items"].as_array().ok_or("the manifest has no items")?;
    let entry = |item: &Value| {
        let arrays = item["arrays"].as_object().map(|map| map.keys().cloned().collect()).unwrap_or_default();
        Some(Entry { file: item["file"].as_str()?.to_owned(), tolerance: item["tolerance"].clone(), arrays })
    };
    Ok(items.iter().filter_map(entry).collect())
}

/// An opened file: arrays by name, as f64, with their shapes, and the manifest's tolerances.
pub struct Golden {
    arrays: BTreeMap<String, (Vec<usize>, Vec<f64>)>,
    tolerance: Value,
}

impl Golden {
    /// Reads every array that the manifest names.
    pub fn open(folder: &Path, entry: &Entry) -> Outcome<Self> {
        let mut archive = npyz::npz::NpzArchive::open(folder.join(&entry.file))?;
        let mut arrays = BTreeMap::new();
        for name in &entry.arrays {
            let file = archive.by_name(name)?.ok_or_else(|| format!("{}: no array {name}", entry.file))?;
            let shape = file.shape().iter().map(|size| *size as usize).collect();
            arrays.insert(name.clone(), (shape, values(file)?));
        }
        Ok(Self { arrays, tolerance: entry.tolerance.clone() })
    }

    /// An array's values, row-major.
    pub fn array(&self, name: &str) -> Outcome<&[f64]> {
        Ok(&self.arrays.get(name).ok_or_else(|| format!("no array {name}"))?.1)
    }

    /// An array's sizes, outermost first.
    pub fn shape(&self, name: &str) -> Outcome<&[usize]> {
        Ok(&self.arrays.get(name).ok_or_else(|| format!("no array {name}"))?.0)
    }

    /// The value of a scalar.
    pub fn scalar(&self, name: &str) -> Outcome<f64> {
        Ok(*self.array(name)?.first().ok_or("an empty scalar")?)
    }

    /// Number of arrays `prefix0, prefix1, …`.
    pub fn count(&self, prefix: &str) -> usize {
        (0..).take_while(|k| self.arrays.contains_key(&format!("{prefix}{k}"))).count()
    }

    /// Names of all arrays that start so.
    pub fn names(&self, prefix: &str) -> Vec<&str> {
        self.arrays.keys().filter(|name| name.starts_with(prefix)).map(String::as_str).collect()
    }

    /// What the manifest says of a tolerance in words, by JSON pointer.
    pub fn words(&self, pointer: &str) -> Outcome<&str> {
        let text = self.tolerance.pointer(pointer).and_then(Value::as_str);
        Ok(text.ok_or_else(|| format!("no words at {pointer}"))?)
    }

    /// A tolerance of the manifest, by JSON pointer.
    pub fn tolerance(&self, pointer: &str) -> Outcome<f64> {
        Ok(self.tolerance.pointer(pointer).and_then(Value::as_f64).ok_or_else(|| format!("no tolerance {pointer}"))?)
    }
}

fn values<R: std::io::Read>(file: npyz::NpyFile<R>) -> Outcome<Vec<f64>> {
    let kind = file.dtype().descr();
    Ok(match kind.trim_matches('\'') {
        "<f8" => file.into_vec::<f64>()?,
        "<f4" => file.into_vec::<f32>()?.into_iter().map(f64::from).collect(),
        "<i8" => file.into_vec::<i64>()?.into_iter().map(|value| value as f64).collect(),
        "|u1" => file.into_vec::<u8>()?.into_iter().map(f64::from).collect(),
        other => return Err(format!("array of type {other}").into()),
    })
}

/// Absolute and relative bounds of one comparison.
#[derive(Clone, Copy)]
pub struct Bound {
    /// Allowed regardless of size.
    pub absolute: f64,
    /// Allowed share of the wanted value.
    pub relative: f64,
}

impl Bound {
    /// An absolute bound.
    pub fn absolute(absolute: f64) -> Self {
        Self { absolute, relative: 0.0 }
    }
}

/// The comparisons made of one file.
#[derive(Default)]
pub struct Checks {
    worst: BTreeMap<String, (f64, f64)>,
}

impl Checks {
    /// Compares arrays; NaN equals NaN and infinities equal themselves.
    pub fn close(&mut self, what: &str, got: &[f64], want: &[f64], bound: Bound) {
        let worst = self.worst.entry(what.to_owned()).or_insert((0.0, 0.0));
        if got.len() != want.len() {
            *worst = (f64::INFINITY, f64::INFINITY);
            return;
        }
        for (got, want) in got.iter().zip(want) {
            let same = got == want || (got.is_nan() && want.is_nan());
            let off = if same { 0.0 } else { (got - want).abs() };
            let share = if same { 0.0 } else { off / (bound.absolute + bound.relative * want.abs()) };
            let share = if share.is_nan() { f64::INFINITY } else { share };
            *worst = (worst.0.max(off), worst.1.max(share));
        }
    }

    /// Requires a value of at least a bound.
    pub fn at_least(&mut self, what: &str, got: f64, least: f64) {
        let share = if got >= least { 0.0 } else { f64::INFINITY };
        self.worst.insert(what.to_owned(), (got, share));
    }

    /// The comparisons that failed.
    pub fn failures(&self) -> impl Iterator<Item = String> {
        let failed = self.worst.iter().filter(|(_, (_, share))| *share > 1.0);
        failed.map(|(what, (off, share))| format!("{what} is off by {off:.3e}, {share:.3e} of its tolerance"))
    }
}

impl fmt::Display for Checks {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let worst = self.worst.iter().max_by(|a, b| a.1.1.total_cmp(&b.1.1));
        match worst {
            Some((what, (off, share))) => {
                write!(f, "{:3} quantities, worst {what}: {off:.2e} = {share:.2e} of tolerance", self.worst.len())
            }
            None => write!(f, "nothing compared"),
        }
    }
}
