//! One command's runs: the cache they share, who hears of progress, and how a plan becomes a folder of results.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, SystemTime};

use heartian_graph::{Cache, Cancel, Graph, NodeReport, Plan, Problem, Run, RunOptions, Status};
use miette::{Result, miette};

use crate::arguments::HostArguments;
use crate::deliver::{Delivered, Delivery, deliver};
use crate::progress::Terminal;
use crate::provenance::{self, Story};
use crate::status::Marker;

/// How often results that turn out damaged in the cache are recomputed before giving up.
const DELIVERIES: usize = 3;
/// How long nodes may take to stop after Ctrl-C.
const GRACE: Duration = Duration::from_millis(800);
/// What a shell reports for a program ended by Ctrl-C.
pub const INTERRUPTED: u8 = 130;

/// What the runs of one command share.
pub struct Session {
    pub cache: Cache,
    pub terminal: Arc<Terminal>,
    pub options: RunOptions,
}

/// A plan to be run, and where it came from.
pub struct Job<'a> {
    pub graph: &'a Graph,
    pub sets: &'a [String],
    pub plan: &'a Plan,
    /// Folder of the results; one named after the graph and its fingerprint when left out.
    pub out: Option<&'a Path>,
}

/// What came of a job.
pub struct Done {
    pub folder: PathBuf,
    pub reports: Vec<NodeReport>,
    pub delivered: Delivered,
    /// Why nodes failed.
    pub problems: Vec<Problem>,
    pub start: Instant,
}

impl Session {
    /// Opens the cache and listens for Ctrl-C.
    pub fn open(host: &HostArguments) -> Result<Self> {
        let cancel = Cancel::default();
        stop_on_interrupt(&cancel);
        let terminal = Arc::new(Terminal::new());
        let default = RunOptions::default();
        let options = RunOptions {
            cancel,
            observer: terminal.clone(),
            keep_going: host.keep_going,
            jobs: host.jobs.map_or(default.jobs, usize::from),
            memory_bytes: host.memory.unwrap_or(default.memory_bytes),
            checkpoint_every: Duration::from_secs(host.checkpoint_every.into()),
        };
        Ok(Self { cache: open_cache(host.cache.as_deref())?, terminal, options })
    }

    /// Whether the user asked to stop.
    pub fn cancelled(&self) -> bool {
        self.options.cancel.requested()
    }

    /// Runs a plan; results stay in the cache.
    pub fn execute(&self, run: &Run<'_>) -> Vec<NodeReport> {
        Self::watched(run, &self.options)
    }

    fn watched(run: &Run<'_>, options: &RunOptions) -> Vec<NodeReport> {
        quietly(|| run.execute(options))
    }

    /// Runs a plan and leaves its results in a folder.
    pub fn carry_out(&self, job: &Job<'_>) -> Result<Done> {
        let (start, begun) = (Instant::now(), SystemTime::now());
        let Job { graph, sets, plan, out } = job;
        let run = Run::prepare(plan, &self.cache);
        let fingerprint = run.fingerprint();
        let named = || Path::new("runs").join(format!("{}-{}", file_name(&plan.name), &fingerprint.to_string()[..8]));
        let folder = out.map_or_else(named, Path::to_owned);
        let marker = Arc::new(Marker::new(&folder, plan.nodes.len(), self.options.observer.clone()));
        let options = RunOptions { observer: marker, ..self.options.clone() };
        let mut reports: Vec<NodeReport> = Vec::new();
        let mut attempts = 0;
        let delivered = loop {
            reports = merge(reports, Self::watched(&run, &options));
            if self.cancelled() {
                break Delivered::default();
            }
            let delivery = Delivery { graph, sets, plan, cache: &self.cache, fingerprint };
            let delivered = deliver(&delivery, &reports, &folder)?;
            attempts += 1;
            if !delivered.damaged {
                break delivered;
            }
            if attempts == DELIVERIES {
                let help = "choose another folder with --cache DIR";
                let root = self.cache.root().display();
                return Err(miette!(help = help, "`{root}` does not keep what is written to it"));
            }
        };
        let story = Story {
            graph,
            sets,
            plan,
            cache: &self.cache,
            reports: &reports,
            delivered: &delivered,
            start: begun,
            end: SystemTime::now(),
        };
        if !self.cancelled() {
            provenance::write(&story, &folder)?;
        }
        let problems = reports.iter().filter_map(|report| report.problem(plan)).collect();
        Ok(Done { folder, reports, delivered, problems, start })
    }
}

/// Opens the cache in the folder named, in that of `HEARTIAN_CACHE`, or in `.heartian/cache`.
pub fn open_cache(folder: Option<&Path>) -> Result<Cache> {
    let named = || std::env::var_os("HEARTIAN_CACHE").filter(|value| !value.is_empty()).map(PathBuf::from);
    let folder = folder.map(Path::to_owned).or_else(named);
    Ok(Cache::open(&folder.unwrap_or_else(|| Path::new(".heartian").join("cache")))?)
}

/// A name with what a file name cannot hold replaced.
pub fn file_name(name: &str) -> String {
    let plain = |c: char| if c.is_alphanumeric() || matches!(c, '-' | '_') { c } else { '_' };
    name.chars().take(64).map(plain).collect()
}

/// The first Ctrl-C asks the running nodes to stop, and ends the program if they do not do so in time; the second ends it
/// at once. The cache holds what is finished, whichever way the program ends.
fn stop_on_interrupt(cancel: &Cancel) {
    let cancel = cancel.clone();
    let handler = move || {
        if cancel.requested() {
            std::process::exit(INTERRUPTED.into());
        }
        cancel.request();
        eprintln!("stopping; Ctrl-C again to stop at once");
        std::thread::spawn(|| {
            std::thread::sleep(GRACE);
            eprintln!("interrupted while a node was busy; what is finished is kept");
            std::process::exit(INTERRUPTED.into());
        });
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
