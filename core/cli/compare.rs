//! `heartian compare`: the metrics of several runs side by side, what each changes against the first, and what each
//! node did in each.

mod waveforms;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use miette::{IntoDiagnostic, Result, WrapErr, miette};

use crate::deliver::{Figure, MetricsFile};
use crate::summary::table;

/// Prints one column a run.
pub fn print(runs: &[PathBuf], plot: Option<&Path>) -> Result<ExitCode> {
    let files: Vec<MetricsFile> = runs.iter().map(|run| read(run)).collect::<Result<_>>()?;
    let names = headings(runs, &files);
    let right = vec![true; files.len() + 1];
    let right = [&[false], &right[1..]].concat();
    let mut rows = vec![heading_row("metric", &names)];
    let keys: BTreeSet<&String> = files.iter().flat_map(|file| file.metrics.keys()).collect();
    for key in keys {
        let cells = files.iter().map(|file| match file.metrics.get(key) {
            Some(Some(Figure::Number(value))) => figure(*value),
            Some(Some(Figure::Name(name))) => name.clone(),
            Some(None) => "not measured".to_owned(),
            None => "–".to_owned(),
        });
        rows.push(std::iter::once(key.clone()).chain(cells).collect());
    }
    print!("{}", table(&rows, &right));
    waveforms::print(runs, &files, &names, plot)?;
    let mut rows = vec![heading_row("node", &names)];
    let mut ids: Vec<&String> = Vec::new();
    for node in files.iter().flat_map(|file| &file.nodes) {
        if !ids.contains(&&node.id) {
            ids.push(&node.id);
        }
    }
    for id in ids {
        let cells = files.iter().map(|file| match file.nodes.iter().find(|node| node.id == *id) {
            Some(node) => format!("{} {:.2} s", node.status.word(), node.seconds),
            None => "–".to_owned(),
        });
        rows.push(std::iter::once(id.clone()).chain(cells).collect());
    }
    print!("\n{}", table(&rows, &right));
    Ok(ExitCode::SUCCESS)
}

fn read(run: &Path) -> Result<MetricsFile> {
    let path = if run.is_dir() { run.join("metrics.json") } else { run.to_owned() };
    let text = std::fs::read_to_string(&path).map_err(|error| {
        miette!(help = "give a folder that `heartian run` wrote", "cannot read `{}`: {error}", path.display())
    })?;
    serde_json::from_str(&text)
        .into_diagnostic()
        .wrap_err_with(|| format!("`{}` is not a metrics file", path.display()))
}

/// Graph names, or folder names where two runs are of one graph.
fn headings(runs: &[PathBuf], files: &[MetricsFile]) -> Vec<String> {
    let heading = |(run, file): (&PathBuf, &MetricsFile)| {
        let alone = files.iter().filter(|other| other.graph == file.graph).count() == 1;
        let folder = if run.is_dir() { run.file_name() } else { run.parent().and_then(Path::file_name) };
        folder.filter(|_| !alone).map_or(file.graph.clone(), |folder| folder.to_string_lossy().into_owned())
    };
    runs.iter().zip(files).map(heading).collect()
}

fn heading_row(first: &str, names: &[String]) -> Vec<String> {
    std::iter::once(first.to_owned()).chain(names.iter().cloned()).collect()
}

/// Counts whole, all else to four significant digits or more.
fn figure(value: f64) -> String {
    let decimals = match value.abs() {
        magnitude if value.fract() == 0.0 && magnitude >= 100.0 => 0,
        magnitude if magnitude >= 100.0 => 1,
        magnitude if magnitude >= 0.1 || magnitude == 0.0 => 3,
        _ => return format!("{value:.2e}"),
    };
    format!("{value:.decimals$}")
}
