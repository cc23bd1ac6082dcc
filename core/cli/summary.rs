//! Tables for the end of a run: what each node did, and the main figures in plain words.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::time::Duration;

use heartian_graph::{NodeReport, Plan, Status};

/// The figures most readers want, in plain words: key, words, unit, decimals.
const PLAIN: [(&str, &str, &str, usize); 12] = [
    ("reference.hr_bpm", "heart rate written", "bpm", 2),
    ("attribute.hr_bpm", "heart rate read from the albedo", "bpm", 2),
    ("attribute.hr_error_bpm", "  its error", "bpm", 2),
    ("rendered.pos.hr_error_bpm", "error of POS on the rendered clip", "bpm", 2),
    ("baseline_rendered.pos.hr_error_bpm", "  the same without the heartbeat", "bpm", 2),
    ("relit.pos.hr_error_bpm", "  the same under another light", "bpm", 2),
    ("input.pos.hr_bpm", "heart rate POS reads from the input", "bpm", 2),
    ("baseline.psnr_db", "avatar against the input, held-out frames", "dB", 2),
    ("modulated.psnr_db", "  with the heartbeat", "dB", 2),
    ("track.landmark_rms_px", "landmarks against the tracked head", "px", 2),
    ("avatar.gaussians", "Gaussians", "", 0),
    ("skin.gaussians", "  of them skin", "", 0),
];
/// More nodes than this are not told one by one.
const ROWS: usize = 60;
/// With none of the figures above, this many of those there are.
const OTHERS: usize = 12;

/// Rows of cells as aligned columns; the first column to the left, the others as `right` says.
pub fn table(rows: &[Vec<String>], right: &[bool]) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let cell = |row: &'_ Vec<String>, column: usize| row.get(column).map_or(0, |text| text.chars().count());
    let widths: Vec<usize> =
        (0..columns).map(|column| rows.iter().map(|row| cell(row, column)).max().unwrap_or(0)).collect();
    let mut text = String::new();
    for row in rows {
        let mut line = String::new();
        for (column, content) in row.iter().enumerate() {
            let pad = " ".repeat(widths[column] - content.chars().count());
            let (before, after) =
                if right.get(column) == Some(&true) { (pad.as_str(), "") } else { ("", pad.as_str()) };
            let _ = write!(line, "  {before}{content}{after}");
        }
        let _ = writeln!(text, "{}", line.trim_end());
    }
    text
}

/// A plan as a table: node, kind, what feeds it.
pub fn plan_table(plan: &Plan) -> String {
    let row = |node: &heartian_graph::PlanNode| {
        let wires = node.inputs.iter().flat_map(|input| &input.from);
        let from: Vec<String> = wires.map(|(from, port)| format!("{}.{}", plan.nodes[*from].id, port.name)).collect();
        let from = if from.is_empty() { String::new() } else { format!("← {}", from.join(", ")) };
        vec![node.id.to_string(), node.kind.kind.to_owned(), from]
    };
    table(&plan.nodes.iter().map(row).collect::<Vec<_>>(), &[])
}

/// The end of a run.
pub fn run(name: &str, reports: &[NodeReport], metrics: &BTreeMap<String, f64>, elapsed: Duration) -> String {
    let mut rows = vec![["node", "kind", "status", "seconds"].map(str::to_owned).to_vec()];
    // Of many nodes only those are told that did something.
    let told = |report: &&NodeReport| reports.len() <= ROWS || matches!(report.status, Status::Ran | Status::Failed);
    rows.extend(reports.iter().filter(told).take(ROWS).map(|report| {
        let status = report.status.word().to_owned();
        vec![report.id.to_string(), report.kind.to_owned(), status, format!("{:.2}", report.seconds)]
    }));
    let told = rows.len() - 1;
    let count = |status: Status| reports.iter().filter(|report| report.status == status).count();
    let counts =
        [Status::Hit, Status::Ran, Status::Failed, Status::Skipped].map(|status| (count(status), status.word()));
    let counts: Vec<String> =
        counts.iter().filter(|(count, _)| *count > 0).map(|(count, word)| format!("{count} {word}")).collect();
    let mut text = if told == 0 { String::new() } else { table(&rows, &[false, false, false, true]) };
    if told < reports.len() {
        let _ = writeln!(text, "  and {} more", reports.len() - told);
    }
    let _ = writeln!(text, "\n{name}: {} in {:.2} s", counts.join(", "), elapsed.as_secs_f64());
    let figures = figures(metrics);
    if !figures.is_empty() {
        let _ = write!(text, "\n{}\n", table(&figures, &[false, true]).trim_end_matches('\n'));
    }
    text.push('\n');
    text
}

fn figures(metrics: &BTreeMap<String, f64>) -> Vec<Vec<String>> {
    let shown = |value: f64, unit: &str, decimals: usize| {
        let number = if value.is_finite() { format!("{value:.decimals$}") } else { "not measured".to_owned() };
        format!("{number} {unit}").trim_end().to_owned()
    };
    let plain = PLAIN.iter().filter_map(|(key, words, unit, decimals)| {
        metrics.get(*key).map(|value| vec![(*words).to_owned(), shown(*value, unit, *decimals)])
    });
    let plain: Vec<Vec<String>> = plain.collect();
    if !plain.is_empty() {
        return plain;
    }
    metrics.iter().take(OTHERS).map(|(key, value)| vec![key.clone(), shown(*value, "", 3)]).collect()
}
