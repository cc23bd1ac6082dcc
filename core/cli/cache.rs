//! `heartian cache`: what the cache holds, how much room it takes, whether it is whole, and making room.

use std::process::ExitCode;
use std::time::SystemTime;

use heartian_graph::{Cache, CacheEntry, GcOptions};
use miette::{IntoDiagnostic, Result};
use serde_json::json;

use crate::arguments::{CacheAction, CacheArguments};
use crate::session::open_cache;
use crate::sizes;
use crate::summary::table;

/// Digits of a digest that tell it from all others in practice.
const SHORT: usize = 12;

/// Lists, counts, verifies or collects.
pub fn act(arguments: &CacheArguments) -> Result<ExitCode> {
    let cache = open_cache(arguments.cache.as_deref())?;
    let json = arguments.json;
    match &arguments.action {
        CacheAction::Ls => list(&cache, json),
        CacheAction::Du => usage(&cache, json),
        CacheAction::Verify => verify(&cache, json),
        CacheAction::Gc { keep_runs, max_size, dry_run } => {
            collect(&cache, GcOptions { keep_runs: *keep_runs, max_bytes: *max_size, dry_run: *dry_run }, json)
        }
    }
}

fn print_json(value: &impl serde::Serialize) -> Result<ExitCode> {
    println!("{}", serde_json::to_string_pretty(value).into_diagnostic()?);
    Ok(ExitCode::SUCCESS)
}

fn list(cache: &Cache, json: bool) -> Result<ExitCode> {
    let entries = cache.entries();
    if json {
        let lines = entries.iter().map(|entry| {
            let used = entry.used.duration_since(SystemTime::UNIX_EPOCH).map_or(0.0, |time| time.as_secs_f64());
            json!({
                "key": entry.key, "kind": entry.kind, "bytes": entry.size(), "seconds": entry.record.seconds,
                "used_unix_seconds": used, "outputs": entry.record.outputs,
            })
        });
        return print_json(&lines.collect::<Vec<_>>());
    }
    let mut rows = vec![["key", "kind", "outputs", "size", "made in", "last used"].map(str::to_owned).to_vec()];
    rows.extend(entries.iter().map(row));
    print!("{}", table(&rows, &[false, false, false, true, true, true]));
    println!("\n{} records in {}", entries.len(), cache.root().display());
    Ok(ExitCode::SUCCESS)
}

fn row(entry: &CacheEntry) -> Vec<String> {
    let ports: Vec<&str> = entry.record.outputs.keys().map(String::as_str).collect();
    vec![
        entry.key.to_string()[..SHORT].to_owned(),
        entry.kind.clone(),
        ports.join(", "),
        sizes::show(entry.size()),
        format!("{:.2} s", entry.record.seconds),
        age(entry.used),
    ]
}

fn age(time: SystemTime) -> String {
    let seconds = SystemTime::now().duration_since(time).map_or(0, |age| age.as_secs());
    match seconds {
        0..60 => format!("{seconds} s ago"),
        60..3600 => format!("{} min ago", seconds / 60),
        3600..86_400 => format!("{} h ago", seconds / 3600),
        _ => format!("{} d ago", seconds / 86_400),
    }
}

fn usage(cache: &Cache, json: bool) -> Result<ExitCode> {
    let usage = cache.usage();
    if json {
        let mut value = serde_json::to_value(&usage).into_diagnostic()?;
        value["total"] = usage.total().into();
        return print_json(&value);
    }
    let mut rows = vec![["kind", "records", "size"].map(str::to_owned).to_vec()];
    let mut kinds: Vec<_> = usage.kinds.iter().collect();
    kinds.sort_by_key(|(_, (_, bytes))| std::cmp::Reverse(*bytes));
    rows.extend(
        kinds.into_iter().map(|(kind, (count, bytes))| vec![kind.clone(), count.to_string(), sizes::show(*bytes)]),
    );
    for (name, bytes) in [
        ("artifacts that no record names", usage.unused),
        ("records", usage.records),
        ("states of unfinished nodes", usage.checkpoints),
        ("lists of runs, digests of sources, leftovers", usage.other),
        ("total", usage.total()),
    ] {
        rows.push(vec![name.to_owned(), String::new(), sizes::show(bytes)]);
    }
    print!("{}", table(&rows, &[false, true, true]));
    println!("\n{}", cache.root().display());
    Ok(ExitCode::SUCCESS)
}

fn verify(cache: &Cache, json: bool) -> Result<ExitCode> {
    let report = cache.verify();
    let damaged = report.damaged_artifacts.len() + report.damaged_records.len();
    if json {
        print_json(&report)?;
    } else {
        let bytes = sizes::show(report.bytes);
        println!("{} artifacts ({bytes}) and {} records read", report.artifacts, report.records);
        for (what, digests) in [("artifact", &report.damaged_artifacts), ("record", &report.damaged_records)] {
            digests.iter().for_each(|digest| println!("damaged {what}, removed: {digest}"));
        }
        if report.incomplete_records > 0 {
            println!("{} records lack an artifact; their nodes run again when needed", report.incomplete_records);
        }
        println!("{}", if damaged == 0 { "nothing is damaged" } else { "the next run makes again what it needs" });
    }
    Ok(if damaged == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn collect(cache: &Cache, options: GcOptions, json: bool) -> Result<ExitCode> {
    let report = cache.gc(&options);
    if json {
        return print_json(&report);
    }
    let verb = if options.dry_run { "would drop" } else { "dropped" };
    let (bytes, kept) = (sizes::show(report.dropped_bytes), sizes::show(report.kept_bytes));
    println!("{verb} {} records and {} artifacts, {bytes}", report.dropped_records, report.dropped_artifacts);
    println!("to make them again takes about {:.1} s", report.dropped_seconds);
    println!("kept {} records, {kept}", report.kept_records);
    Ok(ExitCode::SUCCESS)
}
