//! Hits, misses, early cut-off, healing: asserted node by node.

use heartian_graph::{Cache, Graph, NodeKind, Registry, RunOptions, Status};

use crate::nodes::{Add, Bench, Devised, cache_files, listened, plan};

const CHAIN: &str = r#"Graph(name: "chain", nodes: {
    "a": (kind: "Constant", params: (values: [1.25, 2.5])),
    "b": (kind: "Add", params: (amount: 0.25, rounding: Down), inputs: {"numbers": "a.numbers"}),
    "c": (kind: "Add", params: (amount: 10), inputs: {"numbers": "b.numbers"}),
    "d": (kind: "Sum", inputs: {"terms": ["a.numbers", "c.numbers"]}),
})"#;

#[test]
fn a_second_run_is_all_hits_and_gives_the_same_numbers() {
    let bench = Bench::new();
    let first = bench.run(CHAIN);
    assert_eq!(first.statuses(), "a:ran b:ran c:ran d:ran");
    assert_eq!(bench.numbers(&first, "d"), [12.25, 14.5]);
    let second = bench.run(CHAIN);
    assert_eq!(second.statuses(), "a:hit b:hit c:hit d:hit");
    assert_eq!(second.fingerprint, first.fingerprint);
    assert_eq!(bench.numbers(&second, "d"), [12.25, 14.5]);
}

#[test]
fn a_parameter_reruns_its_node_and_what_its_bytes_reach() {
    let bench = Bench::new();
    bench.run(CHAIN);
    let options = RunOptions::default();
    let changed = bench.run_with(CHAIN, &["c.amount=20"], &options);
    assert_eq!(changed.statuses(), "a:hit b:hit c:ran d:ran");
    // Rounding gives the same bytes, so the change stops at `b` for `c`; `d` reads `a` directly.
    let cut_off = bench.run_with(CHAIN, &["a.values=[1.5, 2.25]"], &options);
    assert_eq!(cut_off.statuses(), "a:ran b:ran c:hit d:ran");
    let unkeyed = bench.run_with(CHAIN, &["a.threads=8"], &options);
    assert_eq!(unkeyed.statuses(), "a:hit b:hit c:hit d:hit");
}

#[test]
fn names_and_order_are_not_in_the_key() {
    let bench = Bench::new();
    bench.run(CHAIN);
    let renamed = CHAIN.replace("\"a", "\"start").replace("\"chain\"", "\"other\"");
    assert_eq!(bench.run(&renamed).count(Status::Hit), 4);
    let written_out = CHAIN.replace("amount: 10", "spelling: \"plain\", rounding: Exact, amount: 10.0");
    assert_eq!(bench.run(&written_out).count(Status::Hit), 4);
    assert_eq!(bench.run(&CHAIN.replace("name:", "seed: 1, name:")).count(Status::Ran), 4);
    let swapped = CHAIN.replace("[\"a.numbers\", \"c.numbers\"]", "[\"c.numbers\", \"a.numbers\"]");
    assert_eq!(bench.run(&swapped).statuses(), "a:hit b:hit c:hit d:ran");
}

/// Results of two devices never share a record; whatever comes to the CPU shares the CPU's.
#[test]
fn what_the_machine_decides_about_the_bits_is_in_the_key_and_nothing_else_of_the_device() {
    let bench = Bench::new();
    let graph = r#"Graph(name: "devices", nodes: {
        "a": (kind: "Devised"),
        "b": (kind: "Add", inputs: {"numbers": "a.numbers"}),
    })"#;
    let registry = Registry::of([NodeKind::of::<Devised>(), NodeKind::of::<Add>()]);
    let run = |set: &[&str]| {
        let mut graph = Graph::parse("test.ron", graph).unwrap();
        set.iter().for_each(|argument| graph.set(argument));
        bench.run_plan(&graph.plan(&registry, &[]).unwrap(), &RunOptions::default()).statuses()
    };
    assert_eq!(run(&[]), "a:ran b:ran");
    // The same bytes come out, so what reads them is cut off.
    assert_eq!(run(&["a.device=\"one\""]), "a:ran b:hit");
    assert_eq!(run(&["a.device=\"another\""]), "a:ran b:hit");
    for again in ["a.device=\"one\"", "a.device=\"another\"", "a.device=\"auto\"", "a.device=None"] {
        assert_eq!(run(&[again]), "a:hit b:hit", "{again}");
    }
}

#[test]
fn only_what_a_target_needs_runs() {
    let bench = Bench::new();
    let graph = Graph::parse("test.ron", CHAIN).unwrap();
    let plan = graph.plan(&crate::nodes::registry(), &["b".to_owned()]).unwrap();
    assert_eq!(bench.run_plan(&plan, &RunOptions::default()).statuses(), "a:ran b:ran");
    assert_eq!(bench.run(CHAIN).statuses(), "a:hit b:hit c:ran d:ran");
}

#[test]
fn damaged_artifacts_are_found_and_recomputed() {
    let bench = Bench::new();
    let first = bench.run(CHAIN);
    for node in 0..4 {
        let path = bench.cache.blob_path(&first.reports[node].outputs["numbers"]);
        let mut bytes = std::fs::read(&path).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        std::fs::write(&path, bytes).unwrap();
    }
    // Same size, so the damage shows only when `d` runs and reads them.
    let changed = bench.run_with(CHAIN, &["c.amount=20"], &RunOptions::default());
    assert_eq!(changed.statuses(), "a:ran b:ran c:ran d:ran");
    assert_eq!(bench.numbers(&changed, "d"), [22.25, 24.5]);
    let all = cache_files(&bench);
    for (path, _) in all.iter().filter(|(path, _)| path.extension().is_some_and(|kind| kind == "safetensors")) {
        std::fs::write(path, b"short").unwrap();
    }
    assert_eq!(bench.run(CHAIN).count(Status::Ran), 4);
}

#[test]
fn damaged_records_are_misses() {
    let bench = Bench::new();
    bench.run(CHAIN);
    for path in cache_files(&bench).into_keys().filter(|path| path.extension().is_some_and(|kind| kind == "jsonl")) {
        std::fs::write(path, b"{\"outputs\": {").unwrap();
    }
    assert_eq!(bench.run(CHAIN).count(Status::Ran), 4);
    assert_eq!(bench.run(CHAIN).count(Status::Hit), 4);
}

/// A kill leaves a prefix of the files that a run writes, in order, and perhaps half a temporary one.
#[test]
fn any_subset_of_a_caches_files_is_a_usable_cache() {
    let bench = Bench::new();
    let first = bench.run(CHAIN);
    let files = cache_files(&bench);
    for pattern in 0u32..64 {
        let partial = Bench::new();
        std::fs::write(partial.cache.root().join("tmp/.tmpABC"), b"half a te").unwrap();
        for (index, (path, bytes)) in files.iter().enumerate() {
            if pattern.wrapping_mul(2_654_435_761).rotate_left(index as u32) & 1 == 0 {
                let to = partial.cache.root().join(path.strip_prefix(bench.cache.root()).unwrap());
                std::fs::create_dir_all(to.parent().unwrap()).unwrap();
                std::fs::write(to, bytes).unwrap();
            }
        }
        let done = partial.run(CHAIN);
        assert_eq!(partial.numbers(&done, "d"), bench.numbers(&first, "d"));
        assert_eq!(partial.run(CHAIN).count(Status::Hit), 4);
    }
}

#[test]
fn files_enter_by_content_and_not_by_path() {
    let bench = Bench::new();
    let (one, two) = (bench.path("one.bin"), bench.path("two.bin"));
    std::fs::write(&one, [1, 2]).unwrap();
    std::fs::write(&two, [1, 2]).unwrap();
    let text = |path: &std::path::Path| {
        format!("(nodes: {{\"r\": (kind: \"ReadFile\", params: (path: r\"{}\"))}})", path.display())
    };
    assert_eq!(bench.run(&text(&one)).statuses(), "r:ran");
    assert_eq!(bench.run(&text(&two)).statuses(), "r:hit");
    std::fs::write(&two, [1, 3]).unwrap();
    let changed = bench.run(&text(&two));
    assert_eq!(changed.statuses(), "r:ran");
    assert_eq!(bench.numbers(&changed, "r"), [1.0, 3.0]);
    assert_eq!(bench.run("(nodes: {\"r\": (kind: \"ReadFile\")})").statuses(), "r:ran");
}

#[test]
fn folders_are_digested_by_names_and_contents() {
    let bench = Bench::new();
    let folder = bench.path("frames");
    std::fs::create_dir_all(folder.join("sub")).unwrap();
    std::fs::write(folder.join("1.png"), b"a").unwrap();
    std::fs::write(folder.join("sub/2.png"), b"b").unwrap();
    let first = bench.cache.source_digest(&folder).unwrap();
    assert_eq!(bench.cache.source_digest(&folder).unwrap(), first);
    std::fs::rename(folder.join("1.png"), folder.join("3.png")).unwrap();
    let renamed = bench.cache.source_digest(&folder).unwrap();
    assert_ne!(renamed, first);
    std::fs::write(folder.join("3.png"), b"c").unwrap();
    assert_ne!(bench.cache.source_digest(&folder).unwrap(), renamed);
}

/// An old file's digest is remembered; a touched file is read again.
#[test]
fn remembered_digests_follow_the_file() {
    let bench = Bench::new();
    let path = bench.path("old.bin");
    std::fs::write(&path, b"first").unwrap();
    let file = std::fs::File::options().write(true).open(&path).unwrap();
    file.set_modified(std::time::SystemTime::now() - std::time::Duration::from_secs(3600)).unwrap();
    let before = cache_files(&bench).len();
    let first = bench.cache.source_digest(&path).unwrap();
    assert_eq!(cache_files(&bench).len(), before + 1, "the digest is remembered");
    std::fs::write(&path, b"other").unwrap();
    assert_ne!(bench.cache.source_digest(&path).unwrap(), first);
}

#[test]
fn optional_outputs_may_be_absent_and_say_so_where_they_are_needed() {
    let bench = Bench::new();
    let text = r#"(nodes: {
        "a": (kind: "Constant"),
        "m": (kind: "Maybe"),
        "s": (kind: "Sum", inputs: {"terms": ["a.numbers"], "extra": "m.numbers"}),
    })"#;
    let without = bench.run(text);
    assert_eq!(bench.numbers(&without, "s"), [1.0, 2.0]);
    assert_eq!(bench.run(text).count(Status::Hit), 3);
    let with = bench.run_with(text, &["m.give=true"], &RunOptions::default());
    assert_eq!(bench.numbers(&with, "s"), [6.0, 2.0]);
    let needed = bench.run(
        r#"(nodes: {
        "m": (kind: "Maybe"),
        "b": (kind: "Add", inputs: {"numbers": "m.numbers"}),
    })"#,
    );
    assert_eq!(needed.statuses(), "m:hit b:failed");
    assert!(needed.problems[0].one_line().contains("`m.numbers`, which was not produced"), "{:?}", needed.problems);
}

#[test]
fn hits_repeat_the_warnings() {
    let bench = Bench::new();
    for _ in 0..2 {
        let (listener, options) = listened();
        bench.run_with(CHAIN, &[], &options);
        let lines = listener.lines.lock().unwrap();
        assert_eq!(lines.iter().filter(|line| line.contains("have no label")).count(), 1, "{lines:?}");
    }
}

#[test]
fn two_runs_may_share_a_cache() {
    let bench = Bench::new();
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                let cache = Cache::open(bench.cache.root()).unwrap();
                let plan = plan(&Graph::parse("test.ron", CHAIN).unwrap());
                let reports = heartian_graph::Run::prepare(&plan, &cache).execute(&RunOptions::default());
                assert!(reports.iter().all(|report| matches!(report.status, Status::Hit | Status::Ran)));
            });
        }
    });
    assert_eq!(bench.run(CHAIN).count(Status::Hit), 4);
}
