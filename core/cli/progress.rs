//! One live line per running node on a terminal; warnings always; nothing else when standard error is not a terminal.

use std::collections::HashMap;
use std::fmt::Write;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use heartian_graph::{Event, Observer, Progress, Status};
use indicatif::{MultiProgress, ProgressBar, ProgressState, ProgressStyle};

/// How often a line's clock ticks between reports.
const TICK: Duration = Duration::from_millis(200);

/// Shows a run's events on standard error.
pub struct Terminal {
    lines: MultiProgress,
    running: Mutex<HashMap<String, ProgressBar>>,
}

fn style(template: &str) -> ProgressStyle {
    let rate = |state: &ProgressState, text: &mut dyn Write| {
        // A line that cannot be written is a line not shown.
        let _ = write!(text, "{:.1}/s", state.per_sec());
    };
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()).with_key("rate", rate)
}

impl Terminal {
    /// Hidden unless standard error is a terminal.
    pub fn new() -> Self {
        Self { lines: MultiProgress::new(), running: Mutex::default() }
    }

    /// Prints a warning above the live lines.
    pub fn warn(&self, node: &str, text: &str) {
        self.lines.suspend(|| eprintln!("warning: {node}: {text}"));
    }

    /// Removes all live lines.
    pub fn finish(&self) {
        for (_, bar) in self.running.lock().unwrap_or_else(PoisonError::into_inner).drain() {
            bar.finish_and_clear();
        }
    }

    fn with_line(&self, node: &str, action: impl FnOnce(&ProgressBar)) {
        if let Some(bar) = self.running.lock().unwrap_or_else(PoisonError::into_inner).get(node) {
            action(bar);
        }
    }

    fn start(&self, node: &str, kind: &str) {
        let bar = self.lines.add(ProgressBar::new_spinner());
        bar.set_style(style("{spinner} {prefix}  {elapsed}"));
        bar.set_prefix(format!("{node} ({kind})"));
        bar.enable_steady_tick(TICK);
        let before = self.running.lock().unwrap_or_else(PoisonError::into_inner).insert(node.to_owned(), bar);
        if let Some(waiting) = before {
            waiting.finish_and_clear();
        }
    }
}

fn report(bar: &ProgressBar, progress: Progress) {
    if progress.total > 0 && bar.length() != Some(progress.total) {
        bar.set_length(progress.total);
        bar.set_style(style("{spinner} {prefix}  {bar:24} {pos}/{len}  {rate}  {eta} left  {msg}"));
    } else if progress.total == 0 && bar.length().is_none() {
        bar.set_style(style("{spinner} {prefix}  {pos}  {rate}  {elapsed}  {msg}"));
    }
    if let Some((name, value)) = progress.metric {
        bar.set_message(format!("{name} {value:.3}"));
    }
    bar.set_position(progress.step);
}

impl Observer for Terminal {
    fn event(&self, event: &Event<'_>) {
        match event {
            Event::Started { node, kind } => self.start(node, kind),
            Event::Waiting { node, kind } => {
                self.start(node, kind);
                self.with_line(node, |bar| bar.set_style(style("{spinner} {prefix}  another run is at it  {elapsed}")));
            }
            Event::Progress { node, progress } => self.with_line(node, |bar| report(bar, *progress)),
            Event::Warning { node, text } => self.warn(node, text),
            Event::Finished { node, status, seconds } => {
                let bar = self.running.lock().unwrap_or_else(PoisonError::into_inner).remove(*node);
                if let Some(bar) = bar {
                    bar.finish_and_clear();
                }
                if *status == Status::Ran && !self.lines.is_hidden() {
                    self.lines.suspend(|| eprintln!("  {node} {seconds:.1} s"));
                }
            }
            _ => {}
        }
    }
}
