//! Data sets from end to end: a folder written by the exporter is listed, checked, and read by the graph made for it.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use heartian_capture::export::{Layout, Place, labels, png, write_clip};
use heartian_capture::synthetic::{SyntheticOptions, generate};
use serde_json::Value;

fn heartian(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_heartian"));
    command.current_dir(folder).args(arguments).env_remove("HEARTIAN_CACHE").env("NO_COLOR", "1");
    command.output().unwrap()
}

fn said(folder: &Path, arguments: &[&str]) -> String {
    let output = heartian(folder, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn graph(name: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("graphs").join(name).display().to_string()
}

/// Two seconds of the synthetic person, as a subject of either set.
fn write(folder: &Path) {
    let options = SyntheticOptions { seconds: 2.0, size: 128, ..SyntheticOptions::default() };
    let recording = generate(&options, &mut |_| std::ops::ControlFlow::Continue(())).unwrap();
    for layout in [Layout::Ubfc, Layout::Pure] {
        let place = Place { layout, subject: 4, recording: 2 };
        let at = |name: String| folder.join(format!("{layout:?}")).join(name);
        std::fs::create_dir_all(at(place.folder())).unwrap();
        let text = labels(layout, &recording.clip.times_seconds, &recording.ppg, 72.0).unwrap();
        std::fs::write(at(place.labels()), text).unwrap();
        match layout {
            Layout::Ubfc => write_clip(&recording.clip, &mut File::create(at(place.frames(0.0))).unwrap()).unwrap(),
            Layout::Pure => {
                for (frame, seconds) in recording.clip.times_seconds.iter().enumerate() {
                    let bytes = png(&recording.clip.image_over_black(frame)).unwrap();
                    std::fs::write(at(place.frames(*seconds)), bytes).unwrap();
                }
            }
        }
    }
}

#[test]
fn what_the_exporter_writes_the_data_set_graphs_read() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path());
    let list: Value = serde_json::from_str(&said(folder.path(), &["datasets", "ls", ".", "--json"])).unwrap();
    let list = list.as_array().unwrap();
    assert_eq!(list.len(), 2);
    for (one, (set, label)) in list.iter().zip([("PURE", "motion"), ("UBFC-rPPG", "subject")]) {
        assert_eq!((&one["set"], &one["frames"], &one["missing"]), (&set.into(), &60.into(), &Value::Array(vec![])));
        assert!(one["labels"][label].is_string() && (one["seconds"].as_f64().unwrap() - 2.0).abs() < 0.04, "{one}");
    }
    let talking = said(folder.path(), &["datasets", "ls", ".", "--motion", "talking", "--paths"]);
    assert_eq!(talking.lines().map(PathBuf::from).collect::<Vec<_>>(), [PathBuf::from("./Pure/04-02")]);
    assert!(said(folder.path(), &["datasets", "ls", "Ubfc"]).contains("1 of 1 recordings, 0 with something missing"));
    let nothing = heartian(folder.path(), &["datasets", "ls", "Pure/04-02/04-02/.."]);
    assert!(nothing.status.success(), "a folder given from within");
    std::fs::create_dir(folder.path().join("empty")).unwrap();
    let nothing = heartian(folder.path(), &["datasets", "ls", "empty"]);
    assert!(!nothing.status.success() && String::from_utf8_lossy(&nothing.stderr).contains("no recording"));

    let installed = heartian(folder.path(), &["models", "verify"]).status.success();
    for (name, source) in [("ubfc.ron", "frames.source=Ubfc/subject4"), ("pure.ron", "frames.source=Pure/04-02")] {
        // The pulse comes with the recording: nothing that needs it is left without.
        said(folder.path(), &["check", &graph(name), "--set", source]);
        if !installed {
            println!("skipped: the networks are not installed (`heartian models install`)");
            continue;
        }
        let sets = ["--set", source, "--set", "frames.seconds=1", "--set", "frames.size=64", "--target", "frames"];
        let output = heartian(folder.path(), &[&["run", &graph(name)], &sets[..]].concat());
        // The networks need not take a small drawn head for a face; anything else is wrong.
        let error = String::from_utf8_lossy(&output.stderr).replace('│', " ");
        let error = error.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(output.status.success() || error.contains("no face in any"), "{error}");
    }
}
