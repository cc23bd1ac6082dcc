//! `heartian bench`: what Heartian promises, measured on data it makes itself. Timed figures are for reading, never for
//! tests: a busy machine changes them.

pub mod avatar;
pub mod decoder;
pub mod graph;
mod pulse;
pub mod splat;
pub mod track;

use std::process::ExitCode;

use miette::Result;

use crate::arguments::Bench;

/// Measures.
pub fn run(bench: &Bench) -> Result<ExitCode> {
    match bench {
        Bench::Graph(arguments) => graph::run(arguments),
        Bench::Pulse(arguments) => pulse::run(arguments),
        Bench::Avatar(arguments) => avatar::run(arguments),
        Bench::Decoder(arguments) => decoder::run(arguments),
        Bench::Splat(arguments) => splat::run(arguments),
        Bench::Track(arguments) => track::run(arguments),
    }
}
