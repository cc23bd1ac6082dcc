//! The integration tests of the house, in modules by intent.
#![expect(clippy::unwrap_used, reason = "tests")]

mod commands;
mod datasets;
mod graphs;
mod house;
mod interrupt;
mod laws;
mod measuring;
#[cfg(unix)]
mod models;
mod perfusion;
mod pipeline;
mod plugins;
mod results;
mod revisions;
mod stage2;

// Linked for the nodes they register.
use {heartian_nodes_avatar as _, heartian_nodes_capture as _, heartian_nodes_measure as _, heartian_nodes_pulse as _};
