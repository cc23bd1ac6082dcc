//! Libraries for the tests, built on first use, and the command that loads them.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

use tempfile::TempDir;

const PACKAGES: [&str; 3] = ["heartian-blob", "heartian-green-trace", "heartian-faulty"];

/// The library of a package, built once with the profile of these tests. Cargo is asked and not the folder: what lies
/// there may be old, and `cargo test` does not build libraries that nothing links.
pub fn library(package: &str) -> PathBuf {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    assert!(PACKAGES.contains(&package));
    let folder = FOLDER.get_or_init(|| {
        // target/PROFILE/deps/tests-… → target/PROFILE
        let program = std::env::current_exe().unwrap();
        let folder = program.parent().and_then(Path::parent).unwrap().to_owned();
        let profile = match folder.file_name().and_then(|name| name.to_str()) {
            Some("debug") | None => "dev",
            Some(name) => name,
        };
        let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or("cargo".into()));
        cargo.current_dir(env!("CARGO_MANIFEST_DIR")).args(["build", "--quiet", "--profile", profile, "--target-dir"]);
        cargo.arg(folder.parent().unwrap()).args(PACKAGES.iter().flat_map(|package| ["-p", package]));
        let built = cargo.output().unwrap();
        assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
        folder
    });
    let stem = package.replace('-', "_");
    let file = folder.join(format!("{}{stem}{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX));
    assert!(file.is_file(), "{} was not built", file.display());
    file
}

/// A folder to run the command in, with nobody's plugins or cache but its own.
pub struct Place {
    pub folder: TempDir,
}

/// What a command did.
pub struct Said {
    pub code: Option<i32>,
    pub stdout: String,
    /// Standard error with all white space as single spaces and the frames of messages gone.
    pub stderr: String,
}

impl Place {
    pub fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path(name);
        std::fs::write(&path, content).unwrap();
        path
    }

    pub fn command(&self) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_heartian"));
        command.current_dir(self.folder.path()).env("NO_COLOR", "1").env_remove("HEARTIAN_CACHE");
        command.env("XDG_CACHE_HOME", self.path("remembered")).env("XDG_DATA_HOME", self.path("data"));
        command.env_remove("HEARTIAN_PLUGIN_PATH").env_remove("RUST_BACKTRACE");
        command
    }

    pub fn heartian(&self, arguments: &[&str]) -> Said {
        said(&self.command().args(arguments).output().unwrap())
    }

    /// `id:status` of each node of a run that was told `--out out`.
    pub fn statuses(&self) -> String {
        crate::results::statuses(&self.path("out"))
    }

    /// A library that misbehaves so.
    pub fn faulty(&self, fault: &str) -> PathBuf {
        const MARK: &[u8] = b"HEARTIAN-FAULT=none";
        let mut bytes = std::fs::read(library("heartian-faulty")).unwrap();
        let at = bytes.windows(MARK.len()).position(|window| window == MARK).unwrap() + MARK.len() - "none".len();
        bytes[at..at + 4].copy_from_slice(b"....");
        bytes[at..at + fault.len()].copy_from_slice(fault.as_bytes());
        self.write(&format!("lib{fault}{}", std::env::consts::DLL_SUFFIX), bytes)
    }
}

pub fn said(output: &Output) -> Said {
    let stderr = String::from_utf8_lossy(&output.stderr);
    let stderr = stderr.split(|c: char| c.is_whitespace() || c == '│').filter(|word| !word.is_empty());
    Said {
        code: output.status.code(),
        stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
        stderr: stderr.collect::<Vec<_>>().join(" "),
    }
}
