//! `heartian graph`: a graph as a picture, coloured by the cache or by a run.

use std::collections::HashMap;
use std::process::ExitCode;

use heartian_graph::{Picture, Run, Standing, Status, Tint, subjects_of_plan};
use miette::{IntoDiagnostic, Result, WrapErr};

use crate::arguments::DrawArguments;
use crate::explain::read_run;
use crate::run::load;
use crate::session::open_cache;

/// Draws a graph to a file or to standard output.
pub fn draw(arguments: &DrawArguments) -> Result<ExitCode> {
    let (_, plan) = load(&arguments.graph)?;
    let tints: Vec<Tint> = match &arguments.run {
        Some(run) => {
            let past = read_run(run)?;
            let statuses: HashMap<&str, Status> =
                past.nodes.iter().map(|line| (line.id.as_str(), line.status)).collect();
            plan.nodes.iter().map(|node| statuses.get(&*node.id).copied().map_or(Tint::Plain, of_status)).collect()
        }
        None => {
            let cache = open_cache(arguments.cache.as_deref())?;
            let subjects = subjects_of_plan(&plan, &Run::prepare(&plan, &cache).preview());
            subjects.iter().map(|subject| of_standing(subject.standing)).collect()
        }
    };
    let picture = Picture::of(&plan, &|at| tints[at]);
    let text = match arguments {
        DrawArguments { dot: true, .. } => picture.dot(),
        DrawArguments { mermaid: true, .. } => picture.mermaid(),
        _ => picture.svg(),
    };
    match &arguments.out {
        Some(path) => std::fs::write(path, text)
            .into_diagnostic()
            .wrap_err_with(|| format!("cannot write `{}`", path.display()))?,
        None => print!("{text}"),
    }
    Ok(ExitCode::SUCCESS)
}

fn of_status(status: Status) -> Tint {
    match status {
        Status::Hit => Tint::Hit,
        Status::Ran => Tint::Ran,
        Status::Failed => Tint::Failed,
        Status::Skipped => Tint::Skipped,
    }
}

fn of_standing(standing: Standing) -> Tint {
    match standing {
        Standing::Hit => Tint::Hit,
        Standing::Miss => Tint::Ran,
        Standing::Waits => Tint::Waits,
        Standing::Unknown => Tint::Plain,
    }
}
