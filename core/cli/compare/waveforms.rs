//! What a run changes against the first: paired differences over windows of the waveforms, and their picture.
//!
//! A run leaves the waveforms that were prescribed and read in `waveforms.csv`, filtered by the reader's protocol. Runs
//! of one recording are cut into the same windows, so each window is its own control. Runs without the file, or of
//! another recording, are left out and said so.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use heartian_report::{Curve, encode_png, waveform_figure};
use heartian_signal::stats::{macc, pearson};
use heartian_signal::{Band, Resolution, Spectrum};
use heartian_space::Series;
use miette::{IntoDiagnostic, Result, WrapErr};

use crate::deliver::MetricsFile;
use crate::paired::Paired;
use crate::summary::table;

/// What was to be written, and what the skin carries.
const PRESCRIBED: &str = "prescribed";
const ATTRIBUTE: &str = "attribute";
/// Length of a window and distance of their starts, seconds: about ten beats, half of them new.
const WINDOW_SECONDS: f64 = 8.0;
const HOP_SECONDS: f64 = 4.0;
/// How much of the waveforms is drawn, seconds.
const DRAWN_SECONDS: f64 = 10.0;
/// Largest file read, bytes.
const MOST_BYTES: u64 = 1 << 28;

/// The waveforms of a run by label.
type Waveforms = BTreeMap<String, Series>;

/// One window: correlation, best correlation over lags, heart-rate error, signal to noise.
struct Window([f64; 4]);

const COLUMNS: [(&str, usize); 4] = [("Pearson", 5), ("MACC", 5), ("HR error, bpm", 3), ("SNR, dB", 2)];

/// Prints the differences and draws the waveforms; nothing when no run left any.
pub fn print(runs: &[PathBuf], files: &[MetricsFile], names: &[String], plot: Option<&Path>) -> Result<()> {
    let waveforms: Vec<Option<Waveforms>> = runs.iter().map(|run| read(run)).collect::<Result<_>>()?;
    let Some(Some(first)) = waveforms.first() else { return Ok(()) };
    let before = windows(first);
    let mut rows = vec![vec![format!("against {}", names[0])]];
    rows[0].extend(COLUMNS.map(|(name, _)| name.to_owned()));
    rows[0].push("ΔPSNR, dB".to_owned());
    for ((name, file), waveforms) in names.iter().zip(files).zip(&waveforms).skip(1) {
        let after = waveforms.as_ref().map(windows).unwrap_or_default();
        if after.len() != before.len() {
            rows.push(vec![name.clone(), "no waveforms of the same recording".to_owned()]);
            continue;
        }
        let mut row = vec![name.clone()];
        for (column, (_, decimals)) in COLUMNS.iter().enumerate() {
            let differences: Vec<f64> =
                before.iter().zip(&after).map(|(before, after)| after.0[column] - before.0[column]).collect();
            row.push(Paired::of(&differences).map_or("not measured".to_owned(), |paired| paired.show(*decimals)));
        }
        row.push(format!("{:+.4}", psnr_cost(file) - psnr_cost(&files[0])));
        rows.push(row);
    }
    if rows.len() > 1 {
        print!("\n{}", table(&rows, &[false; 6]));
        println!(
            "  mean [95 % interval] over {} windows of {WINDOW_SECONDS} s; ΔPSNR is the cost to the picture",
            before.len()
        );
    }
    draw(runs, names, &waveforms, plot)
}

/// PSNR of the baseline less that of the modulated picture, decibels.
fn psnr_cost(file: &MetricsFile) -> f64 {
    let get = |key: &str| file.number(key).unwrap_or(f64::NAN);
    get("baseline.psnr_db") - get("modulated.psnr_db")
}

/// The waveforms that a run left; `None` when it left none.
fn read(run: &Path) -> Result<Option<Waveforms>> {
    let folder = if run.is_dir() { run } else { run.parent().unwrap_or(run) };
    let path = folder.join("waveforms.csv");
    let small = std::fs::metadata(&path).is_ok_and(|metadata| metadata.len() <= MOST_BYTES);
    if !small {
        return Ok(None);
    }
    let text = std::fs::read_to_string(&path).into_diagnostic()?;
    let mut samples: BTreeMap<String, (Vec<f64>, Vec<f64>)> = BTreeMap::new();
    for line in text.lines().skip(1) {
        let mut cells = line.splitn(3, ',');
        let (label, time, value) = (cells.next(), cells.next(), cells.next());
        let number = |cell: Option<&str>| cell.and_then(|cell| cell.parse::<f64>().ok());
        if let (Some(label), Some(time), Some(value)) = (label, number(time), number(value)) {
            let (times, values) = samples.entry(label.to_owned()).or_default();
            times.push(time);
            values.push(value);
        }
    }
    let series = |(label, (times, values)): (String, (Vec<f64>, Vec<f64>))| Ok((label, Series::new(times, values)?));
    let read: Result<Waveforms, heartian_space::SpaceError> = samples.into_iter().map(series).collect();
    read.map(Some).into_diagnostic().wrap_err_with(|| format!("`{}` is damaged", path.display()))
}

/// The figures of each window; none without both waveforms on one grid.
fn windows(waveforms: &Waveforms) -> Vec<Window> {
    let (Some(wanted), Some(found)) = (waveforms.get(PRESCRIBED), waveforms.get(ATTRIBUTE)) else { return Vec::new() };
    let rate_hertz = wanted.rate_hertz();
    let (length, hop) = ((WINDOW_SECONDS * rate_hertz) as usize, (HOP_SECONDS * rate_hertz) as usize);
    if wanted.len() != found.len() || length < 16 || wanted.len() < length {
        return Vec::new();
    }
    let starts = (0..=wanted.len() - length).step_by(hop.max(1));
    starts
        .map(|start| window(&wanted.values[start..][..length], &found.values[start..][..length], rate_hertz))
        .collect()
}

fn window(wanted: &[f64], found: &[f64], rate_hertz: f64) -> Window {
    let band = Band::PAPER;
    let rate = |signal: &[f64]| {
        let spectrum = Spectrum::of(signal, rate_hertz, Resolution::FINE).ok()?;
        Some((spectrum.refined_bpm(spectrum.peak_bin(band).ok()?), spectrum))
    };
    let (mut error, mut snr) = (f64::NAN, f64::NAN);
    if let (Some((wanted_bpm, _)), Some((found_bpm, spectrum))) = (rate(wanted), rate(found)) {
        error = (found_bpm - wanted_bpm).abs();
        snr = spectrum.snr_db(wanted_bpm, band);
    }
    Window([pearson(found, wanted).unwrap_or(f64::NAN), macc(found, wanted).unwrap_or(f64::NAN), error, snr])
}

fn draw(runs: &[PathBuf], names: &[String], waveforms: &[Option<Waveforms>], plot: Option<&Path>) -> Result<()> {
    let mut curves = Vec::new();
    for (name, waveforms) in names.iter().zip(waveforms) {
        let Some(waveforms) = waveforms else { continue };
        if let Some(prescribed) = waveforms.get(PRESCRIBED).filter(|_| curves.is_empty()) {
            curves.push(curve(PRESCRIBED, prescribed)?);
        }
        if let Some(attribute) = waveforms.get(ATTRIBUTE) {
            curves.push(curve(name, attribute)?);
        }
    }
    if curves.len() < 2 {
        return Ok(());
    }
    let beside = || runs[0].parent().unwrap_or(Path::new(".")).join("compare.png");
    let path = plot.map_or_else(beside, Path::to_owned);
    let band = (Band::TOOLBOX.low_hertz, Band::TOOLBOX.high_hertz);
    let figure = waveform_figure(&curves, DRAWN_SECONDS, band).into_diagnostic()?;
    std::fs::write(&path, encode_png(&figure).into_diagnostic()?)
        .into_diagnostic()
        .wrap_err_with(|| format!("cannot write `{}`", path.display()))?;
    println!("  {}", path.display());
    Ok(())
}

fn curve(label: &str, series: &Series) -> Result<Curve> {
    let spectrum = Spectrum::of(&series.values, series.rate_hertz(), Resolution::FINE).into_diagnostic()?;
    let hertz = (0..spectrum.power.len()).map(|bin| spectrum.hertz(bin)).collect();
    Ok(Curve { label: label.to_owned(), series: series.clone(), spectrum: (hertz, spectrum.power) })
}
