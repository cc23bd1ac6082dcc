//! Wall time of repeated calls.

use std::time::Instant;

use miette::Result;
use serde_json::{Value, json};

/// Least and middle time of some runs, milliseconds.
#[derive(Clone, Copy, Debug)]
pub struct Timing {
    /// Least.
    pub min_ms: f64,
    /// Median.
    pub median_ms: f64,
}

impl Timing {
    /// Runs `f` once unmeasured, then `runs` times.
    pub fn of<T>(runs: u16, mut f: impl FnMut() -> Result<T>) -> Result<Self> {
        f()?;
        let mut ms = Vec::with_capacity(usize::from(runs));
        for _ in 0..runs {
            let start = Instant::now();
            let result = f()?;
            ms.push(start.elapsed().as_secs_f64() * 1e3);
            drop(result);
        }
        ms.sort_by(f64::total_cmp);
        Ok(Self { min_ms: ms[0], median_ms: ms[ms.len() / 2] })
    }

    /// `min / median`, for a table.
    pub fn text(self) -> String {
        format!("{:.2} / {:.2}", self.min_ms, self.median_ms)
    }

    pub fn json(self) -> Value {
        json!({"min_ms": self.min_ms, "median_ms": self.median_ms})
    }
}
