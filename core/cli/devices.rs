//! `heartian devices`: what the rasteriser can run on, and what `--device auto` takes here.

use std::process::ExitCode;

use heartian_splat::{AdapterReport, adapters};
use miette::{IntoDiagnostic, Result};
use serde_json::json;

use crate::sizes;
use crate::summary::table;

/// Prints the machine's adapters.
pub fn print(as_json: bool) -> Result<ExitCode> {
    let found = adapters();
    let automatic = found.iter().find(|adapter| adapter.is_automatic);
    if as_json {
        let text = json!({ "adapters": found, "auto": automatic.map_or("cpu", |adapter| adapter.name.as_str()) });
        println!("{}", serde_json::to_string_pretty(&text).into_diagnostic()?);
        return Ok(ExitCode::SUCCESS);
    }
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let lanes = heartian_splat::simd_level();
    println!("cpu   {threads} threads, {lanes:?}");
    if !found.is_empty() {
        let head = ["gpu", "api", "kind", "largest buffer", "groups", "driver", ""].map(str::to_owned).to_vec();
        let rows: Vec<Vec<String>> = std::iter::once(head).chain(found.iter().map(row)).collect();
        print!("\n{}", table(&rows, &[false, false, false, true, true]));
    }
    println!("\n--device auto takes {}.", automatic.map_or("the CPU: there is no real GPU", |adapter| &adapter.name));
    if found.is_empty() && !cfg!(feature = "gpu") {
        println!("This program was built without GPU support.");
    }
    Ok(ExitCode::SUCCESS)
}

fn row(adapter: &AdapterReport) -> Vec<String> {
    let note = match adapter {
        AdapterReport { is_usable: false, .. } => "lacks what the kernels need",
        AdapterReport { is_automatic: true, .. } => "auto",
        AdapterReport { is_software: true, .. } => "runs on the CPU; only for --device gpu, and slowly",
        _ => "",
    };
    let AdapterReport { name, backend, kind, driver, largest_binding, workgroups, .. } = adapter;
    let (size, kind) = (sizes::show(*largest_binding), (*kind).to_owned());
    vec![name.clone(), backend.clone(), kind, size, workgroups.to_string(), driver.clone(), note.to_owned()]
}
