//! What a run of the command leaves behind, for the tests that look at it.

use std::path::{Path, PathBuf};

/// `id:status` of each node, from a run's `metrics.json`.
pub fn statuses(folder: &Path) -> String {
    let metrics: serde_json::Value =
        serde_json::from_slice(&std::fs::read(folder.join("metrics.json")).unwrap()).unwrap();
    let word =
        |node: &serde_json::Value| format!("{}:{}", node["id"].as_str().unwrap(), node["status"].as_str().unwrap());
    metrics["nodes"].as_array().unwrap().iter().map(word).collect::<Vec<_>>().join(" ")
}

/// All files below a folder.
pub fn files_below(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap().flatten() {
            let path = entry.path();
            if path.is_dir() { folders.push(path) } else { found.push(path) }
        }
    }
    found.sort();
    found
}
