//! Whole processes, measured from outside: wall time, processor time, peak memory.

use std::process::{Command, Stdio};
use std::time::Instant;

use miette::{IntoDiagnostic, Result};
use serde::Serialize;

/// One process from start to end.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Measured {
    /// Seconds on the clock.
    pub wall_s: f64,
    /// Seconds of processors, user and system, its children included; nothing where the system does not tell.
    pub cpu_s: Option<f64>,
    /// Most memory resident at once, bytes.
    pub peak_bytes: Option<u64>,
    /// It ended well.
    pub success: bool,
}

/// Runs a command to its end; its output goes nowhere.
pub fn measure(command: &mut Command) -> Result<Measured> {
    let start = Instant::now();
    let child = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().into_diagnostic()?;
    wait(child, start).into_diagnostic()
}

#[cfg(unix)]
fn wait(child: std::process::Child, start: Instant) -> std::io::Result<Measured> {
    let mut status = 0;
    // SAFETY: `rusage` is plain numbers, for which zero is a value.
    let mut usage: libc::rusage = unsafe { std::mem::zeroed() };
    loop {
        // SAFETY: both pointers are to live values of the types the call fills; the child is ours and not yet waited for.
        let waited = unsafe { libc::wait4(child.id() as libc::pid_t, &mut status, 0, &mut usage) };
        if waited >= 0 {
            break;
        }
        let error = std::io::Error::last_os_error();
        if error.kind() != std::io::ErrorKind::Interrupted {
            return Err(error);
        }
    }
    let seconds = |time: libc::timeval| time.tv_sec as f64 + time.tv_usec as f64 * 1e-6;
    /// Linux tells kibibytes, macOS bytes.
    const UNIT: u64 = if cfg!(target_os = "macos") { 1 } else { 1024 };
    Ok(Measured {
        wall_s: start.elapsed().as_secs_f64(),
        cpu_s: Some(seconds(usage.ru_utime) + seconds(usage.ru_stime)),
        peak_bytes: u64::try_from(usage.ru_maxrss).ok().map(|peak| peak * UNIT),
        success: libc::WIFEXITED(status) && libc::WEXITSTATUS(status) == 0,
    })
}

#[cfg(not(unix))]
fn wait(mut child: std::process::Child, start: Instant) -> std::io::Result<Measured> {
    let success = child.wait()?.success();
    Ok(Measured { wall_s: start.elapsed().as_secs_f64(), cpu_s: None, peak_bytes: None, success })
}

/// Least and median of some figures; zeros when there are none.
pub fn least_and_median(figures: impl Iterator<Item = f64>) -> [f64; 2] {
    let mut sorted: Vec<f64> = figures.collect();
    sorted.sort_by(f64::total_cmp);
    let at = |index: usize| sorted.get(index).copied().unwrap_or(0.0);
    [at(0), at(sorted.len() / 2)]
}
