//! The examples that come with the house: they load, run, hit, and pass types that the host does not know.

use std::process::Command;

use super::libraries::{Place, library, said};
use crate::results::files_below;

/// a→b→c→{d,e,f}→g.
fn blobs(seed: u64) -> String {
    let node = |id: &str, seed: u64, inputs: &str| {
        format!("\"{id}\": (kind: \"Blob\", params: (bytes: 100003, seed: {seed}), inputs: {{\"in\": [{inputs}]}}),")
    };
    let nodes = [
        node("a", seed, ""),
        node("b", 1, "\"a.out\""),
        node("c", 1, "\"b.out\""),
        node("d", 2, "\"c.out\""),
        node("e", 3, "\"c.out\""),
        node("f", 4, "\"c.out\""),
        node("g", 1, "\"d.out\", \"e.out\", \"f.out\""),
    ];
    format!("Graph(name: \"blobs\", nodes: {{{}}})", nodes.concat())
}

#[test]
fn blobs_run_in_a_process_of_their_own_and_inside_with_the_same_bytes() {
    let place = Place::new();
    let plugin = library("heartian-blob");
    let plugin = plugin.to_str().unwrap();
    let digests = || {
        let bytes = std::fs::read(place.path("out/run.json")).unwrap();
        let record: serde_json::Value = serde_json::from_slice(&bytes).unwrap();
        record.to_string().split('"').filter(|word| word.len() == 64).map(str::to_owned).collect::<Vec<_>>()
    };
    let run = |cache: &str, seed: u64| {
        let graph = place.write("blobs.ron", blobs(seed));
        let arguments = ["run", graph.to_str().unwrap(), "--plugin", plugin, "--out", "out", "--cache", cache];
        let said = place.heartian(&arguments);
        assert_eq!(said.code, Some(0), "{}", said.stderr);
        place.statuses()
    };
    assert_eq!(run("outside", 1), "a:ran b:ran c:ran d:ran e:ran f:ran g:ran");
    let outside = digests();
    assert!(outside.len() >= 7, "{outside:?}");
    assert_eq!(run("outside", 1), "a:hit b:hit c:hit d:hit e:hit f:hit g:hit");
    assert_eq!(run("outside", 2), "a:ran b:ran c:ran d:ran e:ran f:ran g:ran");
    assert_ne!(digests(), outside);
    assert_eq!(place.heartian(&["plugins", "trust", plugin]).code, Some(0));
    assert_eq!(run("outside", 1), "a:hit b:hit c:hit d:hit e:hit f:hit g:hit");
    assert_eq!(run("inside", 1), "a:ran b:ran c:ran d:ran e:ran f:ran g:ran");
    assert_eq!(digests(), outside);
}

/// A library with other bytes is other code: nothing made by the first is used for the second.
#[test]
fn another_build_of_a_library_is_another_key() {
    let place = Place::new();
    let graph = place.write("graph.ron", "Graph(name: \"one\", nodes: {\"a\": (kind: \"Fine\")})");
    for (fault, status) in [("none", "a:ran"), ("none", "a:hit"), ("other", "a:ran"), ("none", "a:hit")] {
        let plugin = place.faulty(fault);
        let said =
            place.heartian(&["run", graph.to_str().unwrap(), "--plugin", plugin.to_str().unwrap(), "--out", "out"]);
        assert_eq!((said.code, place.statuses()), (Some(0), status.to_owned()), "{}", said.stderr);
    }
}

#[test]
fn a_cached_run_starts_no_process() {
    let place = Place::new();
    let plugin = place.faulty("none");
    let graph = place.write("graph.ron", "Graph(name: \"one\", nodes: {\"a\": (kind: \"Fine\")})");
    let arguments = ["run", graph.to_str().unwrap(), "--plugin", plugin.to_str().unwrap(), "--out", "out"];
    assert_eq!(place.heartian(&arguments).code, Some(0));
    // Young files are digested anew until their time stamp can be relied on; the description is remembered all the same.
    let remembered = || std::fs::read_dir(place.path("remembered/heartian/plugins")).unwrap().count();
    assert_eq!(remembered(), 1);
    // Without a process to be had, a run that needs none succeeds, and one that needs one says so.
    let starved = |arguments: &[&str]| {
        let shell = format!("ulimit -u 1; exec {} \"$@\"", env!("CARGO_BIN_EXE_heartian"));
        let mut command = Command::new("sh");
        let own = place.command();
        command.current_dir(place.folder.path()).args(["-c", &shell, "sh"]).args(arguments);
        command.envs(own.get_envs().filter_map(|(name, value)| Some((name, value?))));
        said(&command.output().unwrap())
    };
    let cached = starved(&arguments);
    if cached.code == Some(0) {
        assert_eq!(place.statuses(), "a:hit");
    } else {
        // Threads count as processes on some systems; then the starved program cannot show anything.
        println!("skipped: this system lets no program run with so few processes: {}", cached.stderr);
    }
}

#[test]
fn the_search_path_is_searched() {
    let place = Place::new();
    assert!(place.heartian(&["plugins", "ls"]).stdout.contains("No plugins"));
    let data = place.path("data/heartian/plugins");
    std::fs::create_dir_all(&data).unwrap();
    std::fs::copy(library("heartian-blob"), data.join(library("heartian-blob").file_name().unwrap())).unwrap();
    std::fs::write(data.join("README.txt"), "not a library").unwrap();
    assert!(place.heartian(&["nodes", "Blob"]).stdout.contains("pseudo-random"));
    let faulty = place.faulty("none");
    let list = |command: &mut Command| said(&command.args(["plugins", "ls"]).output().unwrap());
    let both = list(place.command().env("HEARTIAN_PLUGIN_PATH", &faulty));
    assert!(
        both.code == Some(0) && both.stdout.contains("Fine, Faulty") && both.stdout.contains("Blob"),
        "{}",
        both.stdout
    );
    let folder = list(place.command().env("HEARTIAN_PLUGIN_PATH", place.folder.path()));
    assert!(folder.stdout.contains("Fine, Faulty"), "{}", folder.stdout);
    place.faulty("null");
    let broken = list(place.command().env("HEARTIAN_PLUGIN_PATH", place.folder.path()));
    assert!(broken.code == Some(1) && broken.stdout.contains("cannot be used"), "{}", broken.stdout);
}

/// A plugin in C, of a type of its own, reads what a plugin in Rust wrote.
#[test]
fn a_plugin_in_plain_c_reads_what_one_in_rust_wrote() {
    let place = Place::new();
    let root = env!("CARGO_MANIFEST_DIR");
    let library_file = place.path("libhistogram.so");
    let mut compiler = Command::new(std::env::var_os("CC").unwrap_or("cc".into()));
    compiler.args(["-std=c99", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "-O2", "-I"]);
    compiler.arg(format!("{root}/plugins/sdk/include")).arg(format!("{root}/plugins/c-histogram/histogram.c"));
    let built = match compiler.arg("-o").arg(&library_file).output() {
        Ok(built) => built,
        Err(error) => return println!("skipped: no C compiler: {error}"),
    };
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    let graph = place.write(
        "histogram.ron",
        r#"Graph(name: "histogram", nodes: {
            "blob": (kind: "Blob", params: (bytes: 5001)),
            "counts": (kind: "ByteHistogram", inputs: {"in": ["blob.out", "blob.out"]}),
        })"#,
    );
    let (rust, c) = (library("heartian-blob"), library_file.to_str().unwrap());
    let plugins = ["--plugin", rust.to_str().unwrap(), "--plugin", c, "--out", "out"];
    let run = |more: &[&str]| place.heartian(&[&["run", graph.to_str().unwrap()], &plugins[..], more].concat());
    let done = run(&[]);
    assert_eq!((done.code, place.statuses().as_str()), (Some(0), "blob:ran counts:ran"), "{}", done.stderr);
    run(&[]);
    assert_eq!(place.statuses(), "blob:hit counts:hit");
    // The counts lie in the cache as the plugin wrote them: 256 numbers that sum to the bytes counted.
    let counted = |bytes: Vec<u8>| bytes.as_chunks::<8>().0.iter().map(|word| u64::from_le_bytes(*word)).sum::<u64>();
    let blobs = files_below(&place.path(".heartian/cache/artifacts"));
    let sums: Vec<u64> = blobs
        .iter()
        .map(|path| std::fs::read(path).unwrap())
        .filter(|bytes| bytes.len() == 2048)
        .map(counted)
        .collect();
    assert_eq!(sums, [2 * 5001]);
    let refused = place.heartian(&["check", graph.to_str().unwrap(), "--plugin", c]);
    assert!(refused.code == Some(1) && refused.stderr.contains("no kind of node `Blob`"), "{}", refused.stderr);
}

/// The house's own types through a plugin: a clip in, traces out, read by a built-in node.
#[test]
fn a_measuring_plugin_feeds_a_built_in_node() {
    let place = Place::new();
    let graph = format!("{}/plugins/green-trace/green_trace.ron", env!("CARGO_MANIFEST_DIR"));
    let plugin = library("heartian-green-trace");
    let short = ["--set", "frames.seconds=6", "--set", "frames.size=48", "--out", "out"];
    let run = |more: &[&str]| {
        place.heartian(&[&["run", &graph, "--plugin", plugin.to_str().unwrap()], &short[..], more].concat())
    };
    let done = run(&[]);
    assert_eq!(done.code, Some(0), "{}", done.stderr);
    assert_eq!(place.statuses(), "frames:ran green:ran report:ran");
    let drawn = files_below(&place.path("out"));
    assert!(drawn.iter().any(|path| path.ends_with("waveforms.png")), "{drawn:?}");
    let failed = run(&["--set", "green.least_alpha=0"]);
    assert!(failed.code == Some(1) && failed.stderr.contains("from 1 to 255"), "{}", failed.stderr);
}
