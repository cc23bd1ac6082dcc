//! What the cache tells about graphs: what it remembers, why a node is a hit or a miss, what a sweep will cost.

mod explain;
mod history;
mod sweep;

pub use explain::{Cause, Explainer, Explanation, PastNode, Standing, Subject, subjects_of_plan, subjects_of_run};
pub use history::{Change, Entry, History, changes};
pub use sweep::{Forecast, Sweep};
