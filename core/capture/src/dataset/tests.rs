//! Each data set's layout, written here in full, read back frame by frame; then what may be wrong with it.
#![expect(clippy::unwrap_used, reason = "tests")]

use std::collections::BTreeMap;

use heartian_space::Rgb8Image;

use super::mat::tests as mat_writer;
use super::*;
use crate::video::{VideoOptions, open};

mod fuzz;
mod write;

use write::{codes, ibvp, mmpd, picture, pure, ubfc};

/// All frames and times of a source.
fn read(path: &Path) -> Result<Vec<(f64, Rgb8Image)>, VideoError> {
    let mut video = open(path, &VideoOptions { folder_hertz: f64::NAN, ..VideoOptions::default() })?;
    let mut frames = Vec::new();
    while let Some(frame) = video.next_frame()? {
        frames.push((frame.seconds, frame.image));
    }
    Ok(frames)
}

fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/datasets").join(name)
}

fn one(path: &Path) -> (Place, Recording) {
    let place = locate(path).unwrap();
    let recording = Recording::of(&place, path);
    (place, recording)
}

#[test]
fn ubfc_gives_its_frames_and_one_sample_each() {
    let folder = tempfile::tempdir().unwrap();
    // Uneven, as its third line tells; the header says 25 a second.
    let times: Vec<f64> = (0..40).map(|k| 5.0 + f64::from(k) / 29.5 + 0.004 * f64::from(k % 3)).collect();
    let pulse: Vec<f64> = (0..40).map(|k| (f64::from(k) / 4.0).sin()).collect();
    ubfc(&folder.path().join("subject12"), 40, [&pulse, &[70.0; 40], &times]);
    for source in [folder.path().join("subject12"), folder.path().join("subject12/vid.avi")] {
        let frames = read(&source).unwrap();
        assert!(
            frames
                .iter()
                .enumerate()
                .all(|(k, (seconds, image))| { (seconds - (times[k] - 5.0)).abs() < 1e-6 && *image == picture(k) })
        );
        let (place, recording) = one(&source);
        let trace = trace(&place).unwrap();
        assert_eq!((trace.series.values.len(), trace.notes.len(), frames.len()), (40, 0, 40));
        assert!((trace.series.values[9] - pulse[9]).abs() < 1e-7);
        assert!((trace.series.times_seconds[9] - frames[9].0).abs() < 1e-9, "one clock");
        assert_eq!((place.set, recording.name.as_str(), recording.frames), (DataSet::Ubfc, "subject12", Some(40)));
        assert_eq!((recording.labels["subject"].as_str(), recording.missing.len()), ("12", 0));
    }
    // Fewer samples than frames: the header's rate for the frames, and the list says what is missing.
    ubfc(&folder.path().join("subject2"), 40, [&pulse[..20], &[70.0; 20], &times[..20]]);
    let (_, recording) = one(&folder.path().join("subject2"));
    assert!(recording.missing[0].contains("pulse after"), "{:?}", recording.missing);
    assert!((read(&folder.path().join("subject2")).unwrap()[10].0 - 0.4).abs() < 1e-9);
    // No ground truth: still a video.
    std::fs::remove_file(folder.path().join("subject2/ground_truth.txt")).unwrap();
    let (place, recording) = one(&folder.path().join("subject2"));
    assert_eq!((read(&place.video).unwrap().len(), recording.frames, recording.missing.len()), (40, Some(40), 1));
    assert!(matches!(trace(&place), Err(DataSetError::Missing { .. })));
}

#[test]
fn pure_keeps_its_clocks() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("03-05");
    pure(&root, 20, true);
    for source in [root.clone(), root.join("03-05")] {
        let frames = read(&source).unwrap();
        // A frame was dropped after the tenth.
        let time = |k: usize| (k + usize::from(k >= 10)) as f64 / 30.0;
        assert!(frames.iter().enumerate().all(|(k, (s, image))| (s - time(k)).abs() < 1e-6 && *image == picture(k)));
        let (place, recording) = one(&source);
        let trace = trace(&place).unwrap();
        // The pulse began a quarter of a second before the first frame.
        assert!((trace.series.times_seconds[0] + 0.25).abs() < 1e-6);
        assert!((trace.series.rate_hertz() - 60.0).abs() < 0.01);
        assert_eq!(recording.labels["motion"], "Small Rotation");
        assert!(recording.missing.is_empty() && (recording.hertz.unwrap() - 28.5).abs() < 0.2, "{recording:?}");
    }
    // Without clocks: laid over each other evenly, and said.
    let plain = folder.path().join("01-01");
    pure(&plain, 20, false);
    let (place, recording) = one(&plain);
    let trace = trace(&place).unwrap();
    assert!((trace.series.times_seconds.last().unwrap() - 19.0 / 30.0).abs() < 1e-9);
    assert!(recording.missing[0].contains("no common clock"), "{:?}", recording.missing);
    std::fs::write(plain.join("01-01.json"), "{\"/FullPackage\": [").unwrap();
    assert!(matches!(super::trace(&place), Err(DataSetError::Damaged { .. })));
}

#[test]
fn mmpd_gives_video_pulse_and_labels() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("subject7/p7_3.mat");
    mmpd(&path, "Incandescent");
    for source in [path, golden("mmpd_plain.mat"), golden("mmpd_compressed.mat"), golden("mmpd_odd.mat")] {
        let frames = read(&source).unwrap();
        assert!(
            frames.len() == 12 && frames.iter().enumerate().all(|(k, (_, image))| *image == codes(k)),
            "{source:?}"
        );
        assert!((frames[11].0 - 11.0 / 30.0).abs() < 1e-9);
        let (place, recording) = one(&source);
        let series = trace(&place).unwrap().series;
        assert_eq!((series.len(), place.set), (24, DataSet::Mmpd));
        assert!((series.times_seconds[23] - 11.0 / 30.0).abs() < 1e-9);
        let scale = series.values[4] / (4.0f64 / 3.0).sin();
        assert!((scale - 1.0).abs() < 1e-6 || (scale - 1000.0).abs() < 1.0, "{scale}");
        assert_eq!(recording.labels["skin_color"], "5");
        assert_eq!(recording.labels["motion"], "Stationary (after exercise)");
        assert!(recording.missing.is_empty(), "{:?}", recording.missing);
    }
}

#[test]
fn scamps_is_read_from_matlab_7_3() {
    let source = golden("scamps.mat");
    let frames = read(&source).unwrap();
    assert!(frames.len() == 12 && frames.iter().enumerate().all(|(k, (_, image))| *image == codes(k)));
    let (place, recording) = one(&source);
    let series = trace(&place).unwrap().series;
    assert_eq!((place.set, series.len(), recording.frames), (DataSet::Scamps, 12, Some(12)));
    assert!(series.values.iter().enumerate().all(|(k, value)| (value - (k as f64 / 3.0).sin()).abs() < 1e-12));
    assert!(recording.missing.is_empty());
}

#[test]
fn ibvp_leaves_out_what_it_marks_as_bad() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("p05_b");
    ibvp(&root, 30);
    for source in [root.clone(), root.join("p05_b_rgb")] {
        let frames = read(&source).unwrap();
        assert!(frames.len() == 30 && frames.iter().enumerate().all(|(k, (_, image))| *image == picture(k)));
        let (place, recording) = one(&source);
        let trace = trace(&place).unwrap();
        assert_eq!((trace.series.len(), recording.labels["session"].as_str()), (60 - 15, "b"));
        assert!(trace.notes[0].contains("15 of 60") && trace.notes[1].contains("no sample from"), "{:?}", trace.notes);
        assert_eq!(recording.missing, trace.notes);
    }
}

#[test]
fn a_folder_is_listed_and_filtered() {
    let folder = tempfile::tempdir().unwrap();
    for (subject, light) in [(10, "LED-low"), (2, "LED-high"), (1, "LED-low")] {
        mmpd(&folder.path().join(format!("MMPD/subject{subject}/p{subject}_0.mat")), light);
    }
    ubfc(&folder.path().join("UBFC/subject1"), 4, [&[1.0, 2.0, 3.0, 4.0], &[60.0; 4], &[0.0, 0.1, 0.2, 0.3]]);
    pure(&folder.path().join("PURE/06-01"), 20, true);
    ibvp(&folder.path().join("iBVP/p01_a"), 30);
    std::fs::write(folder.path().join("MMPD/notes.mat"), "no such file").unwrap();
    let all = list(folder.path()).unwrap();
    let names: Vec<&str> = all.iter().map(|recording| recording.name.as_str()).collect();
    assert_eq!(names, ["p1_0", "p2_0", "p10_0", "06-01", "subject1", "p01_a"]);
    let count = |label: &str, values: &[&str]| {
        let wanted = BTreeMap::from([(label.to_owned(), values.iter().map(|v| (*v).to_owned()).collect())]);
        all.iter().filter(|recording| recording.fits(&wanted)).count()
    };
    assert_eq!((count("light", &["led-LOW"]), count("light", &["LED-low", "LED-high"])), (2, 3));
    assert_eq!((count("light", &["Sun"]), count("motion", &["Steady"]), count("subject", &["1", "01"])), (0, 1, 3));
    assert_eq!(list(&folder.path().join("PURE/06-01")).unwrap().len(), 1);
    assert!(matches!(list(&folder.path().join("none")), Err(DataSetError::File { .. })));
}

/// What is there but wrong is named; nothing is made up.
#[test]
fn wrong_classes_sizes_and_values_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("p1_1.mat");
    let video = |class: u32, sides: &[u32], data: (u32, &[u8])| mat_writer::array("video", class, sides, data, false);
    let pulse = mat_writer::array("GT_ppg", 6, &[1, 4], (2, &[1, 2, 3, 4]), false);
    let nan: Vec<u8> = [0.5, f64::NAN, 0.5, 0.1, 0.1, 0.1].iter().flat_map(|v: &f64| v.to_le_bytes()).collect();
    for (what, elements) in [
        ("not an array of numbers", vec![mat_writer::text("video", "a film", false), pulse.clone()]),
        ("not frames × rows", vec![video(9, &[2, 2, 3], (2, &[0; 12]))]),
        ("no variable `video`", vec![pulse.clone()]),
        ("holds the value NaN", vec![video(6, &[2, 1, 1, 3], (9, &nan))]),
        ("holds the value 200", vec![video(6, &[1, 1, 1, 3], (2, &[200, 1, 1]))]),
        ("is no size of a recording", vec![video(9, &[0, 4, 4, 3], (2, &[]))]),
        ("is no size of a recording", vec![video(9, &[1 << 30, 1 << 30, 4, 3], (2, &[0; 8]))]),
        ("size contradicts", vec![video(9, &[600, 240, 320, 3], (2, &[0; 64]))]),
    ] {
        std::fs::write(&path, mat_writer::file(&elements, false)).unwrap();
        let said = read(&path).unwrap_err().to_string();
        assert!(said.contains(what), "{what}: {said}");
    }
    let words = mat_writer::text("GT_ppg", "none", false);
    std::fs::write(&path, mat_writer::file(&[video(9, &[2, 1, 1, 3], (2, &[0; 6])), words], false)).unwrap();
    let (place, recording) = one(&path);
    assert!(matches!(trace(&place), Err(DataSetError::Damaged { .. })));
    assert!(recording.missing[0].contains("`GT_ppg` is not an array of numbers"), "{:?}", recording.missing);
}
