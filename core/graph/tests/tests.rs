//! The engine on graphs of small number nodes: what is refused and in which words, what runs and what is a hit.
#![expect(clippy::unwrap_used, reason = "tests")]

mod bulk;
mod caching;
mod errors;
mod explaining;
mod failures;
mod fuzz;
mod nodes;
mod overlays;
mod parallel;
mod processes;
mod reading;
mod reuse;
mod scale;
mod upkeep;
