//! The cohort: 24 recordings that the product makes itself, each through the whole pipeline.
//!
//! Sixteen sit still, four skin tones (about Fitzpatrick III–VI) under four lights; eight move and talk, and carry the
//! pulse waveforms of the files given, or synthetic ones with more variability. A file is read where its PPG shows a
//! pulse: a stretch in which the sensor was off has no heart rate that anything could be compared with.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use heartian_capture::ppg::read_ppg;
use heartian_graph::{Graph, NodeReport, Plan, Run, load};
use heartian_pulse::Reference;
use heartian_space::{Metrics, Series};
use miette::{IntoDiagnostic, Result, WrapErr, miette};

use crate::plugins;
use crate::session::Session;

/// The pipeline of one recording.
const GRAPH: &str = include_str!("cohort.ron");
const TONES: [&str; 4] = ["Medium", "Tan", "Brown", "Dark"];
const LIGHTS: [&str; 4] = ["Studio", "Cool", "Warm", "Window"];
/// Recordings that move.
const MOVING: usize = 8;
/// Length of a recording, and what of a PPG is kept before and after, seconds.
const SECONDS: f64 = 20.0;
const MARGIN_SECONDS: f64 = 1.2;
/// Frames a second of a recording.
const FRAME_RATE: f64 = 30.0;
/// Share of the frames whose beats a stretch of PPG must plainly show, and the distance of the stretches tried, seconds.
const PLAINLY_SHOWN: f64 = 0.9;
const STRIDE_SECONDS: f64 = 1.0;
/// Recordings worked on at once, at most: each keeps little more than one thread busy.
const SIDE_BY_SIDE: usize = 4;

/// One recording: who, under which light, and what is set in the graph.
pub struct Recording {
    pub tone: &'static str,
    pub light: &'static str,
    /// What moves: `still`, `moving`, or the name of the PPG file.
    pub pulse: String,
    sets: Vec<String>,
}

/// The figures of one recording by node and name: `with.attribute.hr_error_bpm`, `render.baseline.psnr_db`, …
pub struct Figures(BTreeMap<String, f64>);

impl Figures {
    /// NaN when it was not measured.
    pub fn get(&self, name: &str) -> f64 {
        self.0.get(name).copied().unwrap_or(f64::NAN)
    }

    /// How much lower the modulated picture scores than the baseline, `psnr_db` or `ssim`.
    pub fn cost(&self, score: &str) -> f64 {
        self.get(&format!("render.baseline.{score}")) - self.get(&format!("render.modulated.{score}"))
    }
}

/// `count` of the 24 recordings, evenly chosen; windows of the PPG files are left in `folder`.
pub fn recordings(count: usize, ppg: &[PathBuf], folder: &Path) -> Result<Vec<Recording>> {
    let mut all = Vec::new();
    for (row, tone) in TONES.into_iter().enumerate() {
        for (column, light) in LIGHTS.into_iter().enumerate() {
            let index = 4 * row + column;
            // Rates from 52 to 127 bpm in an order that neither tone nor light follows.
            let bpm = 52 + 5 * ((7 * index + 14) % 16);
            let sets = [format!("heart_rate_bpm={bpm}"), "motion=0.2".to_owned()];
            all.push(recording((tone, light), "still".to_owned(), index, &sets));
        }
    }
    let windows = windows(ppg, folder)?;
    for k in 0..MOVING {
        let (pulse, sets) = match windows.get(k) {
            Some((name, file)) => (name.clone(), vec![format!("ppg={}", file.display()), "motion=0.7".to_owned()]),
            None => {
                let bpm = 58 + 7 * (k * 3 % MOVING);
                let sets = [format!("heart_rate_bpm={bpm}"), "hrv_ms=60".to_owned(), "motion=0.7".to_owned()];
                ("moving".to_owned(), sets.to_vec())
            }
        };
        all.push(recording((TONES[k % 4], LIGHTS[(k + k / 4) % 4]), pulse, 16 + k, &sets));
    }
    let total = all.len();
    let chosen: Vec<usize> = (0..count.min(total)).map(|k| k * total / count.min(total)).collect();
    Ok(all.into_iter().enumerate().filter(|(index, _)| chosen.contains(index)).map(|(_, one)| one).collect())
}

fn recording((tone, light): (&'static str, &'static str), pulse: String, index: usize, sets: &[String]) -> Recording {
    let mut sets: Vec<String> = sets.iter().map(|set| format!("frames.{set}")).collect();
    sets.push(format!("frames.skin_tone={tone}"));
    sets.push(format!("frames.light={light}"));
    sets.push(format!("frames.seed={}", 100 + index));
    Recording { tone, light, pulse, sets }
}

/// Stretches of the PPG files, one a moving recording, each file at least once and longer ones more often, as files of
/// their own that start at 0.
fn windows(ppg: &[PathBuf], folder: &Path) -> Result<Vec<(String, PathBuf)>> {
    let traces: Vec<Series> = ppg.iter().map(|path| read_ppg(path)).collect::<Result<_, _>>().into_diagnostic()?;
    if traces.is_empty() {
        return Ok(Vec::new());
    }
    let needed = SECONDS + MARGIN_SECONDS;
    let room: Vec<f64> = traces.iter().map(|t| t.times_seconds[t.len() - 1] - t.times_seconds[0] - needed).collect();
    if let Some(short) = room.iter().position(|room| *room < 0.0) {
        let help = format!("give recordings of {needed:.1} s or more");
        return Err(miette!(help = help, "`{}` is too short for the cohort", ppg[short].display()));
    }
    let mut shares = vec![0usize; traces.len()];
    for _ in 0..MOVING {
        // Whoever has most room for each of its windows gets the next; none is left without.
        let want = |k: &usize| if shares[*k] == 0 { f64::INFINITY } else { room[*k] / shares[*k] as f64 };
        let next = (0..traces.len()).max_by(|a, b| want(a).total_cmp(&want(b))).unwrap_or(0);
        shares[next] += 1;
    }
    std::fs::create_dir_all(folder).into_diagnostic().wrap_err("cannot make the folder of the results")?;
    let mut found = Vec::new();
    for ((path, trace), (share, room)) in ppg.iter().zip(&traces).zip(shares.into_iter().zip(room)) {
        let name = path.file_stem().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        for k in 0..share {
            let own = [k, k + 1].map(|edge| trace.times_seconds[0] + room * edge as f64 / share as f64);
            let file = folder.join(format!("{name}-{k}.csv"));
            std::fs::write(&file, window(trace, shown_start(trace, own))).into_diagnostic()?;
            found.push((name.clone(), file));
        }
    }
    Ok(found)
}

/// Where to start within a file's own part of it: the start nearest to the middle from which the PPG plainly shows its
/// beats, or the one from which it shows most.
fn shown_start(trace: &Series, [first, last]: [f64; 2]) -> f64 {
    let middle = 0.5 * (first + last);
    let count = (0.5 * (last - first) / STRIDE_SECONDS) as i32;
    let mut starts: Vec<f64> = (-count..=count).map(|k| middle + STRIDE_SECONDS * f64::from(k)).collect();
    starts.sort_by(|a, b| (a - middle).abs().total_cmp(&(b - middle).abs()));
    let mut best = (0.0, middle);
    for start in starts {
        let frames: Vec<f64> = (0..(SECONDS * FRAME_RATE) as usize).map(|t| start + t as f64 / FRAME_RATE).collect();
        let shown = Reference::from_ppg(trace, &frames).map_or(0.0, |reference| reference.shown_share());
        if shown > best.0 {
            best = (shown, start);
        }
        if shown >= PLAINLY_SHOWN {
            break;
        }
    }
    best.1
}

fn window(trace: &Series, from: f64) -> String {
    let mut text = "time_s,ppg\n".to_owned();
    for (time, value) in trace.times_seconds.iter().zip(&trace.values) {
        let time = time - from;
        if (-MARGIN_SECONDS..=SECONDS + MARGIN_SECONDS).contains(&time) {
            text.push_str(&format!("{time},{value}\n"));
        }
    }
    text
}

/// The plan of a recording with further `--set`s.
pub fn plan(recording: &Recording, sets: &[String], targets: &[&str]) -> Result<Plan> {
    let mut graph = Graph::parse("cohort.ron", GRAPH)?;
    recording.sets.iter().chain(sets).for_each(|set| graph.set(set));
    let targets: Vec<String> = targets.iter().map(|&target| target.to_owned()).collect();
    Ok(graph.plan(plugins::registry()?, &targets)?)
}

/// Runs a plan to its end.
pub fn execute(session: &Session, plan: &Plan) -> Result<Vec<NodeReport>> {
    let reports = session.execute(&Run::prepare(plan, &session.cache));
    if session.cancelled() {
        return Err(miette!("interrupted; what is finished is kept"));
    }
    match reports.iter().find_map(|report| report.problem(plan)) {
        Some(problem) => Err(miette::Report::new(problem)),
        None => Ok(reports),
    }
}

/// The figures of all recordings, some of them worked on at once; each is the same as alone.
pub fn all_figures(session: &Session, recordings: &[Recording], sets: &[String]) -> Result<Vec<Figures>> {
    let next = AtomicUsize::new(0);
    let work = || -> Result<Vec<(usize, Figures)>> {
        let mut done = Vec::new();
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(recording) = recordings.get(index) else { return Ok(done) };
            let Recording { tone, light, pulse, .. } = recording;
            eprintln!("  {}/{} {tone} {light} {pulse}", index + 1, recordings.len());
            // Whoever fails leaves nothing for the others to begin with.
            let found =
                figures(session, recording, sets).inspect_err(|_| next.store(recordings.len(), Ordering::Relaxed));
            done.push((index, found?));
        }
    };
    let workers = session.options.jobs.clamp(1, SIDE_BY_SIDE);
    let finished: Vec<Result<Vec<(usize, Figures)>>> = std::thread::scope(|scope| {
        let running: Vec<_> = (0..workers).map(|_| scope.spawn(work)).collect();
        let panicked = |_| Err(miette!("a worker of the cohort stopped unexpectedly"));
        running.into_iter().map(|worker| worker.join().unwrap_or_else(panicked)).collect()
    });
    let mut all: Vec<(usize, Figures)> =
        finished.into_iter().collect::<Result<Vec<_>>>()?.into_iter().flatten().collect();
    all.sort_by_key(|(index, _)| *index);
    Ok(all.into_iter().map(|(_, figures)| figures).collect())
}

/// Runs one recording through the pipeline.
fn figures(session: &Session, recording: &Recording, sets: &[String]) -> Result<Figures> {
    let plan = plan(recording, sets, &[])?;
    let mut figures = BTreeMap::new();
    for report in execute(session, &plan)? {
        figures.insert(format!("{}.seconds", report.id), report.seconds);
        let Some(digest) = report.outputs.get("metrics") else { continue };
        let metrics = load::<Metrics>(&session.cache, digest)?
            .ok_or_else(|| miette!(help = "run it again", "the cache lost the figures of `{}`", report.id))?;
        figures.extend(metrics.0.iter().map(|(name, value)| (format!("{}.{name}", report.id), *value)));
    }
    Ok(Figures(figures))
}
