//! `heartian run` and `heartian check`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use heartian_graph::{Cache, Cancel, Graph, NodeReport, Plan, Registry, Run, RunOptions, Status};
use miette::{Result, miette};

use crate::arguments::{GraphArguments, RunArguments};
use crate::deliver::{Delivery, deliver};
use crate::progress::Terminal;
use crate::summary;

/// How often results that turn out damaged in the cache are recomputed before giving up.
const DELIVERIES: usize = 3;
/// What a shell reports for a program ended by Ctrl-C.
const INTERRUPTED: u8 = 130;

fn load(arguments: &GraphArguments) -> Result<(Graph, Plan)> {
    let mut graph = Graph::load(&arguments.graph)?;
    arguments.sets.iter().for_each(|set| graph.set(set));
    let plan = graph.plan(&Registry::compiled_in(), &arguments.targets)?;
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
    let start = Instant::now();
    let (graph, plan) = load(&arguments.graph)?;
    let cache = Cache::open(&cache_folder(arguments))?;
    let cancel = Cancel::default();
    stop_on_interrupt(&cancel);
    let terminal = Arc::new(Terminal::new());
    let options = RunOptions {
        cancel: cancel.clone(),
        observer: terminal.clone(),
        keep_going: arguments.keep_going,
        ..RunOptions::default()
    };
    let run = Run::prepare(&plan, &cache);
    let fingerprint = run.fingerprint();
    let short = &fingerprint.to_string()[..8];
    let folder =
        arguments.out.clone().unwrap_or_else(|| Path::new("runs").join(format!("{}-{short}", file_name(&plan.name))));
    let mut reports: Vec<NodeReport> = Vec::new();
    let mut attempts = 0;
    let delivered = loop {
        reports = merge(reports, quietly(|| run.execute(&options)));
        let delivery = Delivery { graph: &graph, sets: &arguments.graph.sets, plan: &plan, cache: &cache, fingerprint };
        let delivered = deliver(&delivery, &reports, &folder)?;
        attempts += 1;
        if !delivered.damaged || cancel.requested() {
            break delivered;
        }
        if attempts == DELIVERIES {
            let help = "choose another folder with --cache DIR";
            return Err(miette!(help = help, "`{}` does not keep what is written to it", cache.root().display()));
        }
    };
    terminal.finish();
    delivered.warnings.iter().for_each(|text| terminal.warn("results", text));
    print!("{}", summary::run(&plan.name, &reports, &delivered.metrics, start.elapsed()));
    println!("{}", folder.display());
    let problems: Vec<_> = reports.iter().filter_map(|report| report.problem(&plan)).collect();
    if cancel.requested() {
        eprintln!("interrupted; what is finished is kept");
        return Ok(ExitCode::from(INTERRUPTED));
    }
    for problem in &problems {
        eprintln!("{:?}", miette::Report::new(problem.clone()));
    }
    Ok(if problems.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn cache_folder(arguments: &RunArguments) -> PathBuf {
    let named = std::env::var_os("HEARTIAN_CACHE").filter(|value| !value.is_empty()).map(PathBuf::from);
    arguments.cache.clone().or(named).unwrap_or_else(|| Path::new(".heartian").join("cache"))
}

/// The graph's name with what a file name cannot hold replaced.
fn file_name(name: &str) -> String {
    let plain = |c: char| if c.is_alphanumeric() || matches!(c, '-' | '_') { c } else { '_' };
    name.chars().take(64).map(plain).collect()
}

/// The first Ctrl-C asks the running node to stop; the second ends the program.
fn stop_on_interrupt(cancel: &Cancel) {
    let cancel = cancel.clone();
    let handler = move || {
        if cancel.requested() {
            std::process::exit(INTERRUPTED.into());
        }
        cancel.request();
        eprintln!("stopping; Ctrl-C again to stop at once");
    };
    // Without a handler Ctrl-C ends the program at once, which the cache survives.
    let _ = ctrlc::set_handler(handler);
}

/// Runs `work` without the default report of a panic: the scheduler turns a node's panic into an error.
fn quietly<T>(work: impl FnOnce() -> T) -> T {
    static QUIET: AtomicBool = AtomicBool::new(false);
    static HOOK: std::sync::Once = std::sync::Once::new();
    HOOK.call_once(|| {
        let default = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            let wanted = std::env::var_os("RUST_BACKTRACE").is_some_and(|value| value != "0");
            if wanted || !QUIET.load(Ordering::Relaxed) {
                default(info);
            }
        }));
    });
    QUIET.store(true, Ordering::Relaxed);
    let done = work();
    QUIET.store(false, Ordering::Relaxed);
    done
}

/// Reports of a repeated run: what ran at either time ran.
fn merge(before: Vec<NodeReport>, after: Vec<NodeReport>) -> Vec<NodeReport> {
    let mut before = before.into_iter();
    let join = |mut report: NodeReport| {
        if let Some(earlier) = before.next() {
            report.seconds += earlier.seconds;
            if earlier.status == Status::Ran && report.status == Status::Hit {
                report.status = Status::Ran;
            }
        }
        report
    };
    after.into_iter().map(join).collect()
}
