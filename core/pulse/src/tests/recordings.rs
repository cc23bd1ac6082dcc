//! Real contact PPG. The recordings lie beside the repository and are not part of it; without them the tests say so.
#![expect(clippy::unwrap_used, reason = "tests")]

use std::path::Path;

use super::*;

/// A recording, if it is there: CSV with the header `time_s,ppg`.
pub(super) fn recording(file: &str) -> Option<Series> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data").join(file);
    let Ok(text) = std::fs::read_to_string(&path) else {
        println!("skipped: {file} is not beside the repository");
        return None;
    };
    let rows = text.lines().skip(1).filter_map(|line| line.split_once(','));
    let (times_seconds, values) = rows.map(|(t, v)| (t.parse::<f64>().unwrap(), v.parse::<f64>().unwrap())).unzip();
    Some(Series::new(times_seconds, values).unwrap())
}
