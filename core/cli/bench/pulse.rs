//! `heartian bench pulse`: the cohort's pooled figures, stage 2 against rasterising at every step, speed against error.

mod cohort;
mod speed;
mod stage2;

use std::process::ExitCode;

use miette::{IntoDiagnostic, Result};
use serde_json::{Map, Value, json};

use crate::arguments::PulseBenchArguments;
use crate::paired::Paired;
use crate::session::Session;
use crate::summary::table;
use cohort::{Figures, Recording};

/// Runs the cohort and the timings, prints tables or one JSON object.
pub fn run(arguments: &PulseBenchArguments) -> Result<ExitCode> {
    let session = Session::open(&arguments.host)?;
    std::fs::create_dir_all(&arguments.out).into_diagnostic()?;
    let recordings = cohort::recordings(arguments.cohort as usize, &arguments.ppg, &arguments.out)?;
    let amplitudes: Vec<Option<f64>> = if arguments.amplitude.is_empty() {
        vec![None]
    } else {
        arguments.amplitude.iter().copied().map(Some).collect()
    };
    let mut report = Map::new();
    let mut text = String::new();
    let mut curve = Vec::new();
    for amplitude in &amplitudes {
        let strength = amplitude.map(|amplitude| format!("phase.amplitude={amplitude}"));
        let sets: Vec<String> = arguments.sets.iter().cloned().chain(strength).collect();
        let figures = cohort::all_figures(&session, &recordings, &sets)?;
        if figures.is_empty() {
            break;
        }
        let pooled = pooled(&figures);
        curve.push((*amplitude, pooled.clone()));
        if curve.len() == 1 {
            text += &recordings_table(&recordings, &figures);
            text += &pooled_text(&figures, &pooled);
            report.insert("recordings".to_owned(), Value::Array(rows(&recordings, &figures)));
            report.extend(pooled.into_iter().map(|(key, value)| (key.to_owned(), json!(value))));
        }
    }
    if curve.len() > 1 {
        text += &curve_text(&curve);
        let point =
            |(amplitude, pooled): &(Option<f64>, Pooled)| json!({"amplitude": amplitude, "figures": to_map(pooled)});
        report.insert("amplitudes".to_owned(), Value::Array(curve.iter().map(point).collect()));
    }
    if !arguments.no_timing {
        let timed = stage2::measure(&session)?;
        text += &timed.text();
        report.extend(timed.json());
        let (rows, table) = speed::measure(&session, &arguments.out)?;
        text += &table;
        report.insert("speed".to_owned(), rows);
    }
    session.terminal.finish();
    std::fs::write(arguments.out.join("bench.txt"), &text).into_diagnostic()?;
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&Value::Object(report)).into_diagnostic()?);
    } else {
        print!("{text}");
    }
    Ok(ExitCode::SUCCESS)
}

/// Figures over all recordings, in the order they are shown.
type Pooled = Vec<(&'static str, f64)>;

fn to_map(pooled: &Pooled) -> Map<String, Value> {
    pooled.iter().map(|(key, value)| ((*key).to_owned(), json!(value))).collect()
}

/// Means over recordings; what one recording could not measure leaves the mean unmeasured.
fn pooled(figures: &[Figures]) -> Pooled {
    let mean = |of: &dyn Fn(&Figures) -> f64| figures.iter().map(of).sum::<f64>() / figures.len() as f64;
    let named = |name: &'static str| mean(&|f: &Figures| f.get(name));
    let percent = |f: &Figures| 100.0 * f.get("with.attribute.hr_error_bpm") / f.get("with.reference.hr_bpm");
    vec![
        ("attribute.hr_mae_bpm", named("with.attribute.hr_error_bpm")),
        ("attribute.hr_mape_percent", mean(&percent)),
        // Asked for the fundamental: the paper's reading takes the strongest bin, and of a PPG with narrow beats the second
        // harmonic may be stronger, in the reference and in the albedo alike.
        ("attribute.fundamental_hr_mae_bpm", named("fundamental.attribute.hr_error_bpm")),
        ("attribute.snr_db", named("with.attribute.snr_db")),
        ("attribute.waveform_pearson", named("with.attribute.waveform_pearson")),
        ("attribute.macc", named("with.attribute.macc")),
        ("rendered.pos.hr_mae_bpm", named("decode.rendered.pos.hr_error_bpm")),
        // The toolbox's reading, the strongest bin: a slow pulse with a strong dicrotic wave may come out as its second
        // harmonic, which the figure above asks about.
        ("rendered.pos.toolbox_hr_mae_bpm", named("toolbox.rendered.pos.hr_error_bpm")),
        ("rendered.pos.toolbox_octave_errors", figures.iter().filter(|f| is_octave_error(f)).count() as f64),
        ("rendered.chrom.hr_mae_bpm", named("decode.rendered.chrom.hr_error_bpm")),
        ("rendered.omit.hr_mae_bpm", named("decode.rendered.omit.hr_error_bpm")),
        ("rendered.green.hr_mae_bpm", named("decode.rendered.green.hr_error_bpm")),
        ("rendered.pos.snr_db", named("decode.rendered.pos.snr_db")),
        ("rendered.chrom.snr_db", named("decode.rendered.chrom.snr_db")),
        ("rendered.omit.snr_db", named("decode.rendered.omit.snr_db")),
        ("rendered.green.snr_db", named("decode.rendered.green.snr_db")),
        ("baseline_rendered.pos.hr_mae_bpm", named("decode.baseline_rendered.pos.hr_error_bpm")),
        ("delta.psnr_db", mean(&|f| f.cost("psnr_db"))),
        ("delta.ssim", mean(&|f| f.cost("ssim"))),
        ("baseline.psnr_db", named("render.baseline.psnr_db")),
        ("pulse.levels_8bit", named("phase.phase.levels_8bit")),
    ]
}

/// Whether POS reads about twice the rate that was written, by the toolbox's reading.
fn is_octave_error(figures: &Figures) -> bool {
    let ratio = figures.get("toolbox.rendered.pos.hr_bpm") / figures.get("with.reference.hr_bpm");
    (1.9..2.1).contains(&ratio)
}

/// SNR of each method on the modulated clip.
fn rendered_snr(figures: &Figures) -> Map<String, Value> {
    let of = |method: &str| json!(figures.get(&format!("decode.rendered.{method}.snr_db")));
    ["pos", "chrom", "omit", "green"].into_iter().map(|method| (method.to_owned(), of(method))).collect()
}

/// One row a recording, for JSON.
fn rows(recordings: &[Recording], figures: &[Figures]) -> Vec<Value> {
    let row = |(recording, figures): (&Recording, &Figures)| {
        json!({
            "skin_tone": recording.tone, "light": recording.light, "pulse": recording.pulse,
            "reference.hr_bpm": figures.get("with.reference.hr_bpm"),
            "reference.fundamental_hr_bpm": figures.get("fundamental.reference.hr_bpm"),
            "phase.shown_share": figures.get("phase.phase.shown_share"),
            "attribute.hr_error_bpm": figures.get("with.attribute.hr_error_bpm"),
            "attribute.waveform_pearson": figures.get("with.attribute.waveform_pearson"),
            "attribute.snr_db": figures.get("with.attribute.snr_db"),
            "without_residual.waveform_pearson": figures.get("without.attribute.waveform_pearson"),
            "rendered.pos.hr_error_bpm": figures.get("decode.rendered.pos.hr_error_bpm"),
            "rendered.snr_db": rendered_snr(figures),
            "baseline_rendered.pos.hr_error_bpm": figures.get("decode.baseline_rendered.pos.hr_error_bpm"),
            "delta.psnr_db": figures.cost("psnr_db"), "delta.ssim": figures.cost("ssim"),
            "baseline.psnr_db": figures.get("render.baseline.psnr_db"),
        })
    };
    recordings.iter().zip(figures).map(row).collect()
}

fn recordings_table(recordings: &[Recording], figures: &[Figures]) -> String {
    let heading = [
        "skin",
        "light",
        "pulse",
        "bpm",
        "fundamental",
        "albedo Δbpm",
        "Pearson",
        "no residual",
        "SNR dB",
        "POS Δbpm",
        "baseline Δbpm",
        "PSNR dB",
        "ΔPSNR dB",
        "ΔSSIM",
    ];
    let mut rows = vec![heading.map(str::to_owned).to_vec()];
    for (recording, f) in recordings.iter().zip(figures) {
        let mut row = vec![recording.tone.to_owned(), recording.light.to_owned(), recording.pulse.clone()];
        for (name, decimals) in [
            ("with.reference.hr_bpm", 2),
            ("fundamental.reference.hr_bpm", 2),
            ("with.attribute.hr_error_bpm", 2),
            ("with.attribute.waveform_pearson", 4),
            ("without.attribute.waveform_pearson", 4),
            ("with.attribute.snr_db", 1),
            ("decode.rendered.pos.hr_error_bpm", 2),
            ("decode.baseline_rendered.pos.hr_error_bpm", 2),
            ("render.baseline.psnr_db", 2),
        ] {
            row.push(format!("{:.decimals$}", f.get(name)));
        }
        row.push(format!("{:+.4}", f.cost("psnr_db")));
        row.push(format!("{:+.6}", f.cost("ssim")));
        rows.push(row);
    }
    let right: Vec<bool> = (0..heading.len()).map(|column| column > 2).collect();
    format!("{}\n", table(&rows, &right))
}

/// What each pooled figure is and should be.
const GOALS: [(&str, &str); 9] = [
    ("attribute.hr_mae_bpm", "≤ 0.1"),
    ("attribute.fundamental_hr_mae_bpm", "≤ 0.1"),
    ("attribute.hr_mape_percent", "≤ 0.15"),
    ("attribute.snr_db", "> 3–4 (paper)"),
    ("attribute.waveform_pearson", "≥ 0.98"),
    ("rendered.pos.hr_mae_bpm", "≤ 1.0"),
    ("delta.psnr_db", "≤ 0.005"),
    ("delta.ssim", "≤ 0.00003"),
    ("baseline_rendered.pos.hr_mae_bpm", "the same without a pulse"),
];

fn pooled_text(figures: &[Figures], pooled: &Pooled) -> String {
    let mut rows = vec![["pooled", "measured", "goal"].map(str::to_owned).to_vec()];
    for (key, value) in pooled {
        let goal = GOALS.iter().find(|(name, _)| name == key).map_or("", |(_, goal)| goal);
        rows.push(vec![(*key).to_owned(), format!("{value:.6}"), goal.to_owned()]);
    }
    let difference = |name: &str| -> Vec<f64> {
        figures
            .iter()
            .map(|f| f.get(&format!("with.attribute.{name}")) - f.get(&format!("without.attribute.{name}")))
            .collect()
    };
    let mut text =
        format!("{}\nresidual on less off, paired over recordings, 95 % interval\n", table(&rows, &[false, true]));
    for (name, decimals, better) in [
        ("waveform_pearson", 5, "more is better"),
        ("macc", 5, "more is better"),
        ("hr_error_bpm", 3, "less is better"),
        ("snr_db", 2, "at the reference's rate: narrow lines score, variability of beats does not"),
    ] {
        if let Some(paired) = Paired::of(&difference(name)) {
            text += &format!("  {name:18} {}  {better}\n", paired.show(decimals));
        }
    }
    text.push('\n');
    text
}

/// Picture cost against recoverability over strengths.
fn curve_text(curve: &[(Option<f64>, Pooled)]) -> String {
    let heading = ["amplitude", "levels", "POS MAE bpm", "POS SNR dB", "ΔPSNR dB", "ΔSSIM"];
    let mut rows = vec![heading.map(str::to_owned).to_vec()];
    for (amplitude, pooled) in curve {
        let of = |key: &str| pooled.iter().find(|(name, _)| *name == key).map_or(f64::NAN, |(_, value)| *value);
        rows.push(vec![
            amplitude.map_or_else(String::new, |amplitude| amplitude.to_string()),
            format!("{:.2}", of("pulse.levels_8bit")),
            format!("{:.3}", of("rendered.pos.hr_mae_bpm")),
            format!("{:.2}", of("rendered.pos.snr_db")),
            format!("{:+.5}", of("delta.psnr_db")),
            format!("{:+.7}", of("delta.ssim")),
        ]);
    }
    format!("strength of the pulse\n{}\n", table(&rows, &[true; 6]))
}
