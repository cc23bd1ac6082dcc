//! Workers: child processes that run a library's nodes, and what is made of their end.
//!
//! A worker serves one node at a time and is kept for the next. While it works a watchdog ends it when the user cancels
//! or when it gives no sign of life for too long. A worker that dies or talks rubbish fails its node and is replaced.

use std::io::Read;
use std::path::PathBuf;
use std::process::{Child, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError, mpsc};
use std::time::{Duration, Instant};

use crate::context::{Cancel, Context};
use crate::digest::Digest;
use crate::node::NodeError;

use super::converse::{Broken, describe, greet, run};
use super::frame::Trouble;
use super::native::{Events, Job, Native};
use super::{HostCommand, PluginLimits};

/// A library that takes longer to load and describe itself hangs.
const LOAD_LIMIT: Duration = Duration::from_secs(10);
/// How often the watchdog looks while a worker works.
const LOOK: Duration = Duration::from_millis(25);
/// How much of what a library printed is kept for the error, of the start and of the end each.
const LAST_WORDS: usize = 4096;
/// How long to wait for the last words of a process that is gone.
const LISTEN: Duration = Duration::from_millis(500);

/// A library that has been described, and how its nodes are run.
pub(crate) struct Loaded {
    pub name: &'static str,
    pub version: &'static str,
    pub path: PathBuf,
    pub digest: Digest,
    pub host: HostCommand,
    pub limits: PluginLimits,
    /// Its digest stands in `plugins.lock`: it runs in this process.
    pub trusted: bool,
    pub native: OnceLock<Result<Native, Trouble>>,
    pub idle: Mutex<Vec<Worker>>,
    pub metrics: Mutex<Vec<&'static str>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Loaded {
    /// A failure that names the library.
    pub fn error(&self, what: &str) -> NodeError {
        NodeError::new(format!("the plugin `{}` {} ({}): {what}", self.name, self.version, self.path.display()))
    }

    /// What to do about a mistake of the library's.
    pub fn report_it(&self) -> String {
        format!("this is a mistake in the plugin, not in your graph: report it to the author of `{}`", self.name)
    }

    /// Runs a node, here or in a child process.
    pub fn run(&self, job: &Job<'_>, context: &Context, events: &mut dyn Events) -> Result<(), Trouble> {
        if self.trusted {
            let native = self.native.get_or_init(|| super::load_verified(&self.path, &self.digest));
            return native.as_ref().map_err(Clone::clone)?.run(job, events);
        }
        let mut worker = match self.idle_worker() {
            Some(worker) => worker,
            None => Worker::start(&self.host, (&self.path, &self.digest), &self.limits)?,
        };
        let output_limit = if self.limits.memory_bytes == 0 { u64::MAX } else { self.limits.memory_bytes };
        worker.watch(Some(context.canceller()), self.limits.silence);
        let mut events = Alive { worker: worker.guard.clone(), events };
        let spoken = run(&mut worker.reader, &mut worker.writer, job, (output_limit, &mut events));
        worker.rest();
        match spoken {
            Ok(done) => {
                lock(&self.idle).push(worker);
                done
            }
            Err(broken) => Err(worker.end(broken, &self.limits)),
        }
    }

    /// A worker that waits for work and still lives.
    fn idle_worker(&self) -> Option<Worker> {
        loop {
            let worker = lock(&self.idle).pop()?;
            if matches!(lock(&worker.guard.child).try_wait(), Ok(None)) {
                return Some(worker);
            }
        }
    }
}

/// Passes events on and notes that the library is alive.
struct Alive<'a> {
    worker: Arc<Guard>,
    events: &'a mut dyn Events,
}

impl Events for Alive<'_> {
    fn output(&mut self, port: &str, artifact: &str, bytes: std::borrow::Cow<'_, [u8]>) -> bool {
        self.worker.stir();
        self.events.output(port, artifact, bytes)
    }
    fn progress(&mut self, step: u64, total: u64, metric: Option<(&str, f64)>) -> bool {
        self.worker.stir();
        self.events.progress(step, total, metric)
    }
    fn warning(&mut self, text: &str) {
        self.worker.stir();
        self.events.warning(text);
    }
}

/// A child process that has loaded a library.
pub(crate) struct Worker {
    reader: ChildStdout,
    writer: ChildStdin,
    guard: Arc<Guard>,
    last_words: mpsc::Receiver<Vec<u8>>,
}

/// What the watchdog sees.
struct Guard {
    child: Mutex<Child>,
    watch: Mutex<Watch>,
    changed: Condvar,
}

#[derive(Default)]
struct Watch {
    /// Since when nothing was heard, how long that may be, and who may stop it; nothing while it rests.
    busy: Option<(Instant, Duration, Option<Cancel>)>,
    killed: Option<Killed>,
    /// The worker is gone.
    over: bool,
}

#[derive(Clone, Copy)]
enum Killed {
    Silent(Duration),
    Cancelled,
}

impl Guard {
    /// The library has given a sign of life.
    fn stir(&self) {
        if let Some((since, ..)) = &mut lock(&self.watch).busy {
            *since = Instant::now();
        }
    }

    /// Ends a worker that should not work on; returns when the worker is gone.
    fn keep_watch(&self) {
        let mut watch = lock(&self.watch);
        while !watch.over {
            let Some((since, silence, cancel)) = &watch.busy else {
                watch = self.changed.wait(watch).unwrap_or_else(PoisonError::into_inner);
                continue;
            };
            let killed = if cancel.as_ref().is_some_and(Cancel::requested) {
                Some(Killed::Cancelled)
            } else {
                (since.elapsed() > *silence).then_some(Killed::Silent(*silence))
            };
            if let Some(killed) = killed {
                (watch.killed, watch.busy) = (Some(killed), None);
                // One that is already gone cannot be killed, which is as good.
                let _ = lock(&self.child).kill();
                continue;
            }
            watch = self.changed.wait_timeout(watch, LOOK).unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

impl Worker {
    /// Starts a process and waits until it has loaded the library.
    pub fn start(
        host: &HostCommand,
        (path, digest): (&std::path::Path, &Digest),
        limits: &PluginLimits,
    ) -> Result<Self, Trouble> {
        let mut command = Command::new(&host.program);
        command.args(&host.arguments).arg(path).arg(digest.to_string()).arg(limits.memory_bytes.to_string());
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        // Ctrl-C is the host's to hear: it decides what becomes of its workers.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let no_process = |what: String| {
            Trouble::new(format!("no process to run it in: {what}"))
                .remedy("check the limits on processes and memory, and that the program has not been moved")
        };
        let mut child = command.spawn().map_err(|error| no_process(error.to_string()))?;
        let (Some(writer), Some(reader), Some(stderr)) = (child.stdin.take(), child.stdout.take(), child.stderr.take())
        else {
            return Err(no_process("it has no pipes".to_owned()));
        };
        let (sender, last_words) = mpsc::channel();
        std::thread::spawn(move || sender.send(listen(stderr)));
        let guard = Arc::new(Guard { child: Mutex::new(child), watch: Mutex::default(), changed: Condvar::new() });
        let watchdog = guard.clone();
        std::thread::spawn(move || watchdog.keep_watch());
        let mut worker = Self { reader, writer, guard, last_words };
        worker.watch(None, LOAD_LIMIT.min(limits.silence));
        let greeted = greet(&mut worker.reader);
        worker.rest();
        match greeted {
            Ok(Ok(())) => Ok(worker),
            Ok(Err(trouble)) => Err(trouble),
            Err(broken) => Err(worker.end(broken, limits)),
        }
    }

    /// Asks the library what it is.
    pub fn describe(mut self, limits: &PluginLimits) -> Result<Vec<u8>, Trouble> {
        self.watch(None, LOAD_LIMIT.min(limits.silence));
        let spoken = describe(&mut self.reader, &mut self.writer);
        self.rest();
        spoken.unwrap_or_else(|broken| Err(self.end(broken, limits)))
    }

    /// From now on the worker must give signs of life.
    fn watch(&self, cancel: Option<Cancel>, silence: Duration) {
        lock(&self.guard.watch).busy = Some((Instant::now(), silence, cancel));
        self.guard.changed.notify_all();
    }

    /// From now on it need not.
    fn rest(&self) {
        lock(&self.guard.watch).busy = None;
    }

    /// Ends the process and says why it had to end.
    fn end(self, broken: Broken, limits: &PluginLimits) -> Trouble {
        let status = {
            let mut child = lock(&self.guard.child);
            if matches!(broken, Broken::Rubbish(_)) {
                // Rubbish in, nothing more out.
                let _ = child.kill();
            }
            // The pipe closes a moment before the process ends; one that closed it and lives on is ended.
            let patience = Instant::now();
            loop {
                match child.try_wait() {
                    Ok(Some(status)) => break Some(status),
                    Ok(None) if patience.elapsed() < LISTEN => std::thread::sleep(Duration::from_millis(1)),
                    _ => {
                        let _ = child.kill();
                        break child.wait().ok();
                    }
                }
            }
        };
        let killed = lock(&self.guard.watch).killed;
        let words = self.last_words.recv_timeout(LISTEN).unwrap_or_default();
        obituary(killed, broken, status, (&printable(&words), limits))
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        lock(&self.guard.watch).over = true;
        self.guard.changed.notify_all();
        let mut child = lock(&self.guard.child);
        // It may be gone already; either way no zombie stays.
        let _ = child.kill();
        let _ = child.wait();
    }
}

/// The start and the end of what a library prints.
fn listen(mut from: impl Read) -> Vec<u8> {
    let (mut kept, mut buffer) = (Vec::new(), [0; 1024]);
    while let Ok(count @ 1..) = from.read(&mut buffer) {
        kept.extend_from_slice(&buffer[..count]);
        let surplus = kept.len().saturating_sub(2 * LAST_WORDS);
        kept.drain(kept.len().min(LAST_WORDS)..kept.len().min(LAST_WORDS) + surplus);
    }
    kept
}

/// The line of the first panic and the next, or the last three lines, as one.
fn printable(words: &[u8]) -> String {
    let text = String::from_utf8_lossy(words);
    let lines: Vec<&str> = text.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    let panic = lines.iter().position(|line| line.contains("panicked at"));
    let start = panic.unwrap_or(lines.len().saturating_sub(3));
    let last: Vec<&str> = lines[start..].iter().take(if panic.is_some() { 2 } else { 3 }).copied().collect();
    last.join(" / ").chars().filter(|c| !c.is_control()).take(400).collect()
}

/// Why a worker ended, and what can be done.
fn obituary(
    killed: Option<Killed>,
    broken: Broken,
    status: Option<ExitStatus>,
    (words, limits): (&str, &PluginLimits),
) -> Trouble {
    let last = if words.is_empty() { String::new() } else { format!("; its last words: {words}") };
    let report = "this is a mistake in the plugin, not in your graph: report it to its author";
    match (killed, broken) {
        (Some(Killed::Cancelled), _) => Trouble { cancelled: true, ..Trouble::new("cancelled") },
        (Some(Killed::Silent(limit)), _) => {
            let seconds = limit.as_secs_f64();
            Trouble::new(format!("it gave no sign of life for {seconds} s and was stopped{last}")).remedy(
                "if it is only slow, raise the limit with --plugin-timeout SECONDS; else report it to its author",
            )
        }
        (None, Broken::Rubbish(what)) => {
            Trouble::new(format!("its process speaks no sense: {what}{last}")).remedy(report)
        }
        (None, Broken::Gone) => {
            let how = status.map_or("in an unknown way".to_owned(), how_it_ended);
            if words.contains("memory allocation of") || words.contains("bad_alloc") {
                let limit = limits.memory_bytes as f64 / f64::from(1 << 30);
                return Trouble::new(format!(
                    "it ran out of memory (limit {limit:.1} GiB): its process ended {how}{last}"
                ))
                .remedy("raise the limit with --plugin-memory BYTES, or give it less to do");
            }
            Trouble::new(format!("its process ended {how}{last}")).remedy(report)
        }
    }
}

#[cfg(unix)]
fn how_it_ended(status: ExitStatus) -> String {
    const NAMES: [(i32, &str); 7] =
        [(4, "SIGILL"), (6, "SIGABRT"), (7, "SIGBUS"), (8, "SIGFPE"), (9, "SIGKILL"), (11, "SIGSEGV"), (15, "SIGTERM")];
    match (std::os::unix::process::ExitStatusExt::signal(&status), status.code()) {
        (Some(signal), _) => {
            let name = NAMES.iter().find(|(number, _)| *number == signal).map_or("", |(_, name)| name);
            format!("by signal {signal} {name}").trim_end().to_owned()
        }
        (None, code) => format!("with exit code {}", code.unwrap_or_default()),
    }
}

#[cfg(not(unix))]
fn how_it_ended(status: ExitStatus) -> String {
    status.to_string()
}
