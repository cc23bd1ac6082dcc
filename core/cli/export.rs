//! `heartian export`: a video and its pulse in the layout of a public data set.

use std::io::{BufWriter, Write};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;
use heartian_capture::export::{AviForm, AviWriter, Layout, Place, labels, png};
use heartian_capture::ppg::read_ppg;
use heartian_capture::video::{TimedFrame, VideoError, VideoOptions, for_each_frame, open};
use heartian_signal::{Preset, estimate, resampled_evenly};
use heartian_space::Series;
use miette::{IntoDiagnostic, Result, WrapErr, miette};

/// An export.
#[derive(Args)]
#[command(after_help = "\
Examples:
  heartian export runs/full-1a2b3c4d/render.modulated.avi --ppg me.csv --out UBFC --subject 1
  heartian export me.mp4 --ppg me.csv --layout pure --out PURE --subject 3 --recording 2

UBFC-rPPG: OUT/subjectN/vid.avi (raw BGR24, at most 4 GiB) and ground_truth.txt. PURE: OUT/SS-TT/SS-TT/*.png and SS-TT.json.
rPPG-Toolbox reads both as they are. To export the clips of a graph with the pulse that was written into them, use the node
DatasetExporter: heartian run graphs/export.ron")]
pub struct ExportArguments {
    /// A video file, a folder of PNG, JPEG, EXR or BMP frames, or a recording of a data set
    pub video: PathBuf,
    /// The pulse: CSV with the header `time_s,ppg` on the video's clock, at any rate
    #[arg(long, value_name = "CSV")]
    pub ppg: PathBuf,
    /// The data set's folder
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// The data set's layout
    #[arg(long, value_enum, default_value_t = LayoutChoice::Ubfc)]
    pub layout: LayoutChoice,
    /// Number of the subject
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub subject: u32,
    /// Number of the subject's recording (PURE)
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub recording: u32,
    /// Frame rate of a folder of frames without a file of times
    #[arg(long, value_name = "HERTZ")]
    pub fps: Option<f64>,
}

/// A data set's layout.
#[derive(clap::ValueEnum, Clone, Copy)]
pub enum LayoutChoice {
    /// subjectN/vid.avi and ground_truth.txt
    Ubfc,
    /// SS-TT/SS-TT/*.png and SS-TT.json
    Pure,
}

/// What stops an export.
#[derive(Debug, thiserror::Error)]
enum ExportError {
    #[error(transparent)]
    Video(#[from] VideoError),
    #[error("cannot write `{path}`: {error}")]
    Write { path: String, error: std::io::Error },
}

/// Exports one recording. The video is read twice, for its times and for its frames, and never held.
pub fn run(arguments: &ExportArguments) -> Result<ExitCode> {
    let layout = match arguments.layout {
        LayoutChoice::Ubfc => Layout::Ubfc,
        LayoutChoice::Pure => Layout::Pure,
    };
    let place = Place { layout, subject: arguments.subject, recording: arguments.recording };
    let ppg = read_ppg(&arguments.ppg).into_diagnostic()?;
    let mut times = Vec::new();
    let mut size = (0, 0);
    each_frame(arguments, |frame| {
        times.push(frame.seconds);
        size = (frame.image.width, frame.image.height);
        Ok(())
    })?;
    let text = labels(layout, &times, &ppg, heart_rate(&ppg))
        .into_diagnostic()
        .wrap_err_with(|| format!("`{}` does not cover `{}`", arguments.ppg.display(), arguments.video.display()))?;
    let folder = arguments.out.join(place.folder());
    std::fs::create_dir_all(&folder)
        .into_diagnostic()
        .wrap_err_with(|| format!("cannot make `{}`", folder.display()))?;
    match layout {
        Layout::Ubfc => write_avi(arguments, &place, &times, size)?,
        Layout::Pure => each_frame(arguments, |frame| {
            let path = arguments.out.join(place.frames(frame.seconds));
            let bytes = png(&frame.image).map_err(|error| wrong(&path, std::io::Error::other(error)))?;
            std::fs::write(&path, bytes).map_err(|error| wrong(&path, error))
        })?,
    }
    let path = arguments.out.join(place.labels());
    std::fs::write(&path, text).into_diagnostic().wrap_err_with(|| format!("cannot write `{}`", path.display()))?;
    println!("{} frames, {}", times.len(), folder.display());
    Ok(ExitCode::SUCCESS)
}

fn wrong(path: &Path, error: std::io::Error) -> ExportError {
    ExportError::Write { path: path.display().to_string(), error }
}

fn each_frame(
    arguments: &ExportArguments,
    mut each: impl FnMut(TimedFrame) -> std::result::Result<(), ExportError>,
) -> Result<()> {
    let options = VideoOptions { folder_hertz: arguments.fps.unwrap_or(f64::NAN), ..VideoOptions::default() };
    let video = open(&arguments.video, &options).into_diagnostic()?;
    let go_on = |frame| each(frame).map(|()| ControlFlow::Continue(()));
    for_each_frame::<ExportError>(video, go_on).into_diagnostic().map(drop)
}

fn write_avi(arguments: &ExportArguments, place: &Place, times: &[f64], (width, height): (usize, usize)) -> Result<()> {
    let span = times.last().zip(times.first()).map_or(0.0, |(last, first)| last - first);
    let hertz = if span > 0.0 { (times.len() - 1) as f64 / span } else { 0.0 };
    let form = AviForm { width, height, frames: times.len(), hertz };
    if form.size().is_none() {
        let help = "export a shorter or smaller video, or the PURE layout";
        return Err(miette!(help = help, "{} frames of {width}×{height} do not fit an AVI file of 4 GiB", times.len()));
    }
    let path = arguments.out.join(place.frames(0.0));
    let failed = |error| wrong(&path, error);
    let file = std::fs::File::create(&path).map_err(failed).into_diagnostic()?;
    let mut file = BufWriter::with_capacity(1 << 20, file);
    let mut writer = AviWriter::begin(&mut file, form).map_err(failed).into_diagnostic()?;
    each_frame(arguments, |frame| writer.frame(&frame.image.data).map_err(failed))?;
    writer.end().and_then(|()| file.flush()).map_err(failed).into_diagnostic()
}

/// The PPG's own heart rate, bpm; NaN where it has none. Data sets carry it beside the trace; readers ignore it.
fn heart_rate(ppg: &Series) -> f64 {
    let even = resampled_evenly(&ppg.times_seconds, &ppg.values);
    let rate = even.and_then(|even| estimate(&even.values, even.rate_hertz, Preset::Paper));
    rate.map_or(f64::NAN, |rate| rate.bpm)
}
