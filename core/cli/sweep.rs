//! `heartian sweep`: one graph at many points, sharing what they have in common, and one table of all figures.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use heartian_graph::{Digest, Forecast, Graph, History, Plan, Run, Sweep};
use miette::{IntoDiagnostic, Result, WrapErr};

use crate::arguments::SweepArguments;
use crate::clock;
use crate::plugins;
use crate::session::{Done, INTERRUPTED, Job, Session, file_name};
use crate::summary::table;

/// The graph at one point.
struct Point {
    settings: Vec<String>,
    graph: Graph,
    plan: Plan,
}

/// Says what a sweep shares and costs, runs it, and writes its table.
pub fn sweep(arguments: &SweepArguments) -> Result<ExitCode> {
    let sweep = Sweep::parse(&arguments.overs, arguments.zip)?;
    let points: Vec<Point> = (0..sweep.points.len()).map(|at| point(arguments, &sweep, at)).collect::<Result<_>>()?;
    let session = Session::open(&arguments.host)?;
    let mut prints: Vec<Digest> = Vec::with_capacity(points.len());
    let mut previews = Vec::with_capacity(points.len());
    for point in &points {
        let run = Run::prepare(&point.plan, &session.cache);
        prints.push(run.fingerprint());
        previews.push((&point.plan, run.preview()));
    }
    print!("{}", said(&sweep, &Forecast::of(&previews, &History::read(&session.cache))));
    if arguments.dry_run {
        return Ok(ExitCode::SUCCESS);
    }
    let mut rows = Vec::with_capacity(points.len());
    let mut failed = false;
    for (at, point) in points.iter().enumerate() {
        let values = sweep.points[at].join(", ");
        eprintln!("point {} of {}: {values}", at + 1, points.len());
        let job = Job { graph: &point.graph, sets: &point.settings, plan: &point.plan, out: None };
        let done = session.carry_out(&job)?;
        done.delivered.warnings.iter().for_each(|text| session.terminal.warn("results", text));
        for problem in &done.problems {
            eprintln!("{:?}", miette::Report::new(problem.clone()));
        }
        failed |= !done.problems.is_empty();
        rows.push(done);
        if session.cancelled() || (failed && !arguments.host.keep_going) {
            break;
        }
    }
    session.terminal.finish();
    let name = points.first().map_or("graph", |point| point.plan.name.as_str());
    let print = Digest::of(prints.iter().map(Digest::to_string).collect::<String>().as_bytes()).to_string();
    let named = || Path::new("runs").join(format!("{}-sweep-{}", file_name(name), &print[..8]));
    let folder = arguments.out.clone().unwrap_or_else(named);
    write(&folder, &sweep, &rows)?;
    if session.cancelled() {
        eprintln!("interrupted after {} of {} points; what is finished is kept", rows.len(), points.len());
        return Ok(ExitCode::from(INTERRUPTED));
    }
    Ok(if failed { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

fn point(arguments: &SweepArguments, sweep: &Sweep, at: usize) -> Result<Point> {
    let settings = sweep.settings(at);
    let mut graph = Graph::load(&arguments.graph.graph)?;
    arguments.graph.sets.iter().for_each(|set| graph.set(set));
    settings.iter().for_each(|setting| graph.set_from("--over", setting));
    let plan = graph.plan(plugins::registry()?, &arguments.graph.targets)?;
    Ok(Point { settings: arguments.graph.sets.iter().cloned().chain(settings).collect(), graph, plan })
}

/// What is shared, what is new, how long it takes.
fn said(sweep: &Sweep, forecast: &Forecast) -> String {
    let Forecast { points, nodes, distinct, cached, runs, waits, seconds, untimed } = forecast;
    let axes: Vec<String> = sweep
        .axes
        .iter()
        .enumerate()
        .map(|(axis, name)| {
            let values: BTreeSet<&String> = sweep.points.iter().map(|point| &point[axis]).collect();
            format!("{name} ({})", values.len())
        })
        .collect();
    let mut text = format!("{points} points over {}\n", axes.join(", "));
    text.push_str(&format!("  {nodes} nodes, of which {distinct} are not shared with an earlier point\n"));
    text.push_str(&format!("  {cached} in the cache, {runs} to run, {waits} that wait for these\n"));
    let unknown = if untimed.is_empty() {
        String::new()
    } else {
        format!(", and what has never run here: {}", untimed.join(", "))
    };
    text.push_str(&format!("  about {} of work{unknown}\n", clock::span(*seconds)));
    text
}

/// The table as CSV, and as text on the screen and beside it.
fn write(folder: &Path, sweep: &Sweep, rows: &[Done]) -> Result<()> {
    std::fs::create_dir_all(folder)
        .into_diagnostic()
        .wrap_err_with(|| format!("cannot make `{}`", folder.display()))?;
    let keys: BTreeSet<&String> = rows.iter().flat_map(|done| done.delivered.metrics.keys()).collect();
    let mut csv: Vec<Vec<String>> = Vec::with_capacity(rows.len() + 1);
    let heading = sweep.axes.iter().chain(keys.iter().copied()).cloned();
    csv.push(heading.chain(["seconds", "run"].map(str::to_owned)).collect());
    for (point, done) in sweep.points.iter().zip(rows) {
        let figures = keys.iter().map(|key| done.delivered.metrics.get(*key).map_or(String::new(), f64::to_string));
        let seconds: f64 = done.reports.iter().map(|report| report.seconds).sum();
        let end = [format!("{seconds:.3}"), done.folder.display().to_string()];
        csv.push(point.iter().cloned().chain(figures).chain(end).collect());
    }
    let lines: Vec<String> =
        csv.iter().map(|row| row.iter().map(|cell| quoted(cell)).collect::<Vec<_>>().join(",")).collect();
    // Columns become lines: there are many figures and few points.
    let turn = |column: usize| -> Vec<String> {
        let cells = csv.iter().map(|row| row[column].as_str()).enumerate();
        cells.map(|(row, cell)| if row == 0 { cell.to_owned() } else { short(cell) }).collect()
    };
    let turned: Vec<Vec<String>> = (0..csv[0].len()).map(turn).collect();
    let right: Vec<bool> = (0..csv.len()).map(|column| column > 0).collect();
    let text = table(&turned, &right);
    put(&folder.join("table.csv"), &(lines.join("\n") + "\n"))?;
    put(&folder.join("table.txt"), &text)?;
    print!("\n{text}");
    println!("{}", folder.display());
    Ok(())
}

fn put(path: &Path, text: &str) -> Result<()> {
    let path: PathBuf = path.to_owned();
    std::fs::write(&path, text).into_diagnostic().wrap_err_with(|| format!("cannot write `{}`", path.display()))
}

fn quoted(cell: &str) -> String {
    if cell.contains([',', '"', '\n']) { format!("\"{}\"", cell.replace('"', "\"\"")) } else { cell.to_owned() }
}

/// A figure to six significant digits; the CSV keeps all.
fn short(cell: &str) -> String {
    match cell.parse::<f64>() {
        Ok(value) if value.fract() != 0.0 && cell.len() > 8 => {
            let digits = (5.0 - value.abs().log10().floor()).clamp(0.0, 12.0) as usize;
            format!("{value:.digits$}")
        }
        _ => cell.to_owned(),
    }
}
