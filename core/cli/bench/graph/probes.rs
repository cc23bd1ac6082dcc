//! What happens when things go wrong or at once, told by which nodes ran again.

use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::Duration;

use miette::{IntoDiagnostic, Result, miette};
use serde_json::{Value, json};

use super::shapes::{self, Shape};
use super::{BYTES, Bench, Findings};

/// Runs every probe.
pub fn all(bench: &Bench, kills: u32, findings: &mut Findings) -> Result<()> {
    same_bytes(bench, findings)?;
    flipped_byte(bench, findings)?;
    two_at_once(bench, findings)?;
    if kills > 0 {
        killed(bench, kills, findings)?;
    }
    Ok(())
}

/// What a run wrote of itself: status by node, and digests of the outputs.
struct Told {
    ran: Vec<String>,
    outputs: Vec<(String, String)>,
}

fn told(bench: &Bench, graph: &str) -> Result<Told> {
    let path = bench.path(graph).with_extension("out").join("run.json");
    let value: Value = serde_json::from_slice(&std::fs::read(path).into_diagnostic()?).into_diagnostic()?;
    let nodes = value["nodes"].as_array().ok_or_else(|| miette!("run.json has no nodes"))?;
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let ran = nodes.iter().filter(|node| node["status"] != "hit").map(|node| text(&node["id"])).collect();
    let outputs = nodes.iter().map(|node| (text(&node["id"]), text(&node["outputs"]["out"]))).collect();
    Ok(Told { ran, outputs })
}

fn run(bench: &Bench, graph: &str, cache: &str) -> Result<Told> {
    bench.time(&mut bench.run(graph, cache))?;
    told(bench, graph)
}

fn who(ran: &[String]) -> String {
    if ran.is_empty() { "none".to_owned() } else { ran.join(" ") }
}

/// With no bytes at all, another seed writes the same ones.
fn same_bytes(bench: &Bench, findings: &mut Findings) -> Result<()> {
    let text = shapes::blocks(1, Shape::Deep, BYTES);
    let empty = |seed| text.replace("bytes: 1048576, seed: 3)", &format!("bytes: 0, seed: {seed})"));
    bench.write("same.ron", &empty(3))?;
    run(bench, "same.ron", "same")?;
    bench.write("same.ron", &empty(99))?;
    let ran = run(bench, "same.ron", "same")?.ran;
    findings.add("c changes, writes the same bytes: runs", ("same_bytes_ran", json!(ran)), who(&ran), "only c");
    Ok(())
}

fn flipped_byte(bench: &Bench, findings: &mut Findings) -> Result<()> {
    let outputs = run(bench, "ten.ron", "ten")?.outputs;
    let digest = outputs.iter().find(|(id, _)| id == "d0").map(|(_, digest)| digest.as_str()).unwrap_or_default();
    let shard = digest.get(..2).ok_or_else(|| miette!("run.json names no output of d"))?;
    let path: PathBuf = bench.path("ten").join("artifacts").join(shard).join(format!("{digest}.safetensors"));
    let modified = std::fs::metadata(&path).and_then(|metadata| metadata.modified()).into_diagnostic()?;
    let mut bytes = std::fs::read(&path).into_diagnostic()?;
    if let Some(last) = bytes.last_mut() {
        *last ^= 1;
    }
    std::fs::write(&path, bytes).into_diagnostic()?;
    let file = std::fs::File::options().write(true).open(&path).into_diagnostic()?;
    file.set_modified(modified).into_diagnostic()?;
    let after = run(bench, "ten.ron", "ten")?;
    let right = after.outputs == outputs;
    let value = json!({"ran": after.ran, "same_outputs": right});
    let figure = format!("{}{}", who(&after.ran), if right { "" } else { ", OTHER OUTPUTS" });
    findings.add("byte of d flipped, time kept: runs", ("flipped_byte", value), figure, "only d");
    Ok(())
}

fn quiet(mut command: Command) -> Command {
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    command
}

fn two_at_once(bench: &Bench, findings: &mut Findings) -> Result<()> {
    let graphs = ["one.ron", "two.ron"];
    let mut children = Vec::new();
    for graph in graphs {
        bench.write(graph, &shapes::blocks(4, Shape::Deep, BYTES))?;
    }
    for graph in graphs {
        children.push(quiet(bench.run(graph, "both")).spawn().into_diagnostic()?);
    }
    for child in &mut children {
        child.wait().into_diagnostic()?;
    }
    let ran = [told(bench, graphs[0])?.ran.len(), told(bench, graphs[1])?.ran.len()];
    let figure = format!("{} + {} = {} of 40", ran[0], ran[1], ran[0] + ran[1]);
    findings.add("two runs on one cold cache: nodes computed", ("two_runs", json!(ran)), figure, "each once: 40");
    Ok(())
}

fn killed(bench: &Bench, kills: u32, findings: &mut Findings) -> Result<()> {
    bench.write("kill.ron", &shapes::blocks(4, Shape::Deep, BYTES))?;
    let cold = bench.time(&mut bench.run("kill.ron", "kill"))?.wall_s;
    let expected = told(bench, "kill.ron")?.outputs;
    let mut right = 0;
    let mut redone = 0;
    for kill in 0..kills {
        let cache = format!("kill-{kill}");
        let mut child = quiet(bench.run("kill.ron", &cache)).spawn().into_diagnostic()?;
        // Evenly over the run, in an order without pattern.
        let share = f64::from(kill.wrapping_mul(2_654_435_769)) / f64::from(u32::MAX);
        std::thread::sleep(Duration::from_secs_f64(cold * share));
        // One that has ended already cannot be killed.
        let _ = child.kill();
        child.wait().into_diagnostic()?;
        let next = run(bench, "kill.ron", &cache)?;
        right += u32::from(next.outputs == expected);
        redone += next.ran.len();
    }
    let each = redone as f64 / f64::from(kills);
    let figure = format!("{right} of {kills} next runs right, {each:.1} of 40 nodes run again");
    let value = json!({"kills": kills, "right": right, "mean_nodes_run_again": each});
    findings.add("kill -9 at random moments", ("killed", value), figure, "all");
    Ok(())
}
