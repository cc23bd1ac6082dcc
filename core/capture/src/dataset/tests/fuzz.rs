//! Damaged recordings are errors, holes or other recordings, never a panic, and never take memory on their word.

use super::write::{avi, ibvp, mmpd, pure, ubfc};
use super::*;
use crate::fuzz::rounds;

/// Reads whatever can be read.
fn look(path: &Path) {
    let Some(place) = locate(path) else { return };
    let _ = Recording::of(&place, path);
    let Ok(mut video) = open(path, &VideoOptions::default()) else { return };
    for _ in 0..3 {
        if !matches!(video.next_frame(), Ok(Some(_))) {
            break;
        }
    }
}

/// Damages one file of a recording.
fn fuzz(name: &str, short: u64, source: &Path, file: &Path) {
    let whole = std::fs::read(file).unwrap();
    rounds(name, short, &[whole], |bytes| {
        std::fs::write(file, bytes).unwrap();
        look(source);
    });
}

#[test]
fn fuzz_mat_5() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("subject1/p1_1.mat");
    mmpd(&path, "LED-low");
    let golden =
        ["mmpd_plain.mat", "mmpd_compressed.mat", "mmpd_odd.mat"].map(|name| std::fs::read(golden(name)).unwrap());
    let files = [&golden[..], &[std::fs::read(&path).unwrap()]].concat();
    rounds("MAT 5", 500, &files, |bytes| {
        std::fs::write(&path, bytes).unwrap();
        look(&path);
    });
}

#[test]
fn fuzz_mat_7_3() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mat");
    std::fs::copy(golden("scamps.mat"), &path).unwrap();
    fuzz("MAT 7.3", 500, &path, &path);
}

#[test]
fn fuzz_labels() {
    let folder = tempfile::tempdir().unwrap();
    let line: Vec<f64> = (0..12).map(|k| f64::from(k) / 25.0).collect();
    let root = folder.path().join("subject1");
    ubfc(&root, 12, [&line, &[70.0; 12], &line]);
    fuzz("ground_truth.txt", 150, &root, &root.join("ground_truth.txt"));
    let root = folder.path().join("01-02");
    pure(&root, 4, true);
    fuzz("PURE's JSON", 150, &root, &root.join("01-02.json"));
    let root = folder.path().join("p01_a");
    ibvp(&root, 4);
    fuzz("iBVP's CSV", 150, &root, &root.join("p01_a_bvp.csv"));
    let path = folder.path().join("ppg.csv");
    let lines: String = (0..40).map(|k| format!("{},{}\n", k as f64 / 10.0, k % 7)).collect();
    rounds("PPG CSV", 400, &[format!("time_s,ppg\n{lines}").into_bytes()], |bytes| {
        std::fs::write(&path, bytes).unwrap();
        if let Ok(series) = crate::ppg::read_ppg(&path) {
            let _ = crate::ppg::Trace::of(series);
        }
    });
}

#[test]
fn fuzz_avi() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.avi");
    let frames: Vec<_> = (0..5).map(super::picture).collect();
    rounds("AVI", 1000, &[avi(&frames)], |bytes| {
        // What is left is no AVI: ffmpeg's affair.
        if bytes.len() < 12 || &bytes[..4] != b"RIFF" || &bytes[8..12] != b"AVI " {
            return;
        }
        std::fs::write(&path, bytes).unwrap();
        crate::video::fuzz_avi(&path);
    });
}
