//! The `heartian` command: arguments in, a graph run, its results in a folder.
//!
//! Exit code 0 when all went well, 1 when something is wrong with a graph or a node, 2 for wrong usage, 130 when
//! interrupted. Results go to standard output, progress and errors to standard error.

mod arguments;
mod audit;
mod avi;
mod bench;
mod cache;
mod compare;
mod deliver;
mod manual;
mod models;
mod paired;
mod plugins;
mod progress;
mod run;
mod session;
mod sizes;
mod summary;

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
        Command::Nodes { kind } => manual::print(kind.as_deref()),
        Command::Compare { runs, plot } => compare::print(&runs, plot.as_deref()),
        Command::Cache(arguments) => cache::act(&arguments),
        Command::Audit(arguments) => audit::run(&arguments),
        Command::Plugins { action } => plugins::act(&action),
        Command::PluginHost { library, digest, memory } => {
            return heartian_graph::serve_plugin(&library, &digest, memory);
        }
        Command::Bench { bench } => bench::run(&bench),
        Command::Models { action } => models::act(action),
    };
    done.unwrap_or_else(|report| {
        eprintln!("{report:?}");
        ExitCode::FAILURE
    })
}
