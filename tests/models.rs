//! `heartian models install` with package clients that this file plays: what a user hears who is offline, and that no other
//! command asks for anything. No network is needed, and none is touched.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output};

/// Package clients that leave a mark, say `words` and fail.
fn clients(folder: &Path, words: &str) {
    for name in ["npm", "pip", "pip3", "python3", "python"] {
        let path = folder.join(name);
        let mark = folder.join("asked");
        std::fs::write(&path, format!("#!/bin/sh\necho x >> {}\necho '{words}' >&2\nexit 1\n", mark.display()))
            .unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
    }
}

/// Runs `heartian` where only the folder's programs are found and nothing is installed.
fn heartian(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_heartian"))
        .current_dir(folder)
        .env("PATH", folder)
        .env("HEARTIAN_MODELS", folder.join("models"))
        .args(arguments)
        .output()
        .unwrap()
}

/// What it said, in one line.
fn said(output: &Output) -> String {
    let text = String::from_utf8_lossy(&output.stderr).replace(['│', '×'], " ");
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn offline_the_error_names_mirrors_and_the_folder_to_copy() {
    let folder = tempfile::tempdir().unwrap();
    clients(folder.path(), "npm error code ECONNREFUSED https://user:secret@example.org/x");
    for set in ["face", "irises", "head", "all"] {
        let output = heartian(folder.path(), &["models", "install", set]);
        let text = said(&output);
        assert!(!output.status.success());
        for word in ["ECONNREFUSED", "PIP_INDEX_URL", "npm_config_registry", "models install", "copy"] {
            assert!(text.contains(word), "{set}: no {word} in: {text}");
        }
        assert!(!text.contains("secret"), "{text}");
    }
    assert!(folder.path().join("asked").is_file());
}

#[test]
fn without_a_client_the_error_says_what_to_install() {
    let folder = tempfile::tempdir().unwrap();
    let output = heartian(folder.path(), &["models", "install"]);
    let text = said(&output);
    assert!(!output.status.success() && text.contains("`npm` or `pip`") && text.contains("copy"), "{text}");
}

#[test]
fn no_other_command_fetches_anything() {
    let folder = tempfile::tempdir().unwrap();
    clients(folder.path(), "nothing");
    std::fs::create_dir(folder.path().join("frames")).unwrap();
    let grey = heartian_space::Rgb8Image::filled(64, 64, [90; 3]);
    std::fs::write(folder.path().join("frames/0.png"), heartian_capture::export::png(&grey).unwrap()).unwrap();
    let graph = Path::new(env!("CARGO_MANIFEST_DIR")).join("graphs/track.ron").display().to_string();
    let source = ["--set", "frames.source=frames"];
    let run = heartian(folder.path(), &[&["run", &graph], &source[..]].concat());
    let text = said(&run);
    assert!(!run.status.success() && text.contains("heartian models install"), "{text}");
    for command in [&["models", "ls"][..], &["models", "verify"], &["nodes"], &["measure", "frames"]] {
        heartian(folder.path(), command);
    }
    assert!(!folder.path().join("asked").exists(), "a package client was called");
}
