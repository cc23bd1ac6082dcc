//! The commands that look at graphs and runs, as a user types them, on a short measurement.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

const SHORT: [&str; 4] = ["--set", "frames.seconds=6", "--set", "frames.size=48"];

struct Bench(tempfile::TempDir);

impl Bench {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn heartian(&self, arguments: &[&str]) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_heartian"));
        command.current_dir(self.0.path()).args(arguments).env_remove("HEARTIAN_CACHE").env("NO_COLOR", "1");
        command.output().unwrap()
    }

    /// Standard output of a command that goes well.
    fn said(&self, arguments: &[&str]) -> String {
        let output = self.heartian(arguments);
        assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    }

    fn json(&self, arguments: &[&str]) -> Value {
        serde_json::from_str(&self.said(arguments)).unwrap()
    }

    /// The folder of a run.
    fn run(&self, more: &[&str]) -> PathBuf {
        let said = self.said(&[&["run", &measure()], &SHORT[..], more].concat());
        self.0.path().join(said.lines().last().unwrap())
    }
}

fn measure() -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("graphs/measure.ron").display().to_string()
}

#[test]
fn a_run_is_explained_drawn_listed_and_described() {
    let bench = Bench::new();
    let plan = bench.json(&[&["explain", &measure(), "--json"], &SHORT[..]].concat());
    let standings: Vec<&str> = plan.as_array().unwrap().iter().map(|node| node["standing"].as_str().unwrap()).collect();
    assert_eq!(standings, ["miss", "waits", "waits"]);

    let first = bench.run(&[]);
    let again = bench.said(&[&["explain", &measure()], &SHORT[..]].concat());
    assert_eq!(again.matches("in the cache; made ").count(), 3, "{again}");
    let changed = bench.said(&[&["explain", &measure(), "frames", "--set", "frames.size=64"], &SHORT[..2]].concat());
    assert!(changed.contains("params.size: 48 → 64  at --set:1:13"), "{changed}");

    let second = bench.run(&["--set", "decode.convention=Paper"]);
    let why = bench.said(&["explain", &second.display().to_string(), "decode"]);
    assert!(why.starts_with("decode (BenchmarkDecoder): ran; made ") && why.contains("params.convention: "), "{why}");
    let report = bench.said(&["explain", &second.display().to_string(), "report"]);
    assert!(report.contains("inputs.traces[0]: ") && report.contains("because of `decode`"), "{report}");

    let svg = bench.said(&["graph", &measure(), "--run", &second.display().to_string()]);
    assert!(svg.starts_with("<svg ") && svg.contains("in the cache") && svg.contains(">clip</text>"), "{svg}");
    assert!(bench.said(&["graph", &measure(), "--dot"]).starts_with("digraph"));
    assert!(bench.said(&["graph", &measure(), "--mermaid"]).starts_with("flowchart"));

    let status = bench.json(&["status", "--json"]);
    assert_eq!(status["runs"].as_array().unwrap().len(), 2);
    assert!(status["runs"][0]["state"] == "finished" && status["cache"]["records"] == 5, "{status:#}");
    // A run that was killed leaves its marker behind; process 0 never runs.
    let marker = r#"{"pid": 4194305, "started": 0, "nodes": 3, "done": 1, "running": ["decode"]}"#;
    std::fs::write(first.join("running.json"), marker).unwrap();
    let status = bench.said(&["status"]);
    assert!(status.contains("was killed after 1 of 3 nodes") && status.contains("records"), "{status}");

    crate_is_sound(&second);
}

/// Every id that is named is there; every figure leads through artifacts and actions to the file or the node at the start.
fn crate_is_sound(folder: &Path) {
    let text = std::fs::read_to_string(folder.join("ro-crate-metadata.json")).unwrap();
    let described: Value = serde_json::from_str(&text).unwrap();
    let graph = described["@graph"].as_array().unwrap();
    let ids: BTreeSet<&str> = graph.iter().map(|entity| entity["@id"].as_str().unwrap()).collect();
    assert_eq!(ids.len(), graph.len(), "an id is given twice");
    let mut named = Vec::new();
    let mut waiting: Vec<&Value> = graph.iter().collect();
    while let Some(value) = waiting.pop() {
        match value {
            Value::Object(fields) => {
                named.extend(fields.get("@id").and_then(Value::as_str));
                waiting.extend(fields.values());
            }
            Value::Array(values) => waiting.extend(values),
            _ => {}
        }
    }
    let outside = |id: &&str| id.starts_with("http") || *id == "ro-crate-metadata.json";
    let lost: Vec<&&str> = named.iter().filter(|id| !outside(id) && !ids.contains(**id)).collect();
    assert!(lost.is_empty(), "{lost:?}");
    let find = |id: &str| graph.iter().find(|entity| entity["@id"] == id).unwrap();
    for part in find("./")["hasPart"].as_array().unwrap() {
        let path = part["@id"].as_str().unwrap();
        assert!(folder.join(path).is_file(), "{path} is described and not there");
    }
    assert_eq!(find("ro-crate-metadata.json")["conformsTo"][0]["@id"], "https://w3id.org/ro/crate/1.1");
    let run = find("#run");
    assert!(run["startTime"].as_str() <= run["endTime"].as_str() && run["actionStatus"]["@id"] != Value::Null);
    let workflow = find(run["instrument"]["@id"].as_str().unwrap());
    assert!(workflow["@type"].as_array().unwrap().iter().any(|kind| kind == "ComputationalWorkflow"));
    // From a figure back to the recording.
    let figure = find("#metric/input.pos.hr_bpm");
    assert!(figure["value"].is_number());
    let mut at = figure["isBasedOn"]["@id"].clone();
    let mut path = Vec::new();
    for _ in 0..10 {
        let makes =
            |entity: &&Value| entity["result"].as_array().is_some_and(|made| made.iter().any(|r| r["@id"] == at));
        let Some(action) = graph.iter().filter(|entity| entity["@id"] != "#run").find(makes) else { break };
        path.push(action["name"].as_str().unwrap().to_owned());
        let objects = action["object"].as_array().unwrap();
        let Some(next) = objects.iter().find(|object| object["@id"].as_str().unwrap().starts_with("#blake3/")) else {
            break;
        };
        at = next["@id"].clone();
    }
    assert_eq!(path, ["decode (BenchmarkDecoder)", "frames (FrameLoader)"]);
}

#[test]
fn a_sweep_says_what_it_costs_and_fills_a_table() {
    let bench = Bench::new();
    let over = ["--over", "decode.convention=[Toolbox, Paper]", "--over", "frames.size=[48, 64]"];
    let measure = measure();
    let sweep = [&["sweep", &measure, "--set", "frames.seconds=6"], &over[..]].concat();
    let dry = bench.said(&[&sweep[..], &["--dry-run"]].concat());
    assert!(dry.contains("4 points over decode.convention (2), frames.size (2)"), "{dry}");
    assert!(dry.contains("12 nodes, of which 10 are not shared"), "{dry}");
    assert!(dry.contains("0 in the cache, 2 to run, 8 that wait"), "{dry}");
    let said = bench.said(&sweep);
    let folder = bench.0.path().join(said.lines().last().unwrap());
    let csv = std::fs::read_to_string(folder.join("table.csv")).unwrap();
    let rows: Vec<&str> = csv.lines().collect();
    assert_eq!(rows.len(), 5, "{csv}");
    assert!(rows[0].starts_with("decode.convention,frames.size,") && rows[0].ends_with(",seconds,run"), "{csv}");
    assert!(rows[1].starts_with("Toolbox,48,") && rows[4].starts_with("Paper,64,"), "{csv}");
    let column = rows[0].split(',').position(|name| name == "input.pos.hr_bpm").unwrap();
    assert!(rows[1..].iter().all(|row| row.split(',').nth(column).unwrap().parse::<f64>().is_ok()), "{csv}");
    let after = bench.said(&[&sweep[..], &["--dry-run"]].concat());
    assert!(after.contains("10 in the cache, 0 to run"), "{after}");
    let wrong = bench.heartian(&["sweep", &measure, "--over", "frames.sise=[48]"]);
    let told = String::from_utf8_lossy(&wrong.stderr).into_owned();
    assert!(!wrong.status.success() && told.contains("--over:1:8") && told.contains("did you mean `size`?"), "{told}");
}

#[test]
fn kinds_and_schemas_come_as_json() {
    let bench = Bench::new();
    let all = bench.json(&["nodes", "--json"]);
    assert!(all.as_array().unwrap().len() > 8);
    let phase = bench.json(&["nodes", "PhaseModel", "--json"]);
    let params = phase["params"].as_array().unwrap();
    let rate = params.iter().find(|param| param["name"] == "heart_rate_bpm").unwrap();
    assert!(rate["unit"] == "bpm" && rate["doc"].as_str().unwrap().len() > 10, "{rate:#}");
    assert!(phase["inputs"].as_array().unwrap().iter().any(|port| port["artifact"] == "clip"));
    let schema = bench.json(&["schema"]);
    assert_eq!(schema["$schema"], "https://json-schema.org/draft/2020-12/schema");
    for kind in all.as_array().unwrap() {
        let definition = &schema["$defs"][kind["kind"].as_str().unwrap()];
        let known = definition["properties"]["params"]["properties"].as_object().unwrap();
        for param in kind["params"].as_array().unwrap() {
            let found = &known[param["name"].as_str().unwrap()];
            assert!(found["description"].as_str().is_some_and(|doc| !doc.is_empty()), "{found:#}");
            // Every parameter has a type or its words, not only a default.
            let shape = &found["anyOf"][0];
            let typed = shape["type"].is_string() || shape["enum"].is_array() || shape["anyOf"].is_array();
            assert!(typed, "{}.{}: {shape}", kind["kind"], param["name"]);
        }
    }
    assert_eq!(bench.json(&["schema", "Renderer"])["title"], "Renderer");
}

#[test]
fn devices_are_listed_and_a_graph_takes_one() {
    let bench = Bench::new();
    let found = bench.json(&["devices", "--json"]);
    let adapters = found["adapters"].as_array().unwrap();
    let automatic: Vec<&Value> = adapters.iter().filter(|adapter| adapter["is_automatic"] == true).collect();
    assert!(automatic.iter().all(|adapter| adapter["is_software"] == false), "auto takes no software adapter: {found}");
    assert_eq!(found["auto"], automatic.first().map_or(Value::from("cpu"), |adapter| adapter["name"].clone()));
    assert!(bench.said(&["devices"]).contains("--device auto takes "));

    let full = Path::new(env!("CARGO_MANIFEST_DIR")).join("graphs/full.ron").display().to_string();
    for device in ["auto", "cpu"] {
        assert!(bench.said(&["check", &full, "--device", device]).contains("nothing wrong"));
    }
    let refused = bench.heartian(&["check", &full, "--device", "cuda"]);
    assert!(!refused.status.success() && String::from_utf8_lossy(&refused.stderr).contains("auto, cpu or gpu"));
}

/// Where there is no real GPU, `auto` comes to the CPU and finds what the CPU made; a device that is asked for never does.
#[test]
fn a_device_shares_no_record_with_the_cpu_and_auto_shares_what_it_comes_to() {
    let bench = Bench::new();
    let graph = r#"Graph(name: "small", doc: "A short fit.", nodes: {
        "frames": (kind: "FrameLoader", params: (seconds: 1.5, size: 48)),
        "track": (kind: "FlameTracker", inputs: {"clip": "frames.clip", "landmarks": "frames.landmarks"}),
        "avatar": (kind: "BaselineTrainer", params: (steps: 100, gaussians: 200),
            inputs: {"clip": "frames.clip", "track": "track.track"}),
    })"#;
    std::fs::write(bench.0.path().join("small.ron"), graph).unwrap();
    bench.said(&["run", "small.ron", "--device", "cpu"]);
    let standing = |device: &str| {
        let plan = bench.json(&["explain", "small.ron", "--set", &format!("avatar.device={device}"), "--json"]);
        let of = |node: &Value| node["standing"].as_str().unwrap().to_owned();
        plan.as_array().unwrap().iter().map(of).collect::<Vec<_>>()
    };
    assert_eq!(standing("Cpu"), ["hit", "hit", "hit"]);
    let found = bench.json(&["devices", "--json"]);
    let avatar = if found["auto"] == "cpu" { "hit" } else { "miss" };
    assert_eq!(standing("Auto"), ["hit", "hit", avatar]);
    if !found["adapters"].as_array().unwrap().is_empty() {
        assert_eq!(standing("Gpu"), ["hit", "hit", "miss"]);
    }
}

/// The figures themselves are a busy machine's; that they are there, and agree with each other, is not.
#[test]
fn the_avatar_is_measured() {
    let bench = Bench::new();
    let recording = ["--seconds", "1.5", "--size", "48", "--steps", "6,12", "--gaussians", "200,300", "--sides", "32"];
    let report: Value = bench.json(&[&["bench", "avatar", "--json"], &recording[..]].concat());
    assert_eq!(report["fits"].as_array().map(Vec::len), Some(2), "{report}");
    assert!(report["fits"][1]["held_out_psnr_db"].as_f64().is_some_and(|psnr| psnr > 10.0), "{report}");
    assert_eq!(report["rendering"].as_array().map(Vec::len), Some(2));
    assert!(report["state_bytes_per_gaussian"].as_u64().is_some_and(|bytes| (300..=2000).contains(&bytes)));
    assert!(
        ["avatar.json", "avatar.txt", "avatar.png"].iter().all(|name| bench
            .0
            .path()
            .join("runs/bench-avatar")
            .join(name)
            .is_file())
    );
}
