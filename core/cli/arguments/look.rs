//! Arguments of the commands that look at graphs and runs: explain, sweep, graph, schema, status.

use std::path::PathBuf;

use clap::Args;

use super::{GraphArguments, HostArguments};

/// Why nodes are hits or misses.
#[derive(Args)]
#[command(after_help = "\
Examples:
  heartian explain graphs/full.ron                     what would run now, and why
  heartian explain graphs/full.ron hr --set phase.heart_rate_bpm=96
  heartian explain runs/full-1a2b3c4d                  what ran then, and why

For each node that runs: the field of its key that differs from the nearest earlier record, from what to what; where it
is an input, back to the node that caused it.")]
pub struct ExplainArguments {
    /// A graph, or the folder of a run
    pub what: PathBuf,
    /// Only this node
    pub node: Option<String>,
    /// Change a parameter of the graph
    #[arg(long = "set", visible_alias = "param", value_name = "NODE.PARAM=VALUE")]
    pub sets: Vec<String>,
    /// Folder of the cache [default: $HEARTIAN_CACHE, or .heartian/cache]
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// As JSON
    #[arg(long)]
    pub json: bool,
}

/// One graph at many points.
#[derive(Args)]
#[command(after_help = "\
Examples:
  heartian sweep graphs/full.ron --over 'phase.heart_rate_bpm=[60, 72, 96]'
  heartian sweep graphs/full.ron --over 'phase.heart_rate_bpm=[60, 96]' --over 'relight.light=[\"warm\", \"white\"]'
  heartian sweep graphs/full.ron --over 'frames.source=[\"a.mp4\", \"b.mp4\"]' --over 'frames.ppg=[\"a.csv\", \"b.csv\"]' --zip
  heartian sweep graphs/full.ron --over 'phase.heart_rate_bpm=[60, 72, 96]' --dry-run

Says first what the points share, what is new, and about how long that takes. The table of all figures lies in
runs/NAME-sweep-XXXXXXXX as table.csv and table.txt; each point also has its own folder, as `heartian run` makes it.")]
pub struct SweepArguments {
    /// The graph.
    #[command(flatten)]
    pub graph: GraphArguments,
    /// What varies, and its values; all combinations of several
    #[arg(long = "over", value_name = "NODE.PARAM=[VALUE, ..]", required = true)]
    pub overs: Vec<String>,
    /// The first values of all together, then the second ones, and so on
    #[arg(long)]
    pub zip: bool,
    /// Only say what would run
    #[arg(long)]
    pub dry_run: bool,
    /// Folder of the table [default: runs/NAME-sweep-XXXXXXXX]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Where and how.
    #[command(flatten)]
    pub host: HostArguments,
}

/// A graph as a picture.
#[derive(Args)]
#[command(after_help = "\
Examples:
  heartian graph graphs/full.ron --svg -o full.svg            green: in the cache, orange: would run
  heartian graph graphs/full.ron --svg --run runs/full-1a2b3c4d -o full.svg
  heartian graph graphs/full.ron --dot | dot -Tpdf -o full.pdf
  heartian graph graphs/full.ron --mermaid")]
pub struct DrawArguments {
    /// The graph.
    #[command(flatten)]
    pub graph: GraphArguments,
    /// As SVG (the default)
    #[arg(long, group = "form")]
    pub svg: bool,
    /// For Graphviz
    #[arg(long, group = "form")]
    pub dot: bool,
    /// For Markdown that draws Mermaid
    #[arg(long, group = "form")]
    pub mermaid: bool,
    /// Colour the nodes by what they did in this run instead of by the cache
    #[arg(long, value_name = "DIR")]
    pub run: Option<PathBuf>,
    /// Folder of the cache [default: $HEARTIAN_CACHE, or .heartian/cache]
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// File to write [default: standard output]
    #[arg(short = 'o', long = "out", value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// What has been run, what is running.
#[derive(Args)]
pub struct StatusArguments {
    /// Folder of the runs
    #[arg(long, value_name = "DIR", default_value = "runs")]
    pub runs: PathBuf,
    /// Folder of the cache [default: $HEARTIAN_CACHE, or .heartian/cache]
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// How many runs, the latest
    #[arg(long, default_value_t = 12)]
    pub last: usize,
    /// As JSON
    #[arg(long)]
    pub json: bool,
}
