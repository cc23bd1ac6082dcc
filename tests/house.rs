//! The walls of the house: who may see whom, and how every file opens. Read from the manifests and sources themselves.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Longer files are split.
const LINES: usize = 500;
/// Longer crate roots are an index no more.
const ROOT_LINES: usize = 80;

/// Each crate and what it may see; what those see, it may see too.
const LADDER: [(&str, &[&str]); 19] = [
    ("artifact", &[]),
    ("ops", &[]),
    ("foreign", &[]),
    ("plugin-abi", &[]),
    ("plugin", &["plugin-abi", "artifact"]),
    ("graph", &["artifact", "plugin-abi"]),
    ("space", &["artifact"]),
    ("signal", &["space"]),
    ("report", &["space"]),
    ("face", &["space", "ops", "foreign"]),
    ("decoder", &["signal", "ops", "foreign"]),
    ("splat", &["space", "ops"]),
    ("capture", &["space", "face", "foreign"]),
    ("avatar", &["splat", "face"]),
    ("pulse", &["space", "signal", "ops"]),
    ("nodes-capture", &["graph", "capture"]),
    ("nodes-avatar", &["graph", "avatar", "report"]),
    ("nodes-pulse", &["graph", "pulse"]),
    ("nodes-measure", &["graph", "decoder", "face", "report"]),
];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Each crate's folder.
fn folder(name: &str) -> PathBuf {
    match (name, name.strip_prefix("nodes-")) {
        ("plugin-abi", _) => root().join("plugins/abi"),
        ("plugin", _) => root().join("plugins/sdk"),
        (_, Some(node)) => root().join("nodes").join(node),
        (_, None) => root().join("core").join(name),
    }
}

/// The house's own crates among a manifest's dependencies, development ones included.
fn dependencies(manifest: &str) -> BTreeSet<String> {
    let mut section = "";
    let mut found = BTreeSet::new();
    for line in manifest.lines().map(str::trim) {
        if line.starts_with('[') {
            section = line;
        }
        // `[dependencies]`, `[dev-dependencies]`, `[target.'..'.dependencies]`, `[dependencies.heartian-x]`.
        let table = section.split_once("dependencies.heartian-").map(|(_, name)| name.trim_end_matches(']'));
        let entry = section.ends_with("dependencies]").then(|| line.strip_prefix("heartian-")).flatten();
        let name = entry.map(|rest| rest.split(['.', ' ', '=']).next().unwrap_or_default());
        found.extend(table.or(name).map(str::to_owned));
    }
    found
}

fn closure(ladder: &BTreeMap<&str, &[&str]>, name: &str) -> BTreeSet<String> {
    let mut seen = BTreeSet::new();
    let mut waiting: Vec<&str> = ladder[name].to_vec();
    while let Some(next) = waiting.pop() {
        if seen.insert(next.to_owned()) {
            waiting.extend(ladder[next]);
        }
    }
    seen
}

/// All Rust sources of the house.
fn sources() -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders: Vec<PathBuf> =
        ["core", "nodes", "plugins", "tests", "examples"].iter().map(|name| root().join(name)).collect();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            let path = entry.path();
            if path.is_dir() && path.file_name().is_some_and(|name| name != "target") {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

fn short(path: &Path) -> String {
    path.strip_prefix(root()).unwrap_or(path).display().to_string()
}

#[test]
fn dependencies_point_downwards_only() {
    let ladder: BTreeMap<&str, &[&str]> = LADDER.into_iter().collect();
    let mut wrong = Vec::new();
    for (name, _) in LADDER {
        let manifest = std::fs::read_to_string(folder(name).join("Cargo.toml")).unwrap();
        let allowed = closure(&ladder, name);
        assert!(!allowed.contains(name), "the ladder has a ring at {name}");
        let seen = dependencies(&manifest);
        wrong.extend(seen.difference(&allowed).map(|other| format!("{name} sees {other}")));
    }
    assert!(wrong.is_empty(), "{wrong:?}");
}

#[test]
fn every_member_has_its_place_on_the_ladder() {
    let manifest = std::fs::read_to_string(root().join("Cargo.toml")).unwrap();
    let members = manifest.lines().find(|line| line.starts_with("members")).unwrap();
    let members: BTreeSet<String> = members.split('"').skip(1).step_by(2).map(str::to_owned).collect();
    let placed: BTreeSet<String> = LADDER.iter().map(|(name, _)| short(&folder(name))).collect();
    // Plugins stand outside: strangers' libraries that see the SDK and nothing else.
    let inside = |member: &&String| !member.starts_with("plugins") || placed.contains(*member);
    let placed_here: BTreeSet<String> = members.iter().filter(inside).cloned().collect();
    assert_eq!(placed_here, placed);
}

/// The absences that matter most, by name, so that no widening of the ladder loses them unseen.
#[test]
fn the_walls_stand() {
    let ladder: BTreeMap<&str, &[&str]> = LADDER.into_iter().collect();
    let walls = [
        ("nodes-measure", "pulse"),
        ("nodes-measure", "splat"),
        ("signal", "pulse"),
        ("pulse", "splat"),
        ("splat", "face"),
        ("graph", "space"),
        ("capture", "splat"),
        ("decoder", "pulse"),
        ("decoder", "face"),
    ];
    for (name, hidden) in walls {
        assert!(!closure(&ladder, name).contains(hidden), "{name} must not see {hidden}");
    }
    let domain = LADDER.iter().filter(|(name, _)| *name != "graph" && !name.starts_with("nodes-"));
    for (name, _) in domain {
        assert!(!closure(&ladder, name).contains("graph"), "{name} must not see graph");
    }
    for (node, _) in LADDER.iter().filter(|(name, _)| name.starts_with("nodes-")) {
        assert!(!closure(&ladder, node).iter().any(|other| other.starts_with("nodes-")), "{node} sees another");
    }
}

#[test]
fn manifests_are_read_in_every_spelling() {
    let manifest = "[package]\nname = \"heartian-x\"\n[dependencies]\nheartian-a.workspace = true\nheartian-b = {}\n\
                    serde = \"1\"\n[dev-dependencies]\nheartian-c={}\n[dependencies.heartian-d]\npath = \"\"\n";
    assert_eq!(dependencies(manifest), ["a", "b", "c", "d"].map(str::to_owned).into());
}

#[test]
fn every_source_opens_with_what_it_is() {
    let opens = |path: &PathBuf| {
        let text = std::fs::read_to_string(path).unwrap();
        text.lines().next().is_some_and(|line| line.starts_with("//! ") && line.len() > "//! ".len())
    };
    let silent: Vec<String> = sources().iter().filter(|path| !opens(path)).map(|path| short(path)).collect();
    assert!(silent.is_empty(), "these files do not open with `//!`: {silent:?}");
}

#[test]
fn files_keep_to_their_size_and_shape() {
    let mut wrong = Vec::new();
    for path in sources() {
        let text = std::fs::read_to_string(&path).unwrap();
        let (name, lines) = (short(&path), text.lines().count());
        let is_root = path.ends_with("src/lib.rs");
        if lines > LINES || (is_root && lines > ROOT_LINES) {
            wrong.push(format!("{name} has {lines} lines"));
        }
        if path.ends_with("mod.rs") {
            wrong.push(format!("{name}: write `foo.rs` beside `foo/` instead"));
        }
        let public = text.lines().map(str::trim).filter(|line| line.starts_with("pub use "));
        wrong.extend(public.filter(|line| line.ends_with("::*;")).map(|line| format!("{name}: {line}")));
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// `core/graph` is a graph engine and nothing else: its text names no domain crate either.
#[test]
fn the_engine_names_no_domain() {
    let domain: Vec<String> = LADDER
        .iter()
        .filter(|(name, _)| !matches!(*name, "artifact" | "graph" | "plugin-abi" | "plugin"))
        .map(|(name, _)| format!("heartian_{}", name.replace('-', "_")))
        .collect();
    for path in sources().iter().filter(|path| path.starts_with(root().join("core/graph"))) {
        let text = std::fs::read_to_string(path).unwrap();
        let named: Vec<&String> = domain.iter().filter(|name| text.contains(name.as_str())).collect();
        assert!(named.is_empty(), "{} names {named:?}", short(path));
    }
}
