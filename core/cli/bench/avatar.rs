//! `heartian bench avatar`: quality over training seconds, what a step and a Gaussian cost, and pictures a second.

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Instant;

use clap::Args;
use heartian_avatar::{
    Avatar, RenderOptions, STAGES, Score, TrainOptions, render_clip, state_bytes_per_gaussian, step_cost, train,
};
use heartian_face::Track;
use heartian_graph::{Graph, Registry, Run, load};
use heartian_report::{TradeOff, encode_png, trade_off_figure};
use heartian_space::{Clip, Progress};
use heartian_splat::{Device, Gpu};
use miette::{IntoDiagnostic, Result, miette};
use serde_json::{Value, json};

use crate::arguments::HostArguments;
use crate::session::Session;
use crate::summary::table;

/// What the recording comes from.
const GRAPH: &str = r#"Graph(name: "bench-avatar", doc: "A recording and its track.", nodes: {
    "frames": (kind: "FrameLoader"),
    "track": (kind: "FlameTracker", inputs: {"clip": "frames.clip", "landmarks": "frames.landmarks"}),
})"#;
/// Frames rendered, and steps timed, for one figure.
const FRAMES: usize = 60;
/// Where the last part of a fit begins: density is settled then.
const SETTLED_PERCENT: u64 = 72;

/// How the avatar is measured.
#[derive(Args)]
#[command(after_help = "\
Examples:
  heartian bench avatar                                 the synthetic recording, about four minutes on two cores
  heartian bench avatar --source me.mp4 --seconds 100   a recording of your own
  heartian bench avatar --steps 3000 --gaussians 14000 --json
  heartian bench avatar --device gpu --size 512 --sides 512 --steps 3000 --gaussians 14000
                                                        images/s of training and frames/s of rendering on a GPU

Every fit has a plan of its own length: rates fall and Gaussians are placed over all of it. PSNR and SSIM are those of the
held-out frames, the last 15 % of the recording. images/s is over the last part of a fit, at full size, after the last
density round. Frames/s of rendering count what it takes to have them in memory as the clip stores them. avatar.json, avatar.txt and avatar.png (error over training seconds) are
left in the folder of the results; the recording and its track are cached.")]
pub struct AvatarBench {
    /// `synthetic`, or a video file
    #[arg(long, value_name = "VIDEO", default_value = "synthetic")]
    pub source: String,
    /// How much of the recording
    #[arg(long, value_name = "SECONDS", default_value_t = 20.0)]
    pub seconds: f64,
    /// Side of the recording, pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 256)]
    pub size: usize,
    /// Lengths of the fits
    #[arg(long, value_name = "N", value_delimiter = ',', default_values_t = [375, 750, 1500, 3000])]
    pub steps: Vec<u32>,
    /// Most Gaussians of the avatars that are rendered; the longest fit is made with the last
    #[arg(long, value_name = "N", value_delimiter = ',', default_values_t = [4000, 14_000])]
    pub gaussians: Vec<usize>,
    /// Sides of the pictures that are rendered, pixels
    #[arg(long, value_name = "PIXELS", value_delimiter = ',', default_values_t = [128, 256, 512, 1024])]
    pub sides: Vec<usize>,
    /// What fits and renders: `auto`, `cpu` or `gpu`
    #[arg(long, value_name = "DEVICE", default_value_t = Device::Cpu)]
    pub device: Device,
    /// Print one JSON object and nothing else
    #[arg(long)]
    pub json: bool,
    /// Folder of the results
    #[arg(long, value_name = "DIR", default_value = "runs/bench-avatar")]
    pub out: PathBuf,
    /// The machine.
    #[command(flatten)]
    pub host: HostArguments,
}

/// One fit.
struct Fitted {
    steps: u32,
    gaussians: usize,
    seconds: f64,
    held_out: Score,
    /// Steps a second at full size, after the last density round.
    images_per_second: f64,
    /// (seconds, live training PSNR in decibels).
    live: Vec<(f64, f64)>,
    avatar: Avatar,
}

/// One rendering rate.
struct Rate {
    gaussians: usize,
    side: usize,
    frames_per_second: f64,
}

/// Fits, renders, prints a table or one JSON object.
pub fn run(arguments: &AvatarBench) -> Result<ExitCode> {
    let session = Session::open(&arguments.host)?;
    std::fs::create_dir_all(&arguments.out).into_diagnostic()?;
    let gpu = Gpu::open(arguments.device).into_diagnostic()?;
    let device = gpu.as_ref().map_or("cpu", |gpu| &gpu.report().name);
    if gpu.as_ref().is_some_and(|gpu| gpu.report().is_software) {
        eprintln!("  {device} is a software adapter: what follows says nothing of a GPU");
    }
    let (clip, track) = recording(&session, arguments)?;
    let largest = arguments.gaussians.last().copied().unwrap_or(TrainOptions::default().gaussians);
    let mut fits = Vec::new();
    for &steps in &arguments.steps {
        fits.push(fit(&clip, &track, [steps as usize, largest], arguments.device)?);
    }
    let Some(last) = fits.last() else { return Err(miette!("give at least one length of a fit")) };
    // What a stage costs is the CPU's: on a device they are one submission.
    let stages = match gpu {
        None => step_cost(&last.avatar, &clip, FRAMES).into_diagnostic()?.to_vec(),
        Some(_) => Vec::new(),
    };
    let mut rates = Vec::new();
    for &gaussians in &arguments.gaussians {
        let short = [last.steps.min(750) as usize, gaussians];
        let own = (gaussians != largest).then(|| fit(&clip, &track, short, arguments.device)).transpose()?;
        let avatar = own.as_ref().map_or(&last.avatar, |fit| &fit.avatar);
        for &side in &arguments.sides {
            rates.push(rate(avatar, &track, side, gpu.as_ref())?);
        }
    }
    session.terminal.finish();
    let bytes = state_bytes_per_gaussian(last.avatar.canonical.modes);
    let report = json!({
        "source": arguments.source, "frames": clip.len(), "size": arguments.size, "device": device,
        "fits": fits.iter().map(Fitted::json).collect::<Vec<_>>(),
        "step_seconds": STAGES.iter().zip(&stages).map(|(name, s)| ((*name).to_owned(), json!(s))).collect::<serde_json::Map<_, _>>(),
        "motion_modes": last.avatar.canonical.modes, "state_bytes_per_gaussian": bytes,
        "rendering": rates.iter().map(|r| json!({"gaussians": r.gaussians, "side": r.side, "frames_per_second": r.frames_per_second})).collect::<Vec<_>>(),
    });
    let text = format!("on {device}\n\n{}", text(&fits, &stages, &rates, (last.avatar.canonical.modes, bytes)));
    write(arguments, "avatar.json", serde_json::to_string_pretty(&report).into_diagnostic()?.as_bytes())?;
    write(arguments, "avatar.txt", text.as_bytes())?;
    let figure = trade_off_figure(&points(&fits), "root mean square error of the picture, peak 1").into_diagnostic()?;
    write(arguments, "avatar.png", &encode_png(&figure).into_diagnostic()?)?;
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&report).into_diagnostic()?);
    } else {
        print!("{text}");
    }
    Ok(ExitCode::SUCCESS)
}

fn write(arguments: &AvatarBench, name: &str, bytes: &[u8]) -> Result<()> {
    std::fs::write(arguments.out.join(name), bytes).into_diagnostic()
}

/// The recording and its track, from the cache where they are there.
fn recording(session: &Session, arguments: &AvatarBench) -> Result<(Arc<Clip>, Arc<Track>)> {
    let mut graph = Graph::parse("bench-avatar.ron", GRAPH)?;
    graph.set(&format!("frames.source={}", arguments.source));
    graph.set(&format!("frames.seconds={:?}", arguments.seconds));
    graph.set(&format!("frames.size={}", arguments.size));
    let plan = graph.plan(&Registry::compiled_in(), &[])?;
    let reports = session.execute(&Run::prepare(&plan, &session.cache));
    if session.cancelled() {
        return Err(miette!("interrupted; what is finished is kept"));
    }
    if let Some(problem) = reports.iter().find_map(|report| report.problem(&plan)) {
        return Err(miette::Report::new(problem));
    }
    let lost = || miette!(help = "run it again", "the cache lost the recording");
    let digest = |port| reports.iter().find_map(|report| report.outputs.get(port)).ok_or_else(lost);
    let clip = load::<Clip>(&session.cache, digest("clip")?)?.ok_or_else(lost)?;
    let track = load::<Track>(&session.cache, digest("track")?)?.ok_or_else(lost)?;
    Ok((clip, track))
}

/// A fit of some steps and at most so many Gaussians.
fn fit(clip: &Clip, track: &Track, [steps, gaussians]: [usize; 2], device: Device) -> Result<Fitted> {
    eprintln!("  {steps} steps, {gaussians} Gaussians");
    let options = TrainOptions { steps: steps as u32, gaussians, device, ..TrainOptions::default() };
    let (start, mut live, mut last_part) = (Instant::now(), Vec::new(), None);
    let mut watch = |progress: Progress| {
        let seconds = start.elapsed().as_secs_f64();
        if progress.step * 100 >= progress.total * SETTLED_PERCENT {
            let (first, _) = *last_part.get_or_insert(((progress.step, seconds), (progress.step, seconds)));
            last_part = Some((first, (progress.step, seconds)));
        }
        if let Some((_, psnr_db)) =
            progress.metric.filter(|_| progress.step.is_multiple_of((progress.total / 50).max(1)))
        {
            live.push((seconds, psnr_db));
        }
        ControlFlow::Continue(())
    };
    let (avatar, report) = train(clip, track, &options, &mut watch).into_diagnostic()?;
    let seconds = live.last().map_or_else(|| start.elapsed().as_secs_f64(), |(seconds, _)| *seconds);
    let held_out = report.held_out.unwrap_or(report.training);
    let images_per_second =
        last_part.map_or(0.0, |((from, start), (to, end))| (to - from) as f64 / (end - start).max(1e-9));
    Ok(Fitted { steps: report.steps, gaussians: report.gaussians, seconds, held_out, images_per_second, live, avatar })
}

/// Pictures a second of the avatar on the start of its track, shading and encoding included, on all cores or a device.
fn rate(avatar: &Avatar, track: &Track, side: usize, gpu: Option<&Arc<Gpu>>) -> Result<Rate> {
    let count = track.frames.len().min(FRAMES);
    let track = Track {
        frames: track.frames[..count].to_vec(),
        times_seconds: track.times_seconds[..count].to_vec(),
        sigma: heartian_face::TrackSigma::default(),
        ..track.clone()
    };
    let options = RenderOptions { label: "timed", size: Some(side), gpu, ..RenderOptions::default() };
    let mut best = f64::INFINITY;
    for _ in 0..3 {
        let start = Instant::now();
        render_clip(avatar, &track, &options).into_diagnostic()?;
        best = best.min(start.elapsed().as_secs_f64());
    }
    Ok(Rate { gaussians: avatar.len(), side, frames_per_second: count as f64 / best })
}

impl Fitted {
    fn json(&self) -> Value {
        json!({
            "steps": self.steps, "gaussians": self.gaussians, "seconds": self.seconds,
            "images_per_second": self.images_per_second,
            "held_out_psnr_db": self.held_out.psnr_db, "held_out_ssim": self.held_out.ssim,
            "live": self.live.iter().map(|(seconds, psnr_db)| json!([seconds, psnr_db])).collect::<Vec<_>>(),
        })
    }
}

/// Held-out error of each fit, and the live training error of the longest.
fn points(fits: &[Fitted]) -> Vec<TradeOff> {
    let error = |psnr_db: f64| 10f64.powf(-psnr_db / 20.0);
    let point = |fit: &Fitted| TradeOff {
        label: format!("{} steps, {:.1} dB", fit.steps, fit.held_out.psnr_db),
        group: "held out".to_owned(),
        seconds: fit.seconds,
        error: error(fit.held_out.psnr_db),
    };
    let live = fits.last().map_or(&[][..], |fit| &fit.live[..]).iter().map(|(seconds, psnr_db)| TradeOff {
        label: String::new(),
        group: "live, training frames".to_owned(),
        seconds: *seconds,
        error: error(*psnr_db),
    });
    fits.iter().map(point).chain(live).collect()
}

fn text(fits: &[Fitted], stages: &[f64], rates: &[Rate], (modes, bytes): (usize, usize)) -> String {
    let mut rows = vec![["fit", "Gaussians", "seconds", "images/s", "held out dB", "SSIM"].map(str::to_owned).to_vec()];
    rows.extend(fits.iter().map(|fit| {
        vec![
            format!("{} steps", fit.steps),
            fit.gaussians.to_string(),
            format!("{:.1}", fit.seconds),
            format!("{:.1}", fit.images_per_second),
            format!("{:.2}", fit.held_out.psnr_db),
            format!("{:.4}", fit.held_out.ssim),
        ]
    }));
    let fitted = table(&rows, &[false, true, true, true, true, true]);
    let mut rows = vec![["a step", "ms"].map(str::to_owned).to_vec()];
    rows.extend(STAGES.iter().zip(stages).map(|(name, s)| vec![(*name).to_owned(), format!("{:.2}", 1e3 * s)]));
    rows.push(vec!["all".to_owned(), format!("{:.2}", 1e3 * stages.iter().sum::<f64>())]);
    let step = if stages.is_empty() { String::new() } else { table(&rows, &[false, true]) };
    let mut rows = vec![["rendering", "side px", "frames/s"].map(str::to_owned).to_vec()];
    rows.extend(rates.iter().map(|rate| {
        vec![format!("{} Gaussians", rate.gaussians), rate.side.to_string(), format!("{:.1}", rate.frames_per_second)]
    }));
    let rendering = table(&rows, &[false, true, true]);
    format!("{fitted}\n{step}\n{rendering}\n{bytes} bytes of training state a Gaussian with {modes} motion modes\n")
}
