//! `heartian bench track`: how long the tracker takes for a thousand frames at several sizes of its model, beside how far
//! its landmarks end up from the true ones, on the built-in recording.
//!
//! Every row is a whole fit of the same landmarks, or of every so manieth; errors are against the true projections, which no
//! detector saw. The recording's own head is the built-in one: another head's landmarks sit elsewhere on the skin, and that
//! shows in its error.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

use clap::Args;
use heartian_capture::synthetic::{SyntheticOptions, SyntheticRecording, generate};
use heartian_face::{Basis, HeadModel, HeadSource, Observations, TrackOptions, track};
use heartian_report::{TradeOff, encode_png, trade_off_figure};
use miette::{IntoDiagnostic, Result};
use serde_json::{Value, json};

use crate::summary::table;

/// What is timed.
#[derive(Args)]
#[command(after_help = "\
Examples:
  heartian bench track                     600 frames, a dozen sizes; the plot is written to bench-track/track.png
  heartian bench track --frames 150 --runs 1
  heartian bench track --json")]
pub struct TrackBench {
    /// Frames of the recording
    #[arg(long, default_value_t = 600, value_parser = clap::value_parser!(u32).range(30..=100_000))]
    frames: u32,
    /// Runs of each size; the shortest counts
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u16).range(1..=100))]
    runs: u16,
    /// Where the plot goes
    #[arg(long, value_name = "FOLDER", default_value = "bench-track")]
    out: PathBuf,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
}

/// A size of the model and of the fit.
struct Variant {
    label: String,
    group: &'static str,
    /// Modes kept of identity and of expression.
    modes: [usize; 2],
    /// One landmark of so many is given to the fit.
    every: usize,
    options: TrackOptions,
}

/// What came of it.
struct Row {
    label: String,
    group: &'static str,
    seconds_per_1000: f64,
    landmark_error_fraction: f64,
    rotation_error_deg: f64,
    jaw_correlation: f64,
    blink_f1: f64,
}

/// Times every size, prints a table or JSON, draws the plot.
pub fn run(bench: &TrackBench) -> Result<ExitCode> {
    let hertz = SyntheticOptions::default().frames_per_second;
    let options = SyntheticOptions { seconds: f64::from(bench.frames) / hertz, ..SyntheticOptions::default() };
    eprintln!("  drawing {} frames", bench.frames);
    let recording = generate(&options, &mut |_| ControlFlow::Continue(())).into_diagnostic()?;
    let mut rows = Vec::new();
    let built_in = HeadModel::procedural();
    for variant in variants(&built_in) {
        eprintln!("  {}", variant.label);
        rows.push(row(&recording, (&built_in, &variant), bench.runs)?);
    }
    if let Ok(head) = HeadModel::load(&HeadSource::Installed) {
        eprintln!("  installed head");
        let modes = [head.identity.count, head.expression.count];
        let options = TrackOptions { refine_focal: false, ..TrackOptions::default() };
        let variant = Variant { label: format!("{} head", head.name), group: "installed", modes, every: 1, options };
        rows.push(row(&recording, (&head, &variant), bench.runs)?);
    }
    let point = |row: &Row| TradeOff {
        label: row.label.clone(),
        group: row.group.to_owned(),
        seconds: row.seconds_per_1000,
        error: row.landmark_error_fraction,
    };
    let points: Vec<TradeOff> = rows.iter().map(point).collect();
    let figure = trade_off_figure(&points, "landmark error / distance of the eyes; seconds of 1,000 frames")
        .into_diagnostic()?;
    std::fs::create_dir_all(&bench.out).into_diagnostic()?;
    std::fs::write(bench.out.join("track.png"), encode_png(&figure).into_diagnostic()?).into_diagnostic()?;
    if bench.json {
        let rows: Vec<Value> = rows.iter().map(Row::json).collect();
        println!("{}", serde_json::to_string_pretty(&json!({"frames": bench.frames, "rows": rows})).into_diagnostic()?);
    } else {
        print!("{}", text(&rows));
    }
    Ok(ExitCode::SUCCESS)
}

fn variants(head: &HeadModel) -> Vec<Variant> {
    let [identity, expression] = [head.identity.count, head.expression.count];
    let whole = TrackOptions { refine_focal: false, ..TrackOptions::default() };
    let bare = TrackOptions { personal_offset: false, ..whole.clone() };
    let variant = |label: String, group: &'static str, modes: [usize; 2], options: &TrackOptions| Variant {
        label,
        group,
        modes,
        every: 1,
        options: options.clone(),
    };
    let mut all = Vec::new();
    for modes in [0, 6, 12, expression] {
        all.push(variant(format!("{modes} expressions"), "expressions", [identity, modes], &whole));
    }
    for modes in [0, identity / 2, identity] {
        all.push(variant(format!("{modes} identity modes, no offset"), "identity", [modes, expression], &bare));
    }
    for key_frames in [4, 12, 48] {
        let options = TrackOptions { key_frames, ..whole.clone() };
        all.push(variant(format!("{key_frames} key frames"), "key frames", [identity, expression], &options));
    }
    for rounds in [0, 2] {
        let options = TrackOptions { rounds, ..whole.clone() };
        all.push(variant(format!("{rounds} rounds"), "rounds", [identity, expression], &options));
    }
    for every in [2, 4, 8] {
        let whole = variant(format!("every {every}. landmark"), "landmarks", [identity, expression], &whole);
        all.push(Variant { every, ..whole });
    }
    all.push(variant("default".to_owned(), "default", [identity, expression], &whole));
    all
}

/// The head with the first of its modes only.
fn cut(head: &HeadModel, [identity, expression]: [usize; 2]) -> HeadModel {
    let first = |basis: &Basis, count: usize| {
        let values = basis.data.len().checked_div(basis.count).unwrap_or(0);
        Basis { count, data: basis.data[..count * values].to_vec() }
    };
    let joints = head.joint_identity.len().checked_div(head.identity.count).unwrap_or(0);
    HeadModel {
        identity: first(&head.identity, identity),
        joint_identity: head.joint_identity[..identity * joints].to_vec(),
        expression: first(&head.expression, expression),
        ..head.clone()
    }
}

/// One landmark of so many, in every frame.
fn thinned(seen: &Observations, every: usize) -> Result<Observations> {
    let frame = |t: usize| {
        seen.has_face(t).then(|| seen.frame(t).filter(|l| (l.index as usize).is_multiple_of(every)).collect())
    };
    let frames = (0..seen.len()).map(frame).collect();
    Observations::new(seen.width, seen.height, seen.times_seconds.clone(), frames).into_diagnostic()
}

fn row(recording: &SyntheticRecording, (head, variant): (&HeadModel, &Variant), runs: u16) -> Result<Row> {
    let head = cut(head, variant.modes);
    let observations = thinned(&recording.observations, variant.every)?;
    let camera = &recording.truth.track.camera;
    let options = TrackOptions { focal_px: Some(f64::from(camera.focal_px[0])), ..variant.options.clone() };
    let (mut best, mut found) = (f64::INFINITY, None);
    for _ in 0..runs {
        let start = Instant::now();
        let track = track(&head, &observations, &options, &mut |_| ControlFlow::Continue(()));
        best = best.min(start.elapsed().as_secs_f64());
        found = Some(track.into_diagnostic()?);
    }
    let Some(found) = found else { miette::bail!("no run was asked for") };
    let scores = recording.truth.score(&found);
    Ok(Row {
        label: variant.label.clone(),
        group: variant.group,
        seconds_per_1000: best * 1e3 / found.frames.len() as f64,
        landmark_error_fraction: scores.landmark_error_fraction,
        rotation_error_deg: scores.rotation_error_deg,
        jaw_correlation: scores.jaw_correlation,
        blink_f1: scores.blink_f1,
    })
}

impl Row {
    fn json(&self) -> Value {
        json!({
            "size": self.label, "group": self.group, "seconds_per_1000_frames": self.seconds_per_1000,
            "landmark_error_fraction": self.landmark_error_fraction, "rotation_error_deg": self.rotation_error_deg,
            "jaw_correlation": self.jaw_correlation, "blink_f1": self.blink_f1,
        })
    }
}

fn text(rows: &[Row]) -> String {
    let heading = ["size", "s / 1,000 frames", "landmark error %", "rotation °", "jaw r", "blink F1"];
    let mut lines = vec![heading.map(str::to_owned).to_vec()];
    for row in rows {
        lines.push(vec![
            row.label.clone(),
            format!("{:.2}", row.seconds_per_1000),
            format!("{:.3}", 100.0 * row.landmark_error_fraction),
            format!("{:.3}", row.rotation_error_deg),
            format!("{:.4}", row.jaw_correlation),
            format!("{:.3}", row.blink_f1),
        ]);
    }
    table(&lines, &[false, true, true, true, true, true])
}
