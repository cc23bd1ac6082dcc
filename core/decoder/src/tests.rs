//! Tests of whole networks.
#![expect(clippy::unwrap_used, reason = "tests")]

mod golden;
