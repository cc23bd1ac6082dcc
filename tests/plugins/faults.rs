//! A library that misbehaves fails its node or is not loaded, says why and what to do, and harms nothing else.

use std::time::{Duration, Instant};

use super::libraries::Place;

/// Nodes of a library that does wrong in one of them.
const GRAPH: &str = r#"Graph(name: "faults", nodes: {
    "before": (kind: "Fine"),
    "bad": (kind: "Faulty", inputs: {"in": "before.out"}),
    "below": (kind: "Faulty", inputs: {"in": "bad.out"}),
    "beside": (kind: "Fine", params: (tag: 7)),
})"#;

/// What cannot be loaded or described is refused in these words, by a program that lives on.
#[test]
fn broken_libraries_are_refused_with_reasons() {
    let place = Place::new();
    let cases: [(&str, &[&str]); 25] = [
        ("null", &["declines"]),
        ("magic", &["magic number", "header of this Heartian"]),
        ("newer_minor", &["ABI 1.1", "ABI 1.0", "newer Heartian"]),
        ("newer_major", &["ABI 2.0", "ABI 1.0", "newer Heartian"]),
        ("older_major", &["ABI 0.0", "ABI 1.0", "build the plugin again"]),
        ("short", &["cut short"]),
        ("no_run", &["lacks `describe` or `run`"]),
        ("misaligned", &["misaligned"]),
        ("abort_at_load", &["signal 6 SIGABRT"]),
        ("describe_panics", &["signal 6 SIGABRT", "describing is hard"]),
        ("describe_fails", &["no licence", "buy one"]),
        ("describe_rubbish", &["not JSON"]),
        ("describe_binary", &["not JSON"]),
        ("describe_nothing", &["not JSON"]),
        ("describe_endless", &["longer than 4194304"]),
        ("describe_form", &["form 2", "reads form 1"]),
        ("describe_type", &["`fault` is neither", "org.example.thing"]),
        ("describe_house", &["form 99 of `clip`", "has form 1"]),
        ("describe_default", &["`level`", "its default is 1.5", "from 0 to 1 dB"]),
        ("describe_default_type", &["`level`", "its default is not of its type"]),
        ("describe_param", &["`quaternion` is none of bool"]),
        ("describe_twice", &["`Faulty`", "stands twice"]),
        ("describe_port", &["`out`", "stands twice"]),
        ("describe_builtin", &["`Renderer`", "the program itself"]),
        ("describe_no_output", &["needs an output"]),
    ];
    for (fault, words) in cases {
        let file = place.faulty(fault);
        let said = place.heartian(&["plugins", "check", file.to_str().unwrap()]);
        assert_eq!(said.code, Some(1), "{fault}: {}", said.stderr);
        for word in words {
            assert!(said.stderr.contains(word), "{fault} says: {}", said.stderr);
        }
        // Loaded beside a graph that does without it, it is a warning.
        let said = place.heartian(&["nodes", "FrameLoader", "--plugin", file.to_str().unwrap()]);
        assert_eq!(said.code, Some(0), "{fault}: {}", said.stderr);
        assert!(said.stderr.contains(words[0]), "{fault} warns: {}", said.stderr);
        std::fs::remove_file(file).unwrap();
    }
}

#[test]
fn files_that_are_no_plugins_are_refused() {
    let place = Place::new();
    let own = std::env::current_exe().unwrap();
    let own = own.to_str().unwrap();
    let text = place.write("notes.so", "Dear library,\n");
    let empty = place.write("empty.so", "");
    let cases: [(&str, &str); 5] = [
        (text.to_str().unwrap(), "cannot be loaded"),
        (empty.to_str().unwrap(), "cannot be loaded"),
        (own, "cannot be"),
        ("no/such.so", "cannot be read"),
        (place.folder.path().to_str().unwrap(), "cannot be read"),
    ];
    for (file, word) in cases {
        let said = place.heartian(&["plugins", "check", file]);
        assert_eq!(said.code, Some(1), "{file}");
        assert!(said.stderr.contains(word) && said.stderr.contains("check"), "{file} says: {}", said.stderr);
    }
    let said = place.heartian(&["nodes", "--plugin", "no/such.so"]);
    assert_eq!(said.code, Some(1), "a plugin that is named and not there is an error: {}", said.stderr);
}

/// Entry symbols of other versions, or none: libraries too small for a package of their own.
#[test]
fn entries_of_other_versions_are_named() {
    let place = Place::new();
    let cases =
        [("heartian_plugin_v2", "ABI 2;"), ("heartian_plugin_v0", "ABI 0;"), ("something_else", "does not export")];
    for (symbol, word) in cases {
        let source = format!("#[unsafe(no_mangle)] pub extern \"C\" fn {symbol}() {{}}");
        let (source, library) = (place.write("lib.rs", source), place.path(&format!("{symbol}.so")));
        let mut rustc = std::process::Command::new(std::env::var_os("RUSTC").unwrap_or("rustc".into()));
        rustc.args(["--edition", "2024", "--crate-type", "cdylib", "-o"]).arg(&library).arg(source);
        let built = rustc.output().unwrap();
        assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
        let said = place.heartian(&["plugins", "check", library.to_str().unwrap()]);
        assert!(said.code == Some(1) && said.stderr.contains(word), "{symbol}: {}", said.stderr);
    }
}

/// What fails while running fails its node, and with it what needs it, and nothing else.
#[test]
fn a_node_that_misbehaves_fails_alone() {
    let cases: [(&str, &[&str]); 18] = [
        ("panic", &["signal 6 SIGABRT", "the node panics"]),
        ("abort", &["signal 6 SIGABRT"]),
        ("exit", &["exit code 0"]),
        ("segfault", &["signal 11 SIGSEGV"]),
        ("overflow", &["signal 6 SIGABRT", "overflowed its stack"]),
        ("hang", &["no sign of life for 0.5 s", "--plugin-timeout"]),
        ("eat", &["ran out of memory (limit 0.5 GiB)", "--plugin-memory"]),
        ("says_nothing", &["status 1 and no word why"]),
        ("says_why", &["parameter `level`", "the level is too high", "lower `level`"]),
        ("missing", &["did not write its output `out`"]),
        ("wrong_type", &["`org.example.other/1`", "which carries `org.example.fault/1`"]),
        ("undeclared", &["`elsewhere`, which it does not declare"]),
        ("twice", &["wrote its output `out` twice"]),
        ("no_clip", &["its output `clip` is no `clip`", "safetensors"]),
        ("closes", &["its process"]),
        ("hang_at_load", &["no sign of life"]),
        ("print_at_load", &[]),
        ("prints", &[]),
    ];
    for (fault, words) in cases {
        let place = Place::new();
        let file = place.faulty(fault);
        let graph = place.write("faults.ron", GRAPH);
        // A panic that may not unwind prints a backtrace, which takes a while on a busy machine.
        let patience = if fault.starts_with("hang") { "0.5" } else { "20" };
        let start = Instant::now();
        let said = place.heartian(&[
            "run",
            graph.to_str().unwrap(),
            "--plugin",
            file.to_str().unwrap(),
            "--out",
            "out",
            "--keep-going",
            "--plugin-timeout",
            patience,
            "--plugin-memory",
            "512M",
        ]);
        assert!(start.elapsed() < Duration::from_secs(40), "{fault} took {:?}", start.elapsed());
        for word in words {
            assert!(said.stderr.contains(word), "{fault} says: {}", said.stderr);
        }
        if fault == "hang_at_load" {
            continue;
        }
        if words.is_empty() {
            // The two bad nodes read the same byte, so that the second finds the first's output.
            assert_eq!(place.statuses(), "before:ran bad:ran below:hit beside:ran", "{fault}: {}", said.stderr);
            continue;
        }
        assert_eq!(said.code, Some(1), "{fault}");
        assert_eq!(place.statuses(), "before:ran bad:failed below:skipped beside:ran", "{fault}: {}", said.stderr);
        assert!(said.stderr.contains("`bad`") && said.stderr.contains("`faulty` 0.1.0"), "{fault}: {}", said.stderr);
    }
}

/// A library that is trusted runs in this process; its own words reach the user there too.
#[test]
fn a_trusted_library_runs_inside_until_it_changes() {
    let place = Place::new();
    let graph = place.write("faults.ron", GRAPH);
    let run = |file: &std::path::Path| {
        let arguments =
            ["run", graph.to_str().unwrap(), "--plugin", file.to_str().unwrap(), "--out", "out", "--keep-going"];
        place.heartian(&arguments)
    };
    let why = place.faulty("says_why");
    assert_eq!(place.heartian(&["plugins", "trust", why.to_str().unwrap()]).code, Some(0));
    let said = run(&why);
    assert!(said.stderr.contains("the level is too high"), "{}", said.stderr);
    assert_eq!(place.statuses(), "before:ran bad:failed below:skipped beside:ran");

    let exits = place.faulty("exit");
    assert_eq!(run(&exits).code, Some(1), "an untrusted one is kept out of the process");
    assert_eq!(place.heartian(&["plugins", "trust", exits.to_str().unwrap()]).code, Some(0));
    assert_eq!(
        run(&exits).code,
        Some(0),
        "a trusted one that calls exit(0) ends the program: that is what trust means"
    );
    let lock = std::fs::read_to_string(place.path("plugins.lock")).unwrap();
    assert_eq!(lock.matches("\"faulty\"").count(), 2, "{lock}");

    place.write("plugins.lock", "{");
    let said = run(&why);
    assert!(said.code == Some(1) && said.stderr.contains("`plugins.lock` is damaged"), "{}", said.stderr);
}

/// Parameters of a plugin are checked as those of built-in nodes are, before anything runs.
#[test]
fn parameters_are_checked_like_built_in_ones() {
    let place = Place::new();
    let file = place.faulty("none");
    let graph = place.write("faults.ron", GRAPH);
    let check = |set: &str| {
        let arguments = ["check", graph.to_str().unwrap(), "--plugin", file.to_str().unwrap(), "--set", set];
        place.heartian(&arguments)
    };
    for (set, words) in [
        ("bad.level=2", ["`level` is 2", "from 0 to 1 dB"]),
        ("bad.level=loud", ["expected f64", "takes f64, in dB"]),
        ("bad.lovel=1", ["no parameter `lovel`", "did you mean `level`?"]),
        ("bad.mode=Hrad", ["is `Hrad`", "did you mean `Hard`?"]),
        ("bad.mode=3", ["`mode` is `3`", "one of Soft, Hard"]),
    ] {
        let said = check(set);
        assert_eq!(said.code, Some(1), "{set}");
        assert!(words.iter().all(|word| said.stderr.contains(word)), "{set} says: {}", said.stderr);
    }
    for set in ["bad.mode=Hard", "bad.level=1"] {
        let said = check(set);
        assert_eq!(said.code, Some(0), "{set}: {}", said.stderr);
    }
}

/// Ctrl-C does not wait for a library that hangs; and when the program itself is killed, its workers go too.
#[test]
#[cfg(target_os = "linux")]
fn a_hanging_library_holds_nobody_up() {
    let place = Place::new();
    let file = place.faulty("hang");
    let graph = place.write("hang.ron", "Graph(name: \"hang\", nodes: {\"bad\": (kind: \"Faulty\")})");
    let workers = || {
        let folders = std::fs::read_dir("/proc").unwrap().flatten();
        let lines = folders.filter_map(|folder| std::fs::read(folder.path().join("cmdline")).ok());
        lines.filter(|line| String::from_utf8_lossy(line).contains(&format!("plugin-host\0{}", file.display()))).count()
    };
    let until = |what: &dyn Fn() -> bool| {
        let start = Instant::now();
        while !what() {
            assert!(start.elapsed() < Duration::from_secs(20), "waited in vain");
            std::thread::sleep(Duration::from_millis(20));
        }
    };
    for signal in ["INT", "KILL"] {
        let arguments = ["run", graph.to_str().unwrap(), "--plugin", file.to_str().unwrap(), "--out", "out"];
        let mut child = place.command().args(arguments).spawn().unwrap();
        until(&|| workers() == 1 && place.path("remembered/heartian/plugins").is_dir());
        // What is remembered is written after describing, and the handler set before the first node starts.
        std::thread::sleep(Duration::from_millis(500));
        let sent = std::process::Command::new("kill").args([&format!("-{signal}"), &child.id().to_string()]).status();
        assert!(sent.unwrap().success());
        let ended = child.wait().unwrap();
        assert_eq!(ended.code(), (signal == "INT").then_some(130), "{signal}: {ended}");
        until(&|| workers() == 0);
    }
}
