//! `heartian measure`: the heart rate of a face video, on one line, with how sure it is.
//!
//! The video is decoded once and never held: a few frames wait while the face is looked for, networks hold one chunk.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use clap::Args;
use heartian_capture::video::{self, FrameSource, VideoError, VideoOptions};
use heartian_decoder::{Following, Looks, Measured, Named, Network, Options, Reader, Reading, Statistics, measure};
use heartian_face::models::load_detector;
use heartian_face::nets::{Detector, NetError};
use heartian_report::{Curve, encode_png, waveform_figure};
use heartian_signal::{Method, Preset, Protocol};
use heartian_space::{Rgb8Image, Series};
use indicatif::{ProgressBar, ProgressStyle};
use miette::{IntoDiagnostic, Result, WrapErr, miette};

/// A measurement.
#[derive(Args)]
#[command(after_help = "\
Examples:
  heartian measure me.mp4
  heartian measure me.mp4 --method POS --method CHROM --json
  heartian measure me.mp4 --weights UBFC-rPPG_PhysNet_DiffNormalized.pth
  heartian measure frames/ --fps 30

Every classical method reads the video (POS CHROM ICA GREEN LGI PBV OMIT); POS answers unless --method or --weights name
others, of which the surest answers. A network is recognised from its weight file (TS-CAN, PhysFormer, FactorizePhys,
PhysNet; .pth or .safetensors). How sure: the chance of being right to 5 bpm, from the signal-to-noise ratio, the height of
the spectrum's peak over the next one, and how many windows and other methods agree, calibrated on simulated recordings.
Strong video compression wipes the pulse out: then the answer says that it is not sure.
This is a measurement of video, not a medical device.")]
pub struct MeasureArguments {
    /// A video file, a folder of PNG, JPEG, EXR or BMP frames, or a recording of a data set (see `heartian datasets`)
    pub video: PathBuf,
    /// Let this decoder answer; may be repeated [default: POS, or the networks of --weights]
    #[arg(long = "method", value_name = "NAME", value_delimiter = ',')]
    pub methods: Vec<String>,
    /// Weight file of a network; may be repeated
    #[arg(long = "weights", value_name = "FILE")]
    pub weights: Vec<PathBuf>,
    /// Where to begin, in seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    pub start: f64,
    /// How much to read, in seconds [default: all]
    #[arg(long, value_name = "SECONDS")]
    pub seconds: Option<f64>,
    /// Frame rate of a folder of frames without a file of times
    #[arg(long, value_name = "HERTZ")]
    pub fps: Option<f64>,
    /// Which rates are looked for: 36 to 198 bpm, or the paper's 45 to 180 bpm
    #[arg(long, value_enum, default_value_t = BandChoice::Toolbox)]
    pub band: BandChoice,
    /// Where the waveform and its spectrum are drawn [default: runs/measure-NAME/pulse.png]
    #[arg(long, value_name = "PNG")]
    pub picture: Option<PathBuf>,
    /// Print the answer as JSON
    #[arg(long)]
    pub json: bool,
}

/// A band of heart rates.
#[derive(clap::ValueEnum, Clone, Copy)]
pub enum BandChoice {
    /// 0.6 to 3.3 Hz
    Toolbox,
    /// 0.75 to 3.0 Hz
    Paper,
}

impl BandChoice {
    /// The protocol of that band, with bins of at most 0.1 bpm.
    pub fn preset(self) -> Preset {
        match self {
            Self::Toolbox => Preset::ToolboxFine,
            Self::Paper => Preset::Paper,
        }
    }
}

/// How often the detector looks for the face, looks a second of video.
const LOOKS_PER_SECOND: f64 = 3.0;
/// Frames between looks where the frame rate is not known beforehand.
const LOOK_EVERY: usize = 8;
/// Waveforms in the picture.
const CURVES: usize = 6;
/// How much of the waveforms is drawn, seconds.
const PICTURE_SECONDS: f64 = 20.0;
/// Less sure than this is called "not sure".
const SURE: f64 = 0.5;

/// Measures one video.
pub fn run(arguments: &MeasureArguments) -> Result<ExitCode> {
    let start = Instant::now();
    let decoders = decoders(&arguments.methods, &arguments.weights)?;
    let protocol = arguments.band.preset().protocol();
    let (reading, looks, length) = read(arguments, &decoders.readers)?;
    if length.frames < 2 {
        return Err(miette!(
            help = "give a video of at least five seconds",
            "{}: one frame has no heart rate",
            arguments.video.display()
        ));
    }
    match looks {
        Some(looks) if looks.seen == 0 => eprintln!("warning: no face was seen; the whole frame was read"),
        Some(looks) if looks.seen * 2 < looks.looks => {
            eprintln!("warning: a face was seen in {} of {} looks only", looks.seen, looks.looks);
        }
        _ => {}
    }
    let found = measure(&decoders.readers, reading.finish(&protocol), &protocol);
    let asked =
        found.iter().zip(&decoders.asked).filter(|(_, asked)| **asked).map(|((key, measured), _)| (key, measured));
    let mut best: Option<&Measured> = None;
    let mut failures = Vec::new();
    for (key, measured) in asked {
        match measured {
            Ok(measured) if best.is_none_or(|best| measured.confidence() > best.confidence()) => best = Some(measured),
            Ok(_) => {}
            Err(error) => failures.push(format!("{key}: {error}")),
        }
    }
    failures.iter().filter(|_| best.is_some()).for_each(|failure| eprintln!("warning: {failure}"));
    let Some(best) = best else {
        return Err(miette!("{}: no heart rate; {}", arguments.video.display(), failures.join("; ")));
    };
    let all: Vec<&Measured> = found.iter().filter_map(|(_, measured)| measured.as_ref().ok()).collect();
    let picture = draw(arguments, best, &all, &protocol)?;
    let spent = start.elapsed().as_secs_f64();
    if arguments.json {
        println!("{:#}", json(arguments, best, &all, (&length, spent, &picture)));
    } else {
        println!("{}", line(best, all.len() - 1, &length, spent));
        eprintln!("{}", picture.display());
    }
    Ok(ExitCode::SUCCESS)
}

/// The decoders that run, and which of them may give the answer; the others confirm or doubt it.
struct Decoders {
    readers: Vec<Reader>,
    asked: Vec<bool>,
}

/// All classical methods, and the networks whose weights are given.
fn decoders(methods: &[String], weights: &[PathBuf]) -> Result<Decoders> {
    let mut named = Vec::new();
    for name in methods {
        named.push(Named::from_name(name).ok_or_else(|| {
            miette!(help = format!("decoders: {}", Named::names().join(", ")), "there is no decoder `{name}`")
        })?);
    }
    let mut readers: Vec<Reader> = Method::ALL.into_iter().map(Reader::Classical).collect();
    let mut loaded = Vec::new();
    for path in weights {
        let network = Network::load(path, &Options::default())
            .into_diagnostic()
            .wrap_err_with(|| format!("cannot use the weights `{}`", path.display()))?;
        let architecture = network.architecture();
        if !named.is_empty() && !named.contains(&Named::Neural(architecture)) {
            let help = format!("add `--method {}`, or leave `--method` out", architecture.name());
            return Err(miette!(
                help = help,
                "`{}` holds {}, which no `--method` names",
                path.display(),
                architecture.name()
            ));
        }
        loaded.push(architecture);
        readers.push(Reader::neural(network));
    }
    for name in &named {
        if let Named::Neural(architecture) = name
            && !loaded.contains(architecture)
        {
            let help = "give its weight file with `--weights FILE.pth`; networks have no pulse without";
            return Err(miette!(help = help, "{} needs weights", architecture.name()));
        }
    }
    let asked = |reader: &Reader| match reader {
        Reader::Classical(method) if named.is_empty() && weights.is_empty() => *method == Method::Pos,
        Reader::Classical(method) => named.contains(&Named::Classical(*method)),
        Reader::Neural(_) => true,
    };
    let asked = readers.iter().map(asked).collect();
    Ok(Decoders { readers, asked })
}

/// What was read.
struct Length {
    frames: usize,
    seconds: f64,
}

/// What stops the reading of a video.
#[derive(Debug, thiserror::Error)]
enum ReadError {
    #[error(transparent)]
    Video(#[from] VideoError),
    #[error(transparent)]
    Net(#[from] NetError),
}

/// One pass over the video.
fn read<'a>(arguments: &MeasureArguments, readers: &'a [Reader]) -> Result<(Reading<'a>, Option<Looks>, Length)> {
    let folder_hertz = arguments.fps.unwrap_or(f64::NAN);
    let options = VideoOptions { start_seconds: arguments.start, folder_hertz, ..VideoOptions::default() };
    let video = video::open(&arguments.video, &options).into_diagnostic()?;
    let bar = progress(video.frame_count());
    let detector: Option<Detector> = match load_detector() {
        Ok(detector) => Some(detector),
        Err(error) => {
            eprintln!("warning: the whole frame is read, not the face in it: {error}");
            None
        }
    };
    let mut following = Following::new(Reading::new(readers, Statistics::PerChunk), LOOK_EVERY);
    let mut length = Length { frames: 0, seconds: 0.0 };
    let mut first = None;
    let read: Result<Vec<String>, ReadError> = video::for_each_frame(video, |frame| {
        let since = frame.seconds - *first.get_or_insert(frame.seconds);
        if since >= arguments.seconds.unwrap_or(f64::INFINITY) {
            return Ok(ControlFlow::Break(()));
        }
        if length.frames == 1 && since > 0.0 {
            following.look_every((1.0 / since / LOOKS_PER_SECOND).round().clamp(1.0, 64.0) as usize);
        }
        length = Length { frames: length.frames + 1, seconds: since };
        bar.inc(1);
        let find = |image: &Rgb8Image| detector.as_ref().map_or(Ok(None), |detector| detector.best_box(image));
        following.frame(frame.seconds, frame.image, find)?;
        Ok(ControlFlow::Continue(()))
    });
    bar.finish_and_clear();
    for warning in read.into_diagnostic()? {
        eprintln!("warning: {warning}");
    }
    // The last frame lasts as long as the others.
    length.seconds *= length.frames as f64 / (length.frames.max(2) - 1) as f64;
    let (reading, looks) = following.finish();
    Ok((reading, detector.map(|_| looks), length))
}

fn progress(frames: Option<usize>) -> ProgressBar {
    let bar = frames.map_or_else(ProgressBar::new_spinner, |frames| ProgressBar::new(frames as u64));
    let template = "{wide_bar} {pos}/{len} frames, {per_sec}, {eta} left";
    bar.with_style(ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar()))
}

/// The answer as a person reads it.
fn line(best: &Measured, others: usize, length: &Length, spent: f64) -> String {
    let confidence = best.confidence();
    let doubt = if confidence < SURE { "not sure: " } else { "" };
    let agree = (best.evidence.methods * others as f64).round();
    format!(
        "{doubt}{:.1} bpm, {:.0} % sure of ±5 bpm ({}: {agree} of {others} other methods and {:.0} % of windows agree, \
         SNR {:.1} dB; {} frames, {:.1} s of video in {spent:.1} s)",
        best.rate.bpm,
        100.0 * confidence,
        best.name,
        100.0 * best.evidence.windows,
        best.evidence.snr_db,
        length.frames,
        length.seconds,
    )
}

/// The answer for programs. Numbers that do not exist are `null`.
fn json(
    arguments: &MeasureArguments,
    best: &Measured,
    all: &[&Measured],
    (length, spent, picture): (&Length, f64, &Path),
) -> serde_json::Value {
    let one = |measured: &Measured| {
        serde_json::json!({
            "hr_bpm": measured.rate.bpm,
            "confidence": measured.confidence(),
            "snr_db": measured.evidence.snr_db,
            "windows_agreeing": measured.evidence.windows,
            "methods_agreeing": measured.evidence.methods,
        })
    };
    let methods: serde_json::Map<String, serde_json::Value> =
        all.iter().map(|measured| (measured.key.clone(), one(measured))).collect();
    let track: Vec<[f64; 2]> =
        best.windows.iter().map(|window| [best.start_seconds + window.middle_seconds, window.bpm]).collect();
    serde_json::json!({
        "video": arguments.video.display().to_string(),
        "hr_bpm": best.rate.bpm,
        "confidence": best.confidence(),
        "method": best.key,
        "seconds": spent,
        "video_seconds": length.seconds,
        "frames": length.frames,
        "snr_db": best.evidence.snr_db,
        "windows_s_bpm": track,
        "methods": methods,
        "picture": picture.display().to_string(),
    })
}

/// The waveform and spectrum of the answer, before those of the other decoders.
fn draw(arguments: &MeasureArguments, best: &Measured, all: &[&Measured], protocol: &Protocol) -> Result<PathBuf> {
    let others = all.iter().filter(|other| other.key != best.key);
    let mut curves = Vec::new();
    for measured in std::iter::once(&best).chain(others).take(CURVES) {
        let rate = &measured.rate;
        let times = (0..rate.filtered.len()).map(|k| measured.start_seconds + k as f64 / rate.rate_hertz).collect();
        let hertz = (0..rate.spectrum.power.len()).map(|bin| rate.spectrum.hertz(bin)).collect();
        curves.push(Curve {
            label: format!("{} {:.1} bpm, {:.0} % sure", measured.name, rate.bpm, 100.0 * measured.confidence()),
            series: Series::new(times, rate.filtered.clone()).into_diagnostic()?,
            spectrum: (hertz, rate.spectrum.power.clone()),
        });
    }
    let band = (protocol.band.low_hertz, protocol.band.high_hertz);
    let picture = waveform_figure(&curves, PICTURE_SECONDS, band).into_diagnostic()?;
    let stem = arguments.video.file_stem().map_or("video".into(), |stem| stem.to_string_lossy().into_owned());
    let path = arguments
        .picture
        .clone()
        .unwrap_or_else(|| Path::new("runs").join(format!("measure-{stem}")).join("pulse.png"));
    let write = || -> std::io::Result<()> {
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder)?;
        }
        std::fs::write(&path, encode_png(&picture).map_err(std::io::Error::other)?)
    };
    write().into_diagnostic().wrap_err_with(|| format!("cannot write `{}`", path.display()))?;
    Ok(path)
}
