//! Where plugins lie: files, and folders of them.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The shared libraries among `places`: files as they are, folders' files by their ending, in order; each once. Places
/// that are not there are passed over.
pub fn plugin_files(places: &[PathBuf]) -> Vec<PathBuf> {
    let mut seen = BTreeSet::new();
    let files = places.iter().flat_map(|place| if place.is_dir() { libraries(place) } else { vec![place.clone()] });
    files.filter(|file| std::fs::canonicalize(file).is_ok_and(|whole| whole.is_file() && seen.insert(whole))).collect()
}

fn libraries(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let ending = std::env::consts::DLL_EXTENSION;
    let mut found: Vec<PathBuf> =
        entries.filter(|path| path.extension().is_some_and(|found| found == ending)).collect();
    found.sort();
    found
}
