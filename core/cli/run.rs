//! `heartian run` and `heartian check`.

use std::process::ExitCode;

use heartian_graph::{Graph, Plan};
use miette::Result;

use crate::arguments::{GraphArguments, RunArguments};
use crate::plugins;
use crate::session::{INTERRUPTED, Job, Session};
use crate::summary;

/// Reads a graph with what the command line changes in it, and checks it.
pub fn load(arguments: &GraphArguments) -> Result<(Graph, Plan)> {
    let mut graph = Graph::load(&arguments.graph)?;
    arguments.sets.iter().for_each(|set| graph.set(set));
    let plan = graph.plan(plugins::registry()?, &arguments.targets)?;
    Ok((graph, plan))
}

/// Checks a graph and shows its plan.
pub fn check(arguments: &GraphArguments) -> Result<ExitCode> {
    let (graph, plan) = load(arguments)?;
    println!("{}: {}\n", graph.name(), graph.doc());
    print!("{}", summary::plan_table(&plan));
    println!("\n{} nodes, nothing wrong.", plan.nodes.len());
    Ok(ExitCode::SUCCESS)
}

/// Runs a graph and leaves its results in a folder.
pub fn run(arguments: &RunArguments) -> Result<ExitCode> {
    let (graph, plan) = load(&arguments.graph)?;
    let session = Session::open(&arguments.host)?;
    let job = Job { graph: &graph, sets: &arguments.graph.sets, plan: &plan, out: arguments.out.as_deref() };
    let done = session.carry_out(&job)?;
    session.terminal.finish();
    done.delivered.warnings.iter().for_each(|text| session.terminal.warn("results", text));
    print!("{}", summary::run(&plan.name, &done.reports, &done.delivered.metrics, done.start.elapsed()));
    println!("{}", done.folder.display());
    if session.cancelled() {
        eprintln!("interrupted; what is finished is kept");
        return Ok(ExitCode::from(INTERRUPTED));
    }
    for problem in &done.problems {
        eprintln!("{:?}", miette::Report::new(problem.clone()));
    }
    Ok(if done.problems.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
