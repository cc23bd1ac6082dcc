//! `heartian measure`, `heartian export` and `heartian bench decoder`, through the command a user types, on videos made
//! here. The face models are hidden from them: what is measured must not depend on what is installed on this machine.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use heartian_capture::export::{AviForm, AviWriter};
use serde_json::Value;

const WIDTH: usize = 32;
const HEIGHT: usize = 24;

/// A folder that vanishes with it.
struct Desk(tempfile::TempDir);

impl Desk {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// A patch of skin with a pulse, under `light`.
    fn video(&self, name: &str, frames: usize, bpm: f64, light: f64) -> PathBuf {
        let path = self.path(name);
        let mut file = std::fs::File::create(&path).unwrap();
        let form = AviForm { width: WIDTH, height: HEIGHT, frames, hertz: 30.0 };
        let mut writer = AviWriter::begin(&mut file, form).unwrap();
        for frame in 0..frames {
            let beat = (std::f64::consts::TAU * bpm / 60.0 * frame as f64 / 30.0).sin();
            let code = |index: usize| {
                let dither = (index * 7919 % 1000) as f64 / 1000.0;
                let skin = [150.0, 110.0, 90.0][index % 3] + [0.5, 1.5, 0.9][index % 3] * beat;
                (light * (skin + dither)) as u8
            };
            writer.frame(&(0..WIDTH * HEIGHT * 3).map(code).collect::<Vec<u8>>()).unwrap();
        }
        writer.end().unwrap();
        path
    }

    fn heartian(&self, arguments: &[&str]) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_heartian"));
        command.current_dir(self.0.path()).args(arguments).env("HEARTIAN_MODELS", self.0.path()).env("NO_COLOR", "1");
        command.output().unwrap()
    }

    fn measured(&self, arguments: &[&str]) -> Value {
        let output = self.heartian(&[&["measure", "--json"], arguments].concat());
        assert!(output.status.success(), "{arguments:?}: {}", said(&output));
        serde_json::from_slice(&output.stdout).unwrap()
    }
}

/// What a command said of its failure, as one line.
fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).split_whitespace().collect::<Vec<_>>().join(" ")
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn a_video_is_measured_and_the_answer_says_how_sure_it_is() {
    let desk = Desk::new();
    let video = desk.video("me.avi", 450, 84.0, 1.0);
    let answer = desk.measured(&[text(&video)]);
    assert!((answer["hr_bpm"].as_f64().unwrap() - 84.0).abs() < 1.5, "{answer:#}");
    assert!(answer["confidence"].as_f64().unwrap() > 0.8, "{answer:#}");
    assert_eq!((&answer["method"], &answer["frames"]), (&Value::from("pos"), &Value::from(450)));
    assert!(answer["seconds"].as_f64().unwrap() > 0.0);
    assert!((answer["video_seconds"].as_f64().unwrap() - 15.0).abs() < 0.01);
    let picture = std::fs::read(desk.path("runs/measure-me/pulse.png")).unwrap();
    assert!(picture.starts_with(b"\x89PNG") && picture.len() > 5000);
    let green = desk.measured(&[text(&video), "--method", "green", "--picture", "x.png"]);
    assert_eq!(green["method"], "green");
    let line = desk.heartian(&["measure", text(&video), "--seconds", "10"]);
    let line = String::from_utf8_lossy(&line.stdout).into_owned();
    assert!(line.lines().count() == 1 && line.contains("bpm") && line.contains("% sure"), "{line}");
}

#[test]
fn what_has_no_heart_rate_is_told_clearly() {
    let desk = Desk::new();
    let (short, black) = (desk.video("short.avi", 20, 70.0, 1.0), desk.video("black.avi", 300, 70.0, 0.0));
    let mut still = std::fs::read(desk.video("still.avi", 60, 70.0, 1.0)).unwrap();
    // The scale and rate of the stream's header: 0 frames a second.
    still[132..136].fill(0);
    std::fs::write(desk.path("still.avi"), still).unwrap();
    std::fs::create_dir(desk.path("frames")).unwrap();
    std::fs::write(desk.path("frames/1.png"), b"no picture").unwrap();
    std::fs::write(desk.path("bad.pth"), b"no weights").unwrap();
    let video = desk.video("me.avi", 100, 70.0, 1.0);
    let cases: [(&[&str], &str); 8] = [
        (&[text(&short)], "20"),
        (&[text(&black)], "mask or light the face"),
        (&["still.avi"], "its frame rate is zero"),
        (&["frames"], "`--fps 30`"),
        (&["absent.mp4"], "there is no such file"),
        (&[text(&video), "--weights", "bad.pth"], "cannot use the weights `bad.pth`"),
        (&[text(&video), "--method", "tscan"], "`--weights FILE.pth`"),
        (&[text(&video), "--method", "deepphys"], "decoders: POS"),
    ];
    for (arguments, expected) in cases {
        let output = desk.heartian(&[&["measure"], arguments].concat());
        let said = said(&output);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {said}");
        assert!(said.contains(expected) && !said.contains("panicked"), "{arguments:?}: {said}");
    }
}

#[test]
fn an_exported_video_is_a_subject_that_can_be_measured() {
    let desk = Desk::new();
    let video = desk.video("me.avi", 300, 66.0, 1.0);
    let rows: String =
        (0..1100).map(|k| format!("{},{}\n", f64::from(k) / 100.0, (f64::from(k) * 0.07).sin())).collect();
    std::fs::write(desk.path("me.csv"), format!("time_s,ppg\n{rows}")).unwrap();
    let export = |arguments: &[&str]| {
        let output = desk.heartian(&[&["export", text(&video), "--ppg", "me.csv"], arguments].concat());
        assert!(output.status.success(), "{}", said(&output));
    };
    export(&["--out", "UBFC", "--subject", "5"]);
    assert_eq!(std::fs::read(desk.path("UBFC/subject5/vid.avi")).unwrap(), std::fs::read(&video).unwrap());
    let truth = std::fs::read_to_string(desk.path("UBFC/subject5/ground_truth.txt")).unwrap();
    assert!(truth.lines().count() == 3 && truth.lines().all(|line| line.split_whitespace().count() == 300));
    export(&["--layout", "pure", "--out", "PURE", "--subject", "2"]);
    let answer = desk.measured(&["PURE/02-01/02-01", "--fps", "30"]);
    assert!((answer["hr_bpm"].as_f64().unwrap() - 66.0).abs() < 1.5, "{answer:#}");
    let short = desk.heartian(&["export", text(&video), "--ppg", "absent.csv", "--out", "X"]);
    assert_eq!(short.status.code(), Some(1));
}
