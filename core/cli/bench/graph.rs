//! `heartian bench graph`: what the engine itself costs, and what it does when things go wrong.
//!
//! Every figure is of a process of this very program from start to end, on graphs of the `Blob` node, in a folder of
//! their own that vanishes. The plugin runs inside the program, as a trusted one does.

mod measure;
mod probes;
mod shapes;

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::time::Duration;

use clap::Args;
use miette::{IntoDiagnostic, Result, WrapErr, miette};
use serde_json::{Map, Value, json};

use crate::plugins;
use crate::summary::table;
use measure::{Measured, least_and_median, measure};
use shapes::Shape;

/// Bytes of each node's artifact.
const BYTES: u64 = 1 << 20;
/// Cached runs of the small graph; the median counts.
const RUNS: usize = 21;
/// Cached runs of the large one.
const FEW_RUNS: usize = 5;

/// See [`Bench::remove`].
const FORGETTING: Duration = Duration::from_secs(6);

/// How the engine is measured.
#[derive(Args)]
#[command(after_help = "\
Examples:
  heartian bench graph --plugin target/release/libheartian_blob.so
  heartian bench graph --blocks 10 --length 0 --json

Without --plugin the library is looked for beside this program. Needs about 3 GB of room in the folder for temporary files.
On a busy machine read processor seconds, not wall seconds.")]
pub struct GraphBench {
    /// Blocks of ten nodes in the large graph
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..))]
    pub blocks: u32,
    /// Only with the blocks chained
    #[arg(long, conflicts_with = "wide")]
    pub deep: bool,
    /// Only with the blocks side by side
    #[arg(long)]
    pub wide: bool,
    /// Nodes of the long chain; 0 leaves it out
    #[arg(long, default_value_t = 100_000)]
    pub length: u32,
    /// How often a run is killed; 0 leaves that out
    #[arg(long, default_value_t = 10)]
    pub kills: u32,
    /// For machines
    #[arg(long)]
    pub json: bool,
}

/// A folder of graphs, and this program run in it.
struct Bench {
    folder: tempfile::TempDir,
    program: PathBuf,
    plugin: PathBuf,
}

/// One line of the table: what, the figure, what was promised.
type Row = [String; 3];

/// What is found, for people and for machines.
#[derive(Default)]
struct Findings {
    rows: Vec<Row>,
    json: Map<String, Value>,
}

impl Findings {
    /// Adds a line, and says it at once: some figures take minutes.
    fn add(&mut self, what: &str, (key, value): (&str, Value), figure: String, promise: &str) {
        eprintln!("{}: {figure}", what.trim());
        self.rows.push([what.to_owned(), figure, promise.to_owned()]);
        self.json.insert(key.to_owned(), value);
    }
}

/// Measures everything and prints it.
pub fn run(arguments: &GraphBench) -> Result<ExitCode> {
    let bench = Bench::new()?;
    let mut findings = Findings::default();
    ten_nodes(&bench, &mut findings)?;
    let shapes = [(Shape::Deep, !arguments.wide), (Shape::Wide, !arguments.deep)];
    for (shape, _) in shapes.into_iter().filter(|(_, wanted)| *wanted) {
        many_nodes(&bench, shape, arguments.blocks as usize, &mut findings)?;
    }
    if arguments.length > 0 {
        long_chain(&bench, arguments.length as usize, &mut findings)?;
    }
    probes::all(&bench, arguments.kills, &mut findings)?;
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&findings.json).into_diagnostic()?);
    } else {
        let heading = ["", "measured", "promised"].map(str::to_owned);
        let rows: Vec<Vec<String>> = std::iter::once(heading).chain(findings.rows).map(Vec::from).collect();
        print!("{}", table(&rows, &[]));
    }
    Ok(ExitCode::SUCCESS)
}

impl Bench {
    fn new() -> Result<Self> {
        let program = std::env::current_exe().into_diagnostic()?;
        let plugin = find_plugin(&program)?;
        let bench = Self { folder: tempfile::tempdir().into_diagnostic()?, program, plugin };
        let trusted = bench.command(&["plugins", "trust"]).arg(&bench.plugin).output().into_diagnostic()?;
        if trusted.status.success() {
            return Ok(bench);
        }
        Err(miette!("the plugin cannot be loaded:\n{}", String::from_utf8_lossy(&trusted.stderr)))
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// This program, in the folder of the bench.
    fn command(&self, words: &[&str]) -> Command {
        let mut command = Command::new(&self.program);
        command.current_dir(self.folder.path()).env_remove("HEARTIAN_CACHE").args(words);
        command
    }

    /// A run of a graph file on a cache, both by name; results in a folder of the graph's name.
    fn run(&self, graph: &str, cache: &str) -> Command {
        let mut command = self.command(&["run", graph, "--cache", cache, "--out"]);
        command.arg(self.path(graph).with_extension("out")).arg("--plugin").arg(&self.plugin);
        command
    }

    fn write(&self, name: &str, text: &str) -> Result<()> {
        std::fs::write(self.path(name), text).into_diagnostic().wrap_err("the folder for temporary files is full")
    }

    /// Measures a run that must end well.
    fn time(&self, command: &mut Command) -> Result<Measured> {
        let measured = measure(command)?;
        if measured.success {
            return Ok(measured);
        }
        let output = command.output().into_diagnostic()?;
        Err(miette!("a run failed that should not:\n{}", String::from_utf8_lossy(&output.stderr)))
    }

    /// Removes a folder of many files, and waits until the file system forgets: ext4 does not use the place of a file
    /// again for five seconds and searches past all such places, which would be charged to the next run.
    fn remove(&self, name: &str) {
        let _ = std::fs::remove_dir_all(self.path(name));
        std::thread::sleep(FORGETTING);
    }
}

/// The library named by `--plugin`, or the one beside the program.
fn find_plugin(program: &Path) -> Result<PathBuf> {
    let name = format!("{}heartian_blob{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX);
    let named = plugins::named_files().first().cloned();
    let beside = program.parent().map(|folder| [folder.join(&name), folder.join("plugins").join(&name)]);
    let found = named.or_else(|| beside.into_iter().flatten().find(|path| path.is_file()));
    let found = found.and_then(|path| std::fs::canonicalize(path).ok());
    found.ok_or_else(|| {
        let help = "build it: cargo build --release -p heartian-blob\nthen give it: --plugin target/release/";
        miette!(help = format!("{help}{name}"), "there is no `{name}` beside the program")
    })
}

fn milliseconds(seconds: f64) -> String {
    format!("{:.1} ms", seconds * 1e3)
}

fn ten_nodes(bench: &Bench, findings: &mut Findings) -> Result<()> {
    bench.write("ten.ron", &shapes::blocks(1, Shape::Deep, BYTES))?;
    let cold = bench.time(&mut bench.run("ten.ron", "ten"))?;
    let cached: Vec<Measured> =
        (0..RUNS).map(|_| bench.time(&mut bench.run("ten.ron", "ten"))).collect::<Result<_>>()?;
    let [least, median] = least_and_median(cached.iter().map(|run| run.wall_s));
    let [_, cpu] = least_and_median(cached.iter().filter_map(|run| run.cpu_s));
    let figure = format!("{} (least {}, CPU {})", milliseconds(median), milliseconds(least), milliseconds(cpu));
    let value = json!({"median_wall_s": median, "least_wall_s": least, "median_cpu_s": cpu, "cold": cold});
    findings.add("10 nodes cached, whole process", ("ten_cached", value), figure, "≤ 20 ms");
    if let Some(make) = make(bench, 1, Shape::Deep, RUNS)? {
        let figure = format!("{} (least {})", milliseconds(make.wall[1]), milliseconds(make.wall[0]));
        let value = json!({"median_wall_s": make.wall[1], "least_wall_s": make.wall[0], "median_cpu_s": make.cpu});
        findings.add("  make, nothing to do", ("ten_make", value), figure, "");
    }
    Ok(())
}

fn many_nodes(bench: &Bench, shape: Shape, blocks: usize, findings: &mut Findings) -> Result<()> {
    let (nodes, name, graph) = (blocks * 10, shape.name(), format!("{}.ron", shape.name()));
    bench.write(&graph, &shapes::blocks(blocks, shape, BYTES))?;
    let cold = bench.time(&mut bench.run(&graph, name))?;
    let runs = (0..FEW_RUNS).map(|_| bench.time(&mut bench.run(&graph, name)));
    let cached: Vec<Measured> = runs.collect::<Result<_>>()?;
    let [least, cpu] = least_and_median(cached.iter().filter_map(|run| run.cpu_s));
    let [_, wall] = least_and_median(cached.iter().map(|run| run.wall_s));
    bench.remove(name);
    let figure = format!("CPU {cpu:.3} s (least {least:.3}), wall {wall:.3} s");
    let value = json!({"nodes": nodes, "median_cpu_s": cpu, "least_cpu_s": least, "median_wall_s": wall});
    let what = format!("{nodes} nodes cached, {name}");
    findings.add(&what, (&format!("{name}_cached"), value), figure, "≤ 0.2 s CPU for 1000");
    let cpu = cold.cpu_s.unwrap_or(0.0);
    let each = cpu / nodes as f64;
    let figure = format!("CPU {} a node (wall {:.2} s)", milliseconds(each), cold.wall_s);
    let value = json!({"nodes": nodes, "cpu_s_per_node": each, "cpu_s": cpu, "wall_s": cold.wall_s});
    let what = "  cold, 1 MiB made, hashed and stored";
    findings.add(what, (&format!("{name}_cold"), value), figure, "≤ 2 ms beyond the node's own work");
    if let Some(make) = make(bench, blocks, shape, FEW_RUNS)? {
        let figure = format!("CPU {:.3} s, wall {:.3} s", make.cpu, make.wall[1]);
        let value = json!({"median_cpu_s": make.cpu, "median_wall_s": make.wall[1], "cold": make.cold});
        findings.add("  make, nothing to do", (&format!("{name}_make"), value), figure, "");
        let each = make.cold.cpu_s.unwrap_or(0.0) / nodes as f64;
        let figure = format!("CPU {} a node (wall {:.2} s)", milliseconds(each), make.cold.wall_s);
        findings.add("  make, cold", (&format!("{name}_make_cold_cpu_s_per_node"), json!(each)), figure, "");
    }
    Ok(())
}

fn long_chain(bench: &Bench, length: usize, findings: &mut Findings) -> Result<()> {
    bench.write("chain.ron", &shapes::chain(length, 8))?;
    let mut check = bench.command(&["check", "chain.ron", "--plugin"]);
    let check = bench.time(check.arg(&bench.plugin))?;
    let cold = bench.time(&mut bench.run("chain.ron", "chain"))?;
    let cached = bench.time(&mut bench.run("chain.ron", "chain"))?;
    bench.remove("chain");
    for (what, key, run, promise) in [
        ("checks and plans", "chain_check", check, "≤ 5 s, ≤ 1 GiB"),
        ("cached run with its report", "chain_cached", cached, "≤ 5 s, ≤ 1 GiB"),
        ("cold run", "chain_cold", cold, ""),
    ] {
        let peak = run.peak_bytes.map_or(String::new(), |peak| format!(", {}", crate::sizes::show(peak)));
        let figure = format!("{:.2} s, CPU {:.2} s{peak}", run.wall_s, run.cpu_s.unwrap_or(0.0));
        findings.add(&format!("chain of {length}: {what}"), (key, json!(run)), figure, promise);
    }
    Ok(())
}

/// What make needs for the same shape.
struct Make {
    cold: Measured,
    /// Least and median of runs with nothing to do.
    wall: [f64; 2],
    /// Median.
    cpu: f64,
}

/// Measures make, where there is one.
fn make(bench: &Bench, blocks: usize, shape: Shape, runs: usize) -> Result<Option<Make>> {
    let folder = bench.path("make");
    std::fs::create_dir_all(&folder).into_diagnostic()?;
    bench.write("make/Makefile", &shapes::makefile(blocks, shape, BYTES))?;
    let jobs = std::thread::available_parallelism().map_or(1, usize::from);
    let command = || {
        let mut command = Command::new("make");
        command.current_dir(&folder).arg(format!("-j{jobs}"));
        command
    };
    let Ok(cold) = measure(&mut command()) else { return Ok(None) };
    let again: Vec<Measured> = (0..runs).map(|_| measure(&mut command())).collect::<Result<_>>()?;
    bench.remove("make");
    let [_, cpu] = least_and_median(again.iter().filter_map(|run| run.cpu_s));
    let wall = least_and_median(again.iter().map(|run| run.wall_s));
    Ok(cold.success.then_some(Make { cold, wall, cpu }))
}
