//! Tests of whole networks.
#![expect(clippy::unwrap_used, reason = "tests")]

mod files;
mod golden;
mod input;
mod layers;
