//! `heartian bench decoder`: networks, classical methods and post-processing, beside rPPG-Toolbox's own times.
//!
//! The toolbox's figures are its CPU times on two threads of the machine this was first measured on (PyTorch 2.1, SciPy
//! 1.13); run it beside this for your own. Nothing is read: weights are seeded, frames and traces are made here.

use std::hint::black_box;
use std::process::ExitCode;
use std::time::Instant;

use clap::Args;
use heartian_decoder::bench::time_all;
use heartian_signal::metrics::Evaluation;
use heartian_signal::trace::{Weighting, mean_rgb};
use heartian_signal::{Method, SignalError};
use heartian_space::{Clip, Sequence};
use miette::{IntoDiagnostic, Result};

use crate::summary::table;

/// What is timed.
#[derive(Args)]
pub struct DecoderBench {
    /// Runs of each; the shortest and the middle one are told
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..=1000))]
    runs: u16,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
}

/// The toolbox's input to classical methods: a minute of 72×72 crops.
const FRAMES: usize = 1800;
const SIDE: usize = 72;
const HERTZ: f64 = 30.0;

/// The toolbox's seconds.
fn peer_seconds(name: &str) -> Option<f64> {
    Some(match name {
        "TS-CAN" => 1.305,
        "PhysFormer" => 1.283,
        "FactorizePhys" => 0.095,
        "PhysNet" => 0.186,
        "POS" => 0.376,
        "CHROM" => 0.0146,
        "ICA" => 0.818,
        "post-processing" => 0.593,
        _ => return None,
    })
}

/// One line of the result.
struct Line {
    name: &'static str,
    input: String,
    seconds: Vec<f64>,
}

impl Line {
    fn best(&self) -> f64 {
        self.seconds.iter().copied().fold(f64::INFINITY, f64::min)
    }

    fn median(&self) -> f64 {
        let mut sorted = self.seconds.clone();
        sorted.sort_by(f64::total_cmp);
        sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
    }
}

/// Times everything and prints it.
pub fn run(arguments: &DecoderBench) -> Result<ExitCode> {
    let runs = usize::from(arguments.runs);
    let mut lines = networks(runs)?;
    lines.extend(methods(runs)?);
    if arguments.json {
        let one = |line: &Line| {
            serde_json::json!({
                "name": line.name,
                "input": line.input,
                "seconds": line.best(),
                "median_seconds": line.median(),
                "peer_seconds": peer_seconds(line.name),
            })
        };
        let threads = rayon::current_num_threads();
        println!(
            "{:#}",
            serde_json::json!({ "threads": threads, "results": lines.iter().map(one).collect::<Vec<_>>() })
        );
        return Ok(ExitCode::SUCCESS);
    }
    let heading = ["decoder", "input", "best s", "median s", "rPPG-Toolbox s", "times as fast"].map(str::to_owned);
    let row = |line: &Line| {
        let peer = peer_seconds(line.name);
        let times = peer.map(|peer| format!("{:.1}", peer / line.best()));
        let seconds = |value: f64| format!("{value:.5}");
        let peer = peer.map(|peer| format!("{peer:.3}"));
        let [peer, times] = [peer, times].map(|cell| cell.unwrap_or_default());
        vec![line.name.to_owned(), line.input.clone(), seconds(line.best()), seconds(line.median()), peer, times]
    };
    let rows: Vec<Vec<String>> = std::iter::once(heading.to_vec()).chain(lines.iter().map(row)).collect();
    print!("{}", table(&rows, &[false, false, true, true, true, true]));
    Ok(ExitCode::SUCCESS)
}

fn networks(runs: usize) -> Result<Vec<Line>> {
    let line = |timing: heartian_decoder::bench::Timing| Line {
        name: timing.architecture.name(),
        input: format!("{} frames of {}×{}", timing.frames, timing.side_px, timing.side_px),
        seconds: timing.seconds,
    };
    Ok(time_all(runs).into_diagnostic()?.into_iter().map(line).collect())
}

/// The classical methods from the frames on, as the toolbox's figures are, and the scoring of a trace against another.
fn methods(runs: usize) -> Result<Vec<Line>> {
    let clip = clip()?;
    let input = format!("{FRAMES} frames of {SIDE}×{SIDE}");
    let mut lines = Vec::new();
    for method in Method::ALL {
        let seconds = time(runs, || method.trace(&mean_rgb(&clip, Weighting::WholeFrame)?, HERTZ)).into_diagnostic()?;
        lines.push(Line { name: method.name(), input: input.clone(), seconds });
    }
    let rgb = mean_rgb(&clip, Weighting::WholeFrame).into_diagnostic()?;
    let trace = Method::Pos.trace(&rgb, HERTZ).into_diagnostic()?;
    let label = Method::Green.trace(&rgb, HERTZ).into_diagnostic()?;
    let seconds = time(runs, || Evaluation::default().score(&trace, &label, HERTZ)).into_diagnostic()?;
    lines.push(Line { name: "post-processing", input: format!("2 × {FRAMES} samples"), seconds });
    Ok(lines)
}

/// Seconds of each run, after one that is not counted.
fn time<T>(runs: usize, work: impl Fn() -> Result<T, SignalError>) -> Result<Vec<f64>, SignalError> {
    black_box(work()?);
    let one = |_| {
        let start = Instant::now();
        black_box(work()?);
        Ok(start.elapsed().as_secs_f64())
    };
    (0..runs).map(one).collect()
}

/// A minute of a beating, textured patch.
fn clip() -> Result<Clip> {
    let pixels = SIDE * SIDE;
    let code = |index: usize| {
        let time = (index / (3 * pixels)) as f64 / HERTZ;
        let beat = (std::f64::consts::TAU * 1.2 * time).sin();
        let light = 3.0 * (std::f64::consts::TAU * 0.17 * time).sin();
        let channel = index % 3;
        ([150.0, 110.0, 90.0][channel] + [0.5, 1.5, 0.9][channel] * beat + light + (index * 7919 % 23) as f64) as u8
    };
    let sequence = Sequence {
        frames: (0..FRAMES * pixels * 3).map(code).collect(),
        alpha: vec![255; FRAMES * pixels],
        times_seconds: (0..FRAMES).map(|frame| frame as f64 / HERTZ).collect(),
    };
    Clip::new("bench", SIDE, SIDE, sequence).into_diagnostic()
}
