//! `heartian run` and `heartian check`.

use std::process::ExitCode;

use heartian_graph::{Graph, Plan};
use heartian_splat::{AdapterReport, Device, adapters};
use miette::Result;

use crate::arguments::{GraphArguments, RunArguments};
use crate::plugins;
use crate::session::{INTERRUPTED, Job, Session};
use crate::summary;

/// The parameter of nodes that can use a GPU.
const DEVICE: &str = "device";

/// Reads a graph with what the command line changes in it, and checks it.
pub fn load(arguments: &GraphArguments) -> Result<(Graph, Plan)> {
    let mut graph = Graph::load(&arguments.graph)?;
    arguments.sets.iter().for_each(|set| graph.set(set));
    let plan = graph.plan(plugins::registry()?, &arguments.targets)?;
    let Some(device) = arguments.device else { return Ok((graph, plan)) };
    choose_device(&mut graph, &plan, device, &arguments.sets);
    let plan = graph.plan(plugins::registry()?, &arguments.targets)?;
    Ok((graph, plan))
}

/// Sets the parameter `device` of all nodes that have it, but for those that `--set` names.
fn choose_device(graph: &mut Graph, plan: &Plan, device: Device, sets: &[String]) {
    for node in plan.nodes.iter().filter(|node| node.kind.param(DEVICE).is_some()) {
        let name = format!("{}.{DEVICE}", node.id);
        if !sets.iter().any(|set| set.split_once('=').is_some_and(|(named, _)| named.trim() == name)) {
            graph.set_from("--device", &format!("{name}={device:?}"));
        }
    }
    let suits = |adapter: &&AdapterReport| adapter.suits(device);
    if device == Device::Gpu && adapters().iter().find(suits).is_some_and(|adapter| adapter.is_software) {
        eprintln!("warning: the only GPU here is a software one, many times slower than `--device cpu`");
    }
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
