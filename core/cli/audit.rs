//! `heartian audit`: cached nodes run again, and every byte compared.

use std::process::ExitCode;

use heartian_graph::{AuditReport, Run, Verdict};
use miette::{IntoDiagnostic, Result};
use serde_json::json;

use crate::arguments::AuditArguments;
use crate::run::load;
use crate::session::{INTERRUPTED, Session};
use crate::summary::table;

/// Recomputes a sample of a graph's cached nodes and reports those that are not bit-identical.
pub fn run(arguments: &AuditArguments) -> Result<ExitCode> {
    let (_, plan) = load(&arguments.graph)?;
    let session = Session::open(&arguments.host)?;
    let run = Run::prepare(&plan, &session.cache);
    let reports = run.audit(arguments.sample, arguments.choice, &session.options);
    session.terminal.finish();
    if arguments.json {
        let lines = reports.iter().map(
            |report| json!({"node": &*report.id, "kind": report.kind, "key": report.key, "verdict": verdict(report)}),
        );
        println!("{}", serde_json::to_string_pretty(&lines.collect::<Vec<_>>()).into_diagnostic()?);
    } else {
        let row = |report: &AuditReport| vec![report.id.to_string(), report.kind.to_owned(), verdict(report)];
        print!("{}", table(&reports.iter().map(row).collect::<Vec<_>>(), &[]));
        println!("\n{} of {} nodes recomputed", reports.len(), plan.nodes.len());
        if reports.is_empty() {
            println!("none is cached; run the graph first");
        }
    }
    if session.cancelled() {
        return Ok(ExitCode::from(INTERRUPTED));
    }
    let right = reports.iter().all(|report| matches!(report.verdict, Verdict::Same));
    Ok(if right { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn verdict(report: &AuditReport) -> String {
    match &report.verdict {
        Verdict::Same => "the same bytes".to_owned(),
        Verdict::Differs(ports) => format!("OTHER BYTES on {}", ports.join(", ")),
        Verdict::Failed(error) => format!("FAILED: {}", error.message),
    }
}
