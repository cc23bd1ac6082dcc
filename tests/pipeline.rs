//! The main job, end to end, through the command a user types: small, real, and judged by what was written and read.
//!
//! Uses `../shared/data` for the recorded clip; without it, or without the installed face models, that test says
//! `skipped` and passes. Everything else runs from the synthetic recording.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

/// The pipeline made small: 8 seconds of 96×96 pixels, a thin avatar, half a minute of one core.
const SMALL: [&str; 5] =
    ["frames.seconds=8", "frames.size=96", "avatar.gaussians=3000", "avatar.steps=240", "residual.steps=60"];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// A cache and run folders that vanish with it.
struct Bench(tempfile::TempDir);

impl Bench {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn folder(&self, run: &str) -> PathBuf {
        self.0.path().join(run)
    }

    fn command(&self, graph: &str, run: &str, sets: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_heartian"));
        command.current_dir(self.0.path()).env("NO_COLOR", "1").arg("run").arg(root().join("graphs").join(graph));
        command.arg("--cache").arg(self.0.path().join("cache")).arg("--out").arg(self.folder(run));
        for set in sets {
            command.args(["--set", set]);
        }
        command
    }

    fn run(&self, graph: &str, run: &str, sets: &[&str]) -> Output {
        self.command(graph, run, sets).output().unwrap()
    }

    /// Runs and returns `metrics.json`.
    fn metrics(&self, graph: &str, run: &str, sets: &[&str]) -> Value {
        let output = self.run(graph, run, sets);
        assert!(output.status.success(), "{graph} {sets:?}: {}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&std::fs::read(self.folder(run).join("metrics.json")).unwrap()).unwrap()
    }
}

fn figure(metrics: &Value, key: &str) -> f64 {
    metrics["metrics"][key].as_f64().unwrap_or_else(|| panic!("metrics.json has no figure `{key}`: {metrics:#}"))
}

fn status<'a>(metrics: &'a Value, id: &str) -> &'a str {
    let nodes = metrics["nodes"].as_array().unwrap();
    nodes.iter().find(|node| node["id"] == id).map_or("absent", |node| node["status"].as_str().unwrap())
}

#[test]
fn a_heartbeat_is_written_and_read_back_and_reruns_redo_only_what_they_must() {
    let bench = Bench::new();
    let full = bench.metrics("full.ron", "full", &SMALL);
    for key in [
        "reference.hr_bpm",
        "baseline.psnr_db",
        "baseline.ssim",
        "modulated.psnr_db",
        "modulated.ssim",
        "attribute.hr_bpm",
        "attribute.hr_error_bpm",
        "attribute.snr_db",
        "attribute.waveform_pearson",
        "rendered.pos.hr_bpm",
        "rendered.pos.hr_error_bpm",
        "baseline_rendered.pos.hr_error_bpm",
        "relit.pos.hr_error_bpm",
        "input.pos.hr_bpm",
        "avatar.gaussians",
        "skin.gaussians",
        "track.landmark_rms_px",
    ] {
        figure(&full, key);
    }
    assert!(figure(&full, "attribute.hr_error_bpm") <= 0.5, "{full:#}");
    assert!(figure(&full, "attribute.waveform_pearson") >= 0.95, "{full:#}");
    assert!(figure(&full, "rendered.pos.hr_error_bpm") <= 3.0, "{full:#}");
    assert!(figure(&full, "baseline.psnr_db") >= 25.0, "{full:#}");
    assert!((figure(&full, "baseline.psnr_db") - figure(&full, "modulated.psnr_db")).abs() <= 0.05, "{full:#}");
    for file in ["contact_sheet.png", "waveforms.png", "skin.png", "preview.png", "render.modulated.avi"] {
        assert!(bench.folder("full").join(file).metadata().is_ok_and(|file| file.len() > 1000), "{file}");
    }

    let again = bench.metrics("full.ron", "full", &SMALL);
    for node in again["nodes"].as_array().unwrap() {
        assert_eq!(node["status"], "hit", "{again:#}");
    }
    assert_eq!(again["metrics"], full["metrics"]);

    let prescribed = bench.metrics("full.ron", "prescribed", &[&SMALL[..], &["phase.heart_rate_bpm=96"]].concat());
    for (id, expected) in [("frames", "hit"), ("track", "hit"), ("avatar", "hit"), ("skin", "hit"), ("phase", "ran")] {
        assert_eq!(status(&prescribed, id), expected, "{id}");
    }
    assert!((figure(&prescribed, "attribute.hr_bpm") - 96.0).abs() <= 0.5, "{prescribed:#}");
    assert!((figure(&prescribed, "rendered.pos.hr_bpm") - 96.0).abs() <= 3.0, "{prescribed:#}");

    let ablation = bench.metrics("no_residual.ron", "no_residual", &SMALL[..4]);
    for id in ["frames", "track", "avatar", "skin", "phase"] {
        assert_eq!(status(&ablation, id), "hit", "{id}");
    }
    assert_eq!(status(&ablation, "residual"), "absent");
}

/// Every artifact of the pipeline, at one thread and at three: the same bytes.
#[test]
fn the_number_of_threads_changes_nothing() {
    let tiny = ["frames.seconds=3", "frames.size=64", "avatar.gaussians=1500", "avatar.steps=60", "residual.steps=20"];
    let digests = |threads: &str| {
        let bench = Bench::new();
        let mut command = bench.command("full.ron", "run", &tiny);
        assert!(command.env("RAYON_NUM_THREADS", threads).output().unwrap().status.success());
        let record: Value =
            serde_json::from_slice(&std::fs::read(bench.folder("run").join("run.json")).unwrap()).unwrap();
        let nodes = record["nodes"].as_array().unwrap();
        nodes.iter().map(|node| (node["id"].clone(), node["outputs"].clone())).collect::<Vec<_>>()
    };
    let one = digests("1");
    assert!(one.len() >= 10 && one.iter().all(|(_, outputs)| outputs.as_object().is_some_and(|o| !o.is_empty())));
    assert_eq!(one, digests("3"));
}

#[test]
fn the_heart_rate_of_a_recording_is_measured_without_an_avatar() {
    let bench = Bench::new();
    let sets = ["frames.seconds=15", "frames.size=64", "frames.heart_rate_bpm=84", "frames.pulse_strength=0.03"];
    let measured = bench.metrics("measure.ron", "measure", &sets);
    assert!((figure(&measured, "input.pos.hr_bpm") - 84.0).abs() <= 3.0, "{measured:#}");
}

#[test]
fn a_failed_run_leaves_a_cache_that_the_next_run_uses() {
    let bench = Bench::new();
    let small = ["frames.seconds=2", "frames.size=48"];
    let csv = bench.folder("short.csv");
    std::fs::write(&csv, "time_s,ppg\n0,1\n1,2\n").unwrap();
    let ppg = format!("frames.ppg={}", csv.display());
    let failed = bench.run("measure.ron", "failed", &[&small[..], &[&ppg]].concat());
    let said = String::from_utf8_lossy(&failed.stderr).split_whitespace().collect::<Vec<_>>().join(" ");
    assert_eq!(failed.status.code(), Some(1));
    for part in ["`frames`", "`ppg`", "0.000–1.000 s", "is needed"] {
        assert!(said.contains(part), "{said}");
    }
    let metrics: Value =
        serde_json::from_slice(&std::fs::read(bench.folder("failed").join("metrics.json")).unwrap()).unwrap();
    assert_eq!((status(&metrics, "frames"), status(&metrics, "decode")), ("failed", "skipped"));
    bench.metrics("measure.ron", "right", &small);
}

#[test]
fn a_recorded_clip_is_cut_tracked_and_measured() {
    let clip = root().join("../shared/data/franck.mp4");
    if !clip.exists() {
        println!("skipped: ../shared/data/franck.mp4 is not here");
        return;
    }
    if heartian_face::models::FaceNets::load().is_err() {
        println!("skipped: the face models are not installed (`heartian models install`)");
        return;
    }
    let bench = Bench::new();
    let source = format!("frames.source={}", clip.display());
    let sets = [
        &source,
        "frames.seconds=4",
        "frames.size=128",
        "avatar.gaussians=2000",
        "avatar.steps=120",
        "phase.heart_rate_bpm=72",
    ];
    let metrics = bench.metrics("no_residual.ron", "recorded", &sets);
    assert!(figure(&metrics, "track.landmark_rms_percent_of_interocular") <= 3.0, "{metrics:#}");
    assert!(figure(&metrics, "attribute.hr_error_bpm") <= 1.0, "{metrics:#}");
    assert!(figure(&metrics, "avatar.training_psnr_db") >= 22.0, "{metrics:#}");
}
