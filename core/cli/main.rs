//! The `heartian` command: arguments in, a graph run, its results in a folder.
//!
//! Exit code 0 when all went well, 1 when something is wrong with a graph or a node, 2 for wrong usage, 130 when
//! interrupted. Results go to standard output, progress and errors to standard error.

mod arguments;
mod audit;
mod bench;
mod cache;
mod clock;
mod compare;
mod datasets;
mod deliver;
mod devices;
mod draw;
mod explain;
mod export;
mod manual;
mod measure;
mod models;
mod paired;
mod plugins;
mod progress;
mod provenance;
mod run;
mod session;
mod sizes;
mod status;
mod summary;
mod sweep;

use std::process::ExitCode;

use clap::Parser;

use crate::arguments::{Arguments, Command};

// Linked for the nodes they register.
use {heartian_nodes_avatar as _, heartian_nodes_capture as _, heartian_nodes_measure as _, heartian_nodes_pulse as _};

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    plugins::remember(arguments.plugins);
    let done = match arguments.command {
        Command::Run(arguments) => run::run(&arguments),
        Command::Check(arguments) => run::check(&arguments),
        Command::Nodes { kind, json } => manual::print(kind.as_deref(), json),
        Command::Schema { kind } => manual::schema(kind.as_deref()),
        Command::Explain(arguments) => explain::explain(&arguments),
        Command::Sweep(arguments) => sweep::sweep(&arguments),
        Command::Graph(arguments) => draw::draw(&arguments),
        Command::Status(arguments) => status::print(&arguments),
        Command::Compare { runs, plot } => compare::print(&runs, plot.as_deref()),
        Command::Export(arguments) => export::run(&arguments),
        Command::Measure(arguments) => measure::run(&arguments),
        Command::Cache(arguments) => cache::act(&arguments),
        Command::Audit(arguments) => audit::run(&arguments),
        Command::Plugins { action } => plugins::act(&action),
        Command::PluginHost { library, digest, memory } => {
            return heartian_graph::serve_plugin(&library, &digest, memory);
        }
        Command::Bench { bench } => bench::run(&bench),
        Command::Datasets { action } => datasets::act(&action),
        Command::Devices { json } => devices::print(json),
        Command::Models { action } => models::act(action),
    };
    done.unwrap_or_else(|report| {
        eprintln!("{report:?}");
        ExitCode::FAILURE
    })
}
