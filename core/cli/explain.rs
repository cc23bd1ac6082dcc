//! `heartian explain`: why each node is a hit or a miss.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;
use std::process::ExitCode;

use heartian_graph::{
    Change, Digest, Explainer, Explanation, Graph, History, PastNode, Plan, Run, Standing, Status, Subject,
    subjects_of_plan, subjects_of_run,
};
use miette::{IntoDiagnostic, Result, WrapErr, miette};
use serde::Deserialize;
use serde_json::Value;

use crate::arguments::ExplainArguments;
use crate::clock;
use crate::plugins;
use crate::session::open_cache;

/// The parts of `run.json` that say what each node did.
#[derive(Deserialize)]
pub struct PastRun {
    /// In the order of the plan.
    pub nodes: Vec<PastLine>,
}

/// One node of `run.json`.
#[derive(Deserialize)]
pub struct PastLine {
    /// Its id.
    pub id: String,
    kind: String,
    /// How its turn ended.
    pub status: Status,
    key: Option<Digest>,
    outputs: BTreeMap<String, Digest>,
}

/// Explains a graph that has not run, or a run that is over.
pub fn explain(arguments: &ExplainArguments) -> Result<ExitCode> {
    let cache = open_cache(arguments.cache.as_deref())?;
    let history = History::read(&cache);
    let (subjects, plan) = if is_run(&arguments.what) {
        let nodes = read_run(&arguments.what)?.nodes.into_iter().map(|line| PastNode {
            id: line.id,
            kind: line.kind,
            status: line.status,
            key: line.key,
            outputs: line.outputs,
        });
        (subjects_of_run(&nodes.collect::<Vec<_>>(), &history), None)
    } else {
        let mut graph = Graph::load(&arguments.what)?;
        arguments.sets.iter().for_each(|set| graph.set(set));
        let plan = graph.plan(plugins::registry()?, &[])?;
        let previews = Run::prepare(&plan, &cache).preview();
        (subjects_of_plan(&plan, &previews), Some(plan))
    };
    let wanted = chosen(&subjects, arguments.node.as_deref())?;
    let explainer = Explainer::new(&history, &subjects);
    let found: Vec<Explanation> = wanted.into_iter().map(|index| explainer.explain(index)).collect();
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&found).into_diagnostic()?);
    } else {
        found.iter().for_each(|explanation| print!("{}", page(explanation, plan.as_ref())));
    }
    Ok(ExitCode::SUCCESS)
}

fn is_run(what: &Path) -> bool {
    what.is_dir() || what.file_name().is_some_and(|name| name == "run.json")
}

/// Reads what a run recorded; `run` is its folder or its `run.json`.
pub fn read_run(run: &Path) -> Result<PastRun> {
    let path = if run.is_dir() { run.join("run.json") } else { run.to_owned() };
    let text = std::fs::read_to_string(&path).map_err(|error| {
        miette!(help = "give a folder that `heartian run` wrote", "cannot read `{}`: {error}", path.display())
    })?;
    serde_json::from_str(&text)
        .into_diagnostic()
        .wrap_err_with(|| format!("`{}` is no record of a run", path.display()))
}

fn chosen(subjects: &[Subject], node: Option<&str>) -> Result<Vec<usize>> {
    let Some(node) = node else { return Ok((0..subjects.len()).collect()) };
    let found = subjects.iter().position(|subject| subject.id == node);
    found.map(|index| vec![index]).ok_or_else(|| {
        let ids: Vec<&str> = subjects.iter().map(|subject| subject.id.as_str()).take(40).collect();
        miette!(help = format!("nodes: {}", ids.join(", ")), "there is no node `{node}`")
    })
}

fn page(explanation: &Explanation, plan: Option<&Plan>) -> String {
    let Explanation { node, kind, standing, .. } = explanation;
    let past = plan.is_none();
    let made = explanation.made.map(|made| format!("made {}", clock::plain(made)));
    let took = explanation.seconds.map(|seconds| format!("took {}", clock::span(seconds)));
    let record = [made, took].into_iter().flatten().collect::<Vec<_>>().join(", ");
    let line = match standing {
        Standing::Hit => format!("in the cache; {record}"),
        Standing::Miss if past && explanation.made.is_none() => "ran and failed, or its record is gone".to_owned(),
        Standing::Miss if past => format!("ran; {record}"),
        Standing::Miss if explanation.made.is_some() => {
            "will run: nothing of its key changed, but its artifacts are missing or damaged".to_owned()
        }
        Standing::Miss => "will run".to_owned(),
        Standing::Waits => {
            format!(
                "waits for {}; is a hit after all if that writes the bytes it wrote before",
                quoted(&explanation.waits_for)
            )
        }
        Standing::Unknown => "was not reached".to_owned(),
    };
    let mut text = format!("{node} ({kind}): {line}\n");
    if *standing == Standing::Miss && explanation.causes.is_empty() {
        text.push_str("  the cache remembers no other of this kind\n");
    }
    for (depth, cause) in explanation.causes.iter().enumerate() {
        let indent = "  ".repeat(depth + 1);
        if depth > 0 {
            let _ = writeln!(text, "{indent}because of `{}` ({}):", cause.node, cause.kind);
        }
        for change in &cause.changes {
            let at = place(plan, &cause.node, change).map_or(String::new(), |place| format!("  at {place}"));
            let (from, to) = (shown(change.from.as_ref()), shown(change.to.as_ref()));
            let _ = writeln!(text, "{indent}{}: {from} → {to}{at}", change.field);
        }
        let _ =
            writeln!(text, "{indent}(against {}, made {})", &cause.earlier.to_string()[..8], clock::plain(cause.made));
    }
    text
}

fn quoted(ids: &[String]) -> String {
    ids.iter().map(|id| format!("`{id}`")).collect::<Vec<_>>().join(", ")
}

/// Where the graph gives the parameter that changed.
fn place(plan: Option<&Plan>, node: &str, change: &Change) -> Option<String> {
    let parameter = change.parameter()?;
    let node = plan?.nodes.iter().find(|known| &*known.id == node)?;
    Some(node.place(Some(parameter)).to_string())
}

fn shown(value: Option<&Value>) -> String {
    match value {
        None => "nothing".to_owned(),
        Some(Value::String(text)) if text.len() == 64 => format!("{}…", &text[..8]),
        Some(value) => {
            let text = value.to_string();
            if text.chars().count() > 80 { text.chars().take(79).chain(['…']).collect() } else { text }
        }
    }
}
