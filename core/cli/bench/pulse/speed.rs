//! Speed against error on one recording of the cohort: iterations, residual width, precision, linear map or rasteriser.
//!
//! Every row is a fit to the end; none is extrapolated. Seconds are wall time on a machine that may be busy.

use std::path::Path;
use std::time::Instant;

use heartian_avatar::{FrozenRender, RenderOptions, evaluate, render_clip};
use heartian_face::Track;
use heartian_pulse::{FrameByFrame, FrozenRenderer, PhaseOptions, Precision, ResidualOptions, Scene, mean_offsets};
use heartian_report::{TradeOff, encode_png, trade_off_figure};
use heartian_signal::{Preset, estimate, resampled_evenly, stats::pearson};
use heartian_space::{Clip, Modulation, Sequence};
use miette::{IntoDiagnostic, Result};
use serde_json::{Value, json};

use super::cohort::{plan, recordings};
use super::stage2::Subject;
use crate::session::Session;
use crate::summary::table;

/// Iterations of an epoch of the paper: a thousand frames.
const EPOCH: u32 = 1000;

/// How one row is fitted.
struct Variant {
    label: String,
    group: &'static str,
    phase: PhaseOptions,
    residual: Option<ResidualOptions>,
    rasterised: bool,
}

/// What came of it.
struct Row {
    label: String,
    group: &'static str,
    epochs: u32,
    /// Width and precision of the residual, if there is one.
    residual: Option<(usize, &'static str)>,
    rasterised: bool,
    seconds: f64,
    hr_error_bpm: f64,
    pearson: f64,
    delta_psnr_db: f64,
    /// Distance of the modulation to that of the variant's twin, as a share of the twin's own size.
    apart: Option<f64>,
    modulation: Modulation,
}

/// Fits every variant on the cohort's first recording; leaves `speed.png` in `folder`.
pub fn measure(session: &Session, folder: &Path) -> Result<(Value, String)> {
    let recording = recordings(1, &[], folder)?;
    let subject = Subject::fetch(session, &plan(&recording[0], &[], &["skin"])?)?;
    let judge = Judge::new(&subject)?;
    let mut rows: Vec<Row> = Vec::new();
    for variant in variants() {
        eprintln!("  speed against error: {}", variant.label);
        let mut row = judge.row(&variant)?;
        // A rasterised row follows its twin through the linear map.
        if variant.rasterised
            && let Some(twin) = rows.last()
        {
            row.apart = Some(apart(&row.modulation, &twin.modulation));
        }
        rows.push(row);
    }
    let points = rows.iter().map(|row| TradeOff {
        label: row.label.clone(),
        group: row.group.to_owned(),
        seconds: row.seconds,
        error: 1.0 - row.pearson,
    });
    let figure = trade_off_figure(&points.collect::<Vec<_>>(), "1 − waveform Pearson").into_diagnostic()?;
    std::fs::write(folder.join("speed.png"), encode_png(&figure).into_diagnostic()?).into_diagnostic()?;
    Ok((Value::Array(rows.iter().map(Row::json).collect()), text(&rows)))
}

fn variants() -> Vec<Variant> {
    let phase = |steps: u32| PhaseOptions { steps, ..PhaseOptions::paper() };
    let paper = PhaseOptions::paper().steps;
    let residual = ResidualOptions::default();
    let variant = |label: String, group: &'static str, steps: u32, residual: Option<ResidualOptions>| Variant {
        label,
        group,
        phase: phase(steps),
        residual,
        rasterised: false,
    };
    let mut all = Vec::new();
    for epochs in [0, 1, 3, 10, 30, paper / EPOCH] {
        let label = format!("{epochs} epochs, no residual");
        all.push(variant(label, "epochs, no residual", epochs * EPOCH, None));
    }
    for width in [16, 32, 64, 128, 256] {
        let options = ResidualOptions { width, ..residual };
        all.push(variant(format!("3 epochs, residual {width}"), "residual width", 3 * EPOCH, Some(options)));
    }
    let double = ResidualOptions { precision: Precision::Double, ..residual };
    all.push(variant("3 epochs, residual 128 in f64".to_owned(), "f64", 3 * EPOCH, Some(double)));
    all.push(variant("60 epochs, residual 128 (default)".to_owned(), "default", paper, Some(residual)));
    for residual in [None, Some(residual)] {
        let tail = if residual.is_some() { ", residual 128" } else { "" };
        all.push(variant(format!("3 epochs{tail}, linear map"), "linear map", 3 * EPOCH, residual));
        let rasterised = variant(format!("3 epochs{tail}, rasterised"), "rasterised", 3 * EPOCH, residual);
        all.push(Variant { rasterised: true, ..rasterised });
    }
    for variant in all.iter_mut().filter(|variant| ["linear map", "rasterised"].contains(&variant.group)) {
        // Three epochs take A where sixty would: L_base is all that moves it, and one frame a step pulls unsteadily.
        variant.phase.rates.scale *= 20.0;
    }
    all
}

/// The recording, and how a modulation of it is judged.
struct Judge<'a> {
    subject: &'a Subject,
    reference_bpm: f64,
    reference: Vec<f64>,
    /// Held-out frames of recording and track, and the baseline's PSNR on them.
    recorded: Clip,
    track: Track,
    held_out: std::ops::Range<usize>,
    baseline_psnr_db: f64,
}

impl<'a> Judge<'a> {
    fn new(subject: &'a Subject) -> Result<Self> {
        let (clip, track) = (&subject.clip, &subject.track);
        let held_out = subject.avatar.training_frames..clip.len();
        let times: Vec<f64> = clip.times_seconds[held_out.clone()].to_vec();
        let sequence = Sequence {
            frames: held_out.clone().flat_map(|frame| clip.frame(frame).to_vec()).collect(),
            alpha: held_out.clone().flat_map(|frame| clip.frame_alpha(frame).to_vec()).collect(),
            times_seconds: times.clone(),
        };
        let recorded = Clip::new("input", clip.width, clip.height, sequence).into_diagnostic()?;
        let frames = track.frames[held_out.clone()].to_vec();
        let track = Track { frames, times_seconds: times, ..Track::clone(track) };
        let (reference_bpm, reference) = read(&subject.reference.times_seconds, &subject.reference.waveform)?;
        let mut judge =
            Self { subject, reference_bpm, reference, recorded, track, held_out, baseline_psnr_db: f64::NAN };
        judge.baseline_psnr_db = judge.psnr_db(None)?;
        Ok(judge)
    }

    fn psnr_db(&self, modulation: Option<&Modulation>) -> Result<f64> {
        let options = RenderOptions { label: "held out", modulation, ..RenderOptions::default() };
        let rendered = render_clip(&self.subject.avatar, &self.track, &options).into_diagnostic()?;
        let frames: Vec<usize> = (0..self.recorded.len()).collect();
        Ok(evaluate(&rendered, &self.recorded, &frames).into_diagnostic()?.psnr_db)
    }

    fn row(&self, variant: &Variant) -> Result<Row> {
        let subject = self.subject;
        let frozen = FrozenRender::new(&subject.avatar, &subject.skin, &subject.clip).into_diagnostic()?;
        let render = |frame: usize, offsets: &[f32], gradient: &mut [f32]| {
            frozen.loss(frame, offsets, gradient).map_err(|error| error.to_string())
        };
        let rasteriser = FrameByFrame {
            gaussians: subject.skin.gaussians.len(),
            frames: subject.avatar.training_frames,
            levels_per_albedo: FrozenRenderer::levels_per_albedo(&*subject.operator),
            seed: 1,
            render: &render,
        };
        let mut scene: Scene<'_> = subject.scene();
        if variant.rasterised {
            scene.renderer = Some(&rasteriser);
        }
        let start = Instant::now();
        let (_, modulation) = subject.fit(&scene, &variant.phase, variant.residual.as_ref()).into_diagnostic()?;
        let seconds = start.elapsed().as_secs_f64();
        let (bpm, filtered) = read(&modulation.times_seconds, &mean_offsets(&modulation))?;
        let n = modulation.gaussians.len();
        let kept = Modulation {
            times_seconds: self.recorded.times_seconds.clone(),
            offsets: modulation.offsets[self.held_out.start * n..].to_vec(),
            ..modulation.clone()
        };
        Ok(Row {
            label: variant.label.clone(),
            group: variant.group,
            epochs: variant.phase.steps / EPOCH,
            residual: variant.residual.map(|options| (options.width, precision(options.precision))),
            rasterised: variant.rasterised,
            seconds,
            hr_error_bpm: (bpm - self.reference_bpm).abs(),
            pearson: pearson(&filtered, &self.reference).into_diagnostic()?,
            delta_psnr_db: self.baseline_psnr_db - self.psnr_db(Some(&kept))?,
            apart: None,
            modulation,
        })
    }
}

/// Heart rate and filtered trace by the paper's protocol.
fn read(times: &[f64], values: &[f64]) -> Result<(f64, Vec<f64>)> {
    let even = resampled_evenly(times, values).into_diagnostic()?;
    let rate = estimate(&even.values, even.rate_hertz, Preset::Paper).into_diagnostic()?;
    Ok((rate.bpm, rate.filtered))
}

/// In what the network is trained; phase and waveform are always f64.
fn precision(precision: Precision) -> &'static str {
    match precision {
        Precision::Single => "f32",
        Precision::Double => "f64",
    }
}

fn apart(a: &Modulation, b: &Modulation) -> f64 {
    let square = |values: &mut dyn Iterator<Item = f32>| values.map(|value| f64::from(value).powi(2)).sum::<f64>();
    let difference = square(&mut a.offsets.iter().zip(&b.offsets).map(|(a, b)| a - b));
    (difference / square(&mut b.offsets.iter().copied()).max(1e-30)).sqrt()
}

impl Row {
    fn json(&self) -> Value {
        json!({
            "label": self.label, "epochs": self.epochs, "residual_width": self.residual.map(|(width, _)| width),
            "precision": self.residual.map(|(_, precision)| precision), "surrogate": !self.rasterised,
            "seconds": self.seconds, "attribute.hr_error_bpm": self.hr_error_bpm,
            "attribute.waveform_pearson": self.pearson, "delta.psnr_db": self.delta_psnr_db,
            "apart_from_linear_map": self.apart,
        })
    }
}

fn text(rows: &[Row]) -> String {
    let heading = [
        "speed against error",
        "epochs",
        "width",
        "network",
        "renderer",
        "seconds",
        "Δbpm",
        "Pearson",
        "ΔPSNR dB",
        "apart from the linear map's",
    ];
    let mut cells = vec![heading.map(str::to_owned).to_vec()];
    for row in rows {
        cells.push(vec![
            row.label.clone(),
            row.epochs.to_string(),
            row.residual.map_or_else(String::new, |(width, _)| width.to_string()),
            row.residual.map_or_else(String::new, |(_, precision)| precision.to_owned()),
            if row.rasterised { "every step" } else { "linear map" }.to_owned(),
            format!("{:.2}", row.seconds),
            format!("{:.3}", row.hr_error_bpm),
            format!("{:.5}", row.pearson),
            format!("{:+.5}", row.delta_psnr_db),
            row.apart.map_or_else(String::new, |apart| format!("{:.2} %", 100.0 * apart)),
        ]);
    }
    let right: Vec<bool> = (0..heading.len()).map(|column| ![0, 3, 4].contains(&column)).collect();
    format!("{}\n", table(&cells, &right))
}
