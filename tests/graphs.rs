//! The graphs that come with the house, and the command that runs them.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use heartian_graph::{Cache, Graph, Plan, Problem, Registry, Run};

use crate::results::{files_below, statuses};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn graph_files() -> Vec<PathBuf> {
    let entries = std::fs::read_dir(root().join("graphs")).unwrap().flatten().map(|entry| entry.path());
    let mut files: Vec<PathBuf> = entries.filter(|path| path.extension().is_some_and(|kind| kind == "ron")).collect();
    files.sort();
    files
}

fn plan(path: &Path, sets: &[&str]) -> Plan {
    let mut graph = Graph::load(path).unwrap();
    sets.iter().for_each(|set| graph.set(set));
    match graph.plan(&Registry::compiled_in(), &[]) {
        Ok(plan) => plan,
        Err(problems) => panic!("{:#?}", problems.0.iter().map(Problem::one_line).collect::<Vec<_>>()),
    }
}

/// Kinds and parameters of a plan's nodes, which with equal inputs decide equal keys.
fn identity(plan: &Plan, ids: &[&str]) -> Vec<String> {
    let nodes = plan.nodes.iter().filter(|node| ids.contains(&&*node.id));
    nodes.map(|node| format!("{} {} {:?}", node.id, node.kind.kind, node.values)).collect()
}

fn heartian(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_heartian"));
    command.current_dir(folder).args(arguments).env_remove("HEARTIAN_CACHE").env("NO_COLOR", "1");
    command.output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Overlays of full.ron that change the pulse alone.
const ABLATIONS: [&str; 6] =
    ["no_residual", "direct_phase", "no_pos_prior", "global_pos", "sliding_pos", "waveform_only"];

#[test]
fn every_graph_that_ships_is_sound() {
    let files = graph_files();
    let names: BTreeSet<String> =
        files.iter().map(|path| path.file_stem().unwrap().to_string_lossy().into_owned()).collect();
    for wanted in ["full", "measure", "ubfc", "pure", "mmpd"].into_iter().chain(ABLATIONS) {
        assert!(names.contains(wanted), "graphs/{wanted}.ron is missing");
    }
    for path in files {
        assert!(!plan(&path, &[]).nodes.is_empty());
        let graph = Graph::load(&path).unwrap();
        assert!(!graph.doc().is_empty(), "{} says not what it is for", path.display());
        assert_eq!(Some(graph.name()), path.file_stem().and_then(|stem| stem.to_str()));
    }
}

#[test]
fn ablations_share_all_that_comes_before_the_pulse() {
    let shared = ["frames", "track", "avatar", "skin"];
    let full = identity(&plan(&root().join("graphs/full.ron"), &[]), &shared);
    assert_eq!(full.len(), shared.len());
    for overlay in ABLATIONS {
        assert_eq!(identity(&plan(&root().join(format!("graphs/{overlay}.ron")), &[]), &shared), full, "{overlay}");
    }
    let faster = plan(&root().join("graphs/full.ron"), &["phase.heart_rate_bpm=96"]);
    assert_eq!(identity(&faster, &shared), full);
}

#[test]
fn a_changed_parameter_changes_the_run_and_nothing_else_does() {
    let folder = tempfile::tempdir().unwrap();
    let cache = Cache::open(&folder.path().join("cache")).unwrap();
    let print = |sets: &[&str]| Run::prepare(&plan(&root().join("graphs/full.ron"), sets), &cache).fingerprint();
    assert_eq!(print(&[]), print(&[]));
    assert_ne!(print(&[]), print(&["phase.heart_rate_bpm=96"]));
}

#[test]
fn the_command_checks_and_prints_its_manual() {
    let check = heartian(root(), &["check", "graphs/full.ron"]);
    assert!(check.status.success(), "{}", text(&check.stderr));
    assert!(text(&check.stdout).contains("nothing wrong"));
    let list = heartian(root(), &["nodes"]);
    for kind in Registry::compiled_in().iter() {
        assert!(text(&list.stdout).contains(kind.kind));
        let manual = text(&heartian(root(), &["nodes", kind.kind]).stdout);
        for name in kind.params.iter().map(|param| param.name).chain(kind.inputs.iter().map(|port| port.name)) {
            assert!(manual.contains(name), "{}.{name}", kind.kind);
        }
    }
}

/// The figures of a run but the times its nodes took.
fn untimed(metrics: &serde_json::Value) -> Vec<(String, serde_json::Value)> {
    let figures = metrics["metrics"].as_object().unwrap().iter().filter(|(key, _)| !key.ends_with(".seconds"));
    figures.map(|(key, value)| (key.clone(), value.clone())).collect()
}

/// A short measurement: cold, cached, damaged and healed, with another parameter; results in one folder each.
#[test]
fn a_measurement_runs_hits_and_heals() {
    let folder = tempfile::tempdir().unwrap();
    let measure = root().join("graphs/measure.ron").display().to_string();
    let run = |more: &[&str]| {
        let short = ["run", &measure, "--set", "frames.seconds=6", "--set", "frames.size=48"];
        let output = heartian(folder.path(), &[&short, more].concat());
        assert!(output.status.success(), "{}", text(&output.stderr));
        folder.path().join(text(&output.stdout).lines().last().unwrap())
    };
    let first = run(&[]);
    assert_eq!(statuses(&first), "frames:ran decode:ran report:ran");
    let metrics: serde_json::Value =
        serde_json::from_slice(&std::fs::read(first.join("metrics.json")).unwrap()).unwrap();
    assert_eq!(metrics["graph"], "measure");
    assert!(metrics["metrics"]["input.pos.hr_bpm"].as_f64().is_some(), "{metrics}");
    let delivered = files_below(&first);
    assert!(delivered.len() > 2, "no report among {delivered:?}");

    let start = std::time::Instant::now();
    assert_eq!(run(&[]), first);
    println!("cached rerun, whole process: {:?}", start.elapsed());
    assert_eq!(statuses(&first), "frames:hit decode:hit report:hit");

    for blob in files_below(&folder.path().join(".heartian/cache/artifacts")) {
        let mut bytes = std::fs::read(&blob).unwrap();
        *bytes.last_mut().unwrap() ^= 0x40;
        std::fs::write(blob, bytes).unwrap();
    }
    std::fs::remove_dir_all(&first).unwrap();
    assert_eq!(run(&[]), first);
    let healed: serde_json::Value =
        serde_json::from_slice(&std::fs::read(first.join("metrics.json")).unwrap()).unwrap();
    assert_eq!(untimed(&healed), untimed(&metrics));
    assert_eq!(files_below(&first), delivered);

    let other = run(&["--set", "decode.convention=Paper"]);
    assert_ne!(other, first);
    assert!(statuses(&other).starts_with("frames:hit decode:ran"), "{}", statuses(&other));
    let compared = heartian(folder.path(), &["compare", &first.display().to_string(), &other.display().to_string()]);
    assert!(text(&compared.stdout).contains("input.pos.hr_bpm"), "{}", text(&compared.stderr));
}

/// One clear error each, naming node, parameter and remedy; exit code 1 for a graph, 2 for wrong usage.
#[test]
fn the_command_refuses_with_reasons() {
    let folder = tempfile::tempdir().unwrap();
    let full = root().join("graphs/full.ron").display().to_string();
    let run = |arguments: &[&str]| {
        let output = heartian(folder.path(), arguments);
        let words = text(&output.stderr).split_whitespace().collect::<Vec<_>>().join(" ");
        (output.status.code(), words)
    };
    let silent = format!("frames.source={}", root().join("Cargo.toml").display());
    let cases: [(&[&str], i32, &[&str]); 8] = [
        (
            &["run", &full, "--set", "frames.sauce=x"],
            1,
            &["`frames`", "no parameter `sauce`", "did you mean `source`?"],
        ),
        (&["run", &full, "--set", "frames.source=no/such.mp4"], 1, &["`frames`", "`source`", "no/such.mp4"]),
        // Without a pulse to write nothing starts, least of all the trainer.
        (&["run", &full, "--set", &silent], 1, &["`phase`", "without a PPG", "phase.heart_rate_bpm"]),
        (&["run", &full, "--set", "frames.seconds=-3"], 1, &["`frames`", "`seconds`", "-3"]),
        (&["run", &full, "--target", "rendr"], 1, &["no node `rendr`", "did you mean `render`?"]),
        (&["run", "no/such.ron"], 1, &["cannot read the graph `no/such.ron`"]),
        (&["nodes", "Rendrer"], 1, &["no kind of node `Rendrer`"]),
        (&["run"], 2, &["Usage"]),
    ];
    for (arguments, code, words) in cases {
        let (found, said) = run(arguments);
        assert_eq!(found, Some(code), "{arguments:?}: {said}");
        for word in words {
            assert!(said.contains(word), "{arguments:?} says: {said}");
        }
    }
    assert!(std::fs::read_dir(folder.path()).unwrap().next().is_none(), "a refused run leaves nothing behind");
}

/// The tracking graph on a short recording: every promised figure is there, and the truth is met.
#[test]
fn tracking_says_how_well_it_went() {
    let folder = tempfile::tempdir().unwrap();
    let track = root().join("graphs/track.ron").display().to_string();
    let short = ["run", &track, "--set", "frames.seconds=6", "--set", "frames.size=160", "--set", "movie.seconds=0.5"];
    let output = heartian(folder.path(), &short);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let run = folder.path().join(text(&output.stdout).lines().last().unwrap());
    let file: serde_json::Value = serde_json::from_slice(&std::fs::read(run.join("metrics.json")).unwrap()).unwrap();
    let figure = |key: &str| file["metrics"][key].as_f64().unwrap_or_else(|| panic!("no figure `{key}`: {file:#}"));
    assert_eq!(figure("frames.count"), 180.0);
    assert!(figure("frames.seconds") > 0.0 && figure("track.seconds") > 0.0);
    assert_eq!(file["metrics"]["track.head_model"], "procedural");
    assert!(figure("track.lost_frames") <= 5.0 && figure("track.jitter_deg_rms") > 0.0);
    assert!(figure("track.landmark_rms_fraction") <= 0.03);
    assert!(figure("track.rotation_error_deg") <= 1.5);
    assert!(figure("track.jaw_correlation") >= 0.95);
    assert!(figure("track.blink_f1") >= 0.95);
    assert!(run.join("movie.clip.avi").exists() && run.join("contact_sheet.png").exists());
}
