//! `heartian status`: the latest runs, what is running, and the cache; and the marker that a running run leaves.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use heartian_graph::{Event, Observer, Status};
use miette::{IntoDiagnostic, Result};
use serde::{Deserialize, Serialize};

use crate::arguments::StatusArguments;
use crate::clock;
use crate::deliver::MetricsFile;
use crate::session::open_cache;
use crate::sizes;
use crate::summary::table;

/// The marker's name in the folder of a run.
const MARKER: &str = "running.json";
/// It is written again at most this often.
const PERIOD: Duration = Duration::from_millis(500);

/// What the marker of a running run says.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Running {
    pid: u32,
    /// Seconds since 1970.
    started: u64,
    nodes: usize,
    done: usize,
    /// Ids of the nodes that run.
    running: Vec<String>,
}

/// Keeps the marker of a run and passes its events on. The marker goes when this is dropped; a killed run leaves it.
pub struct Marker {
    inner: Arc<dyn Observer>,
    path: PathBuf,
    state: Mutex<(Running, Option<Instant>)>,
}

impl Marker {
    /// Marks `folder` as the place of a run of so many nodes. Without a marker only `heartian status` knows less.
    pub fn new(folder: &Path, nodes: usize, inner: Arc<dyn Observer>) -> Self {
        let started = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs();
        let state = Running { pid: std::process::id(), started, nodes, ..Running::default() };
        Self { inner, path: folder.join(MARKER), state: Mutex::new((state, None)) }
    }

    fn change(&self, change: impl FnOnce(&mut Running)) {
        let mut guard = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let (state, written) = &mut *guard;
        change(state);
        if written.is_some_and(|written| written.elapsed() < PERIOD) {
            return;
        }
        *written = Some(Instant::now());
        let folder = self.path.parent().unwrap_or(Path::new("."));
        if std::fs::create_dir_all(folder).is_ok()
            && let Ok(text) = serde_json::to_string(state)
        {
            // Read while half written, it counts as not there.
            let _ = std::fs::write(&self.path, text);
        }
    }
}

impl Observer for Marker {
    fn event(&self, event: &Event<'_>) {
        match event {
            Event::Started { node, .. } => self.change(|state| state.running.push((*node).to_owned())),
            Event::Finished { node, status, .. } => {
                let hit = *status == Status::Hit;
                let finish = |state: &mut Running| {
                    state.done += 1;
                    state.running.retain(|known| known != node);
                };
                if hit {
                    // Hits pass by the thousand; what follows them writes the file.
                    finish(&mut self.state.lock().unwrap_or_else(PoisonError::into_inner).0);
                } else {
                    self.change(finish);
                }
            }
            _ => {}
        }
        self.inner.event(event);
    }
}

impl Drop for Marker {
    fn drop(&mut self) {
        let written = self.state.get_mut().unwrap_or_else(PoisonError::into_inner).1;
        if written.is_some() {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// One run.
#[derive(Debug, Serialize)]
struct Line {
    run: String,
    graph: String,
    state: String,
    hits: usize,
    ran: usize,
    failed: usize,
    /// Sum of the nodes' times in this run.
    seconds: f64,
    #[serde(skip)]
    when: Option<SystemTime>,
    time: Option<String>,
}

/// Prints the latest runs and the cache.
pub fn print(arguments: &StatusArguments) -> Result<ExitCode> {
    let entries = std::fs::read_dir(&arguments.runs).into_iter().flatten().flatten();
    let mut lines: Vec<Line> = entries.filter_map(|entry| line(&entry.path())).collect();
    lines.sort_by(|a, b| b.when.cmp(&a.when).then_with(|| a.run.cmp(&b.run)));
    let more = lines.len().saturating_sub(arguments.last);
    lines.truncate(arguments.last);
    let cache = open_cache(arguments.cache.as_deref())?;
    let usage = cache.usage();
    let records: u64 = usage.kinds.values().map(|(records, _)| records).sum();
    if arguments.json {
        let root = cache.root().display().to_string();
        let all = serde_json::json!({"runs": lines, "cache": {"folder": root, "records": records, "usage": usage, "bytes": usage.total()}});
        println!("{}", serde_json::to_string_pretty(&all).into_diagnostic()?);
        return Ok(ExitCode::SUCCESS);
    }
    if lines.is_empty() {
        println!("no runs in `{}`; `heartian run GRAPH` makes one", arguments.runs.display());
    } else {
        let mut rows = vec![["run", "state", "hits", "ran", "failed", "seconds", "when"].map(str::to_owned).to_vec()];
        rows.extend(lines.iter().map(|line| {
            let counts = [line.hits, line.ran, line.failed].map(|count| count.to_string());
            let when = line.when.map_or(String::new(), clock::ago);
            let mut row = vec![line.run.clone(), line.state.clone()];
            row.extend(counts);
            row.extend([format!("{:.2}", line.seconds), when]);
            row
        }));
        print!("{}", table(&rows, &[false, false, true, true, true, true, false]));
        if more > 0 {
            println!("  and {more} older");
        }
    }
    println!("\ncache `{}`: {records} records, {}", cache.root().display(), sizes::show(usage.total()));
    Ok(ExitCode::SUCCESS)
}

fn line(folder: &Path) -> Option<Line> {
    let read = |name: &str| std::fs::read(folder.join(name)).ok();
    let time = |name: &str| std::fs::metadata(folder.join(name)).and_then(|metadata| metadata.modified()).ok();
    let running = read(MARKER).and_then(|bytes| serde_json::from_slice::<Running>(&bytes).ok());
    let metrics = read("metrics.json").and_then(|bytes| serde_json::from_slice::<MetricsFile>(&bytes).ok());
    if running.is_none() && metrics.is_none() {
        return None;
    }
    let count = |status: Status| {
        metrics.as_ref().map_or(0, |file| file.nodes.iter().filter(|node| node.status == status).count())
    };
    let failed = count(Status::Failed) + count(Status::Skipped);
    let state = match &running {
        Some(running) if is_alive(running.pid) => {
            let nodes =
                if running.running.is_empty() { String::new() } else { format!(": {}", running.running.join(", ")) };
            let since = clock::ago(UNIX_EPOCH + Duration::from_secs(running.started)).replace(" ago", "");
            format!("running for {since}, {} of {}{nodes}", running.done, running.nodes)
        }
        Some(running) => format!("was killed after {} of {} nodes", running.done, running.nodes),
        None if failed > 0 => "failed".to_owned(),
        None => "finished".to_owned(),
    };
    let when = time(MARKER).or_else(|| time("metrics.json"));
    Some(Line {
        run: folder.display().to_string(),
        graph: metrics.as_ref().map_or(String::new(), |file| file.graph.clone()),
        state,
        hits: count(Status::Hit),
        ran: count(Status::Ran),
        failed,
        seconds: metrics.as_ref().map_or(0.0, |file| file.nodes.iter().map(|node| node.seconds).sum()),
        when,
        time: when.map(clock::iso),
    })
}

/// Whether a process runs; where that cannot be seen, a marker counts.
fn is_alive(pid: u32) -> bool {
    let processes = Path::new("/proc");
    !processes.join("self").exists() || processes.join(pid.to_string()).exists()
}
