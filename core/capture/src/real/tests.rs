//! The whole way on the real clip, where it and the networks are there. `HEARTIAN_LOOK=file.png` also writes a sheet:
//! landmarks, then the head over black, magenta and white.
#![expect(clippy::unwrap_used, reason = "tests")]

use std::path::PathBuf;

use super::*;
use crate::video::VideoError;

fn go(_: Progress) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// The clip, when it lies beside the repository and the networks are installed.
fn real_clip() -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/franck.mp4");
    if !path.is_file() {
        println!("skipped: ../shared/data/franck.mp4 is not there");
        return None;
    }
    if let Err(error) = heartian_face::models::verify() {
        println!("skipped: {error}");
        return None;
    }
    Some(path)
}

/// Pixels of the head (alpha at least a tenth) whose blue stands out: wall that was left at the rim.
fn blue_rim(clip: &Clip) -> f64 {
    let (mut blue, mut head) = (0usize, 0usize);
    for (pixel, alpha) in clip.frames.as_chunks::<3>().0.iter().zip(&clip.alpha) {
        if *alpha >= 25 {
            head += 1;
            blue += usize::from(i32::from(pixel[2]) > i32::from(pixel[0]) + 8);
        }
    }
    blue as f64 / head.max(1) as f64
}

#[test]
fn the_real_clip_becomes_a_head_with_landmarks() {
    let Some(path) = real_clip() else { return };
    let options = RealOptions { seconds: 1.0, start_seconds: 2.0, size: 192, ..RealOptions::default() };
    let mut steps = Vec::new();
    let recording = load_real(&path, &options, &mut |said| {
        steps.push(said.step);
        ControlFlow::Continue(())
    })
    .unwrap();
    let RealRecording { clip, observations, .. } = &recording;
    assert_eq!((clip.len(), clip.width, clip.label.as_str()), (24, 192, "input"));
    assert!((clip.times_seconds[0] - 2.0).abs() < 1e-6, "times are the recording's own");
    assert!(steps.is_sorted() && steps.last() == Some(&48));
    assert!((0..24).all(|frame| observations.has_face(frame)));
    for frame in 0..24 {
        let landmarks: Vec<Landmark> = observations.frame(frame).collect();
        let [top, chin] = [10, 152].map(|i: usize| landmarks[i].position_px);
        let height = chin[1] - top[1];
        assert!((0.35..0.55).contains(&(height / 192.0)), "face height {height}");
        let alpha = |x: f32, y: f32| clip.frame_alpha(frame)[y as usize * 192 + x as usize];
        assert_eq!(alpha(landmarks[1].position_px[0], landmarks[1].position_px[1]), 255, "the nose is the person");
        assert_eq!((alpha(2.0, 100.0), alpha(189.0, 100.0)), (0, 0), "the wall is not");
    }
    let share = blue_rim(clip);
    assert!(share < 0.002, "{:.2} % of the head is wall", 100.0 * share);
    let share = shirt(clip, observations);
    assert!(share < 0.01, "{:.2} % of what lies below the mouth is shirt", 100.0 * share);
    look(&recording);
}

/// Of the pixels below the mouth that count as head, those that are grey or blue as the man's shirt is.
fn shirt(clip: &Clip, observations: &Observations) -> f64 {
    let (mut grey, mut head) = (0usize, 0usize);
    for frame in 0..clip.len() {
        let mouth = observations.frame(frame).nth(17).unwrap().position_px[1] as usize;
        let pixels = clip.frame(frame).as_chunks::<3>().0.iter().zip(clip.frame_alpha(frame)).skip(mouth * clip.width);
        for (pixel, _) in pixels.filter(|(_, alpha)| **alpha >= 128) {
            head += 1;
            grey += usize::from(u16::from(pixel[0]) < u16::from(pixel[2]) + 12);
        }
    }
    grey as f64 / head.max(1) as f64
}

/// Error and time of both heads on five seconds. `HEARTIAN_LOOK=folder` writes the last frame and the fitted mesh's points.
#[test]
#[ignore = "takes half a minute: cargo test -p heartian-capture --release -- --ignored both_heads --nocapture"]
fn both_heads_fit_the_real_clip() {
    use heartian_face::{HeadModel, HeadSource, TrackOptions, track};
    let Some(path) = real_clip() else { return };
    let options = RealOptions { seconds: 5.0, size: 256, ..RealOptions::default() };
    let recording = load_real(&path, &options, &mut go).unwrap();
    for source in [HeadSource::Procedural, HeadSource::Installed] {
        let head = match HeadModel::load(&source) {
            Ok(head) => head,
            Err(error) => return println!("skipped: {error}"),
        };
        let begin = std::time::Instant::now();
        let options = TrackOptions { focal_px: Some(2.2 * 256.0), ..TrackOptions::default() };
        let found = track(&head, &recording.observations, &options, &mut go).unwrap();
        let fraction = found.landmark_rms_px / found.interocular_px;
        println!(
            "{}: {} vertices, {} identity and {} expression modes, {} landmarks: rms {:.3} px = {:.2} % of {:.1} px, {:.1} s for {} frames",
            head.name,
            head.vertices.len(),
            head.identity.count,
            head.expression.count,
            head.landmarks.len(),
            found.landmark_rms_px,
            100.0 * fraction,
            found.interocular_px,
            begin.elapsed().as_secs_f64(),
            found.frames.len()
        );
        if let Some(folder) = std::env::var_os("HEARTIAN_LOOK") {
            let last = found.frames.len() - 1;
            let vertices = found.baked_head().pose(&found.frames[last]);
            let pixels: Vec<u8> = vertices
                .iter()
                .filter_map(|vertex| found.camera.project(glam::Vec3::from_array(*vertex)))
                .flat_map(|pixel| [pixel.x, pixel.y])
                .flat_map(f32::to_le_bytes)
                .collect();
            let folder = Path::new(&folder);
            std::fs::write(folder.join(format!("{}.points", head.name)), pixels).unwrap();
            std::fs::write(folder.join("last.rgb"), recording.clip.frame(last)).unwrap();
            std::fs::write(folder.join("last.black"), recording.clip.image_over_black(last).data).unwrap();
        }
        assert!(fraction < 0.03, "{}: {fraction}", head.name);
    }
}

#[test]
fn the_answer_is_the_same_with_one_thread() {
    let Some(path) = real_clip() else { return };
    let options = RealOptions { seconds: 0.2, size: 64, ..RealOptions::default() };
    let all = load_real(&path, &options, &mut go).unwrap();
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(one.install(|| load_real(&path, &options, &mut go).unwrap()), all);
}

#[test]
fn what_cannot_work_is_said() {
    let wrong = RealOptions { size: 3, ..RealOptions::default() };
    let path = Path::new("none.mp4");
    assert!(matches!(load_real(path, &wrong, &mut go), Err(CaptureError::Option { name: "size", .. })));
    let wrong = RealOptions { seconds: f64::NAN, ..RealOptions::default() };
    assert!(matches!(load_real(path, &wrong, &mut go), Err(CaptureError::Option { name: "seconds", .. })));
    let Some(clip) = real_clip() else { return };
    let missing = load_real(path, &RealOptions::default(), &mut go);
    assert!(matches!(missing, Err(CaptureError::Video(VideoError::Missing { .. }))));
    let stopped = load_real(&clip, &RealOptions::default(), &mut |_| ControlFlow::Break(()));
    assert!(matches!(stopped, Err(CaptureError::Cancelled)));
    let folder = tempfile::tempdir().unwrap();
    let file = std::fs::File::create(folder.path().join("0.png")).unwrap();
    let mut encoder = png::Encoder::new(file, 64, 64);
    encoder.set_color(png::ColorType::Rgb);
    encoder.write_header().unwrap().write_image_data(&[90; 64 * 64 * 3]).unwrap();
    let faceless = load_real(folder.path(), &RealOptions::default(), &mut go);
    assert!(matches!(faceless, Err(CaptureError::NoFace { frames: 1, .. })));
}

/// Writes the sheet asked for by `HEARTIAN_LOOK`.
fn look(recording: &RealRecording) {
    let Some(path) = std::env::var_os("HEARTIAN_LOOK") else { return };
    let RealRecording { clip, observations, .. } = recording;
    let size = clip.width;
    let picks: Vec<usize> = (0..4).map(|k| k * (clip.len() - 1) / 3).collect();
    let mut sheet = Rgb8Image::filled(size * picks.len(), size * 4, [0; 3]);
    for (column, &frame) in picks.iter().enumerate() {
        let mut picture = Rgb8Image { width: size, height: size, data: clip.frame(frame).to_vec() };
        for (row, ground) in [(1, [0.0f32; 3]), (2, [255.0, 0.0, 255.0]), (3, [255.0; 3])] {
            let mut over = picture.clone();
            for (i, alpha) in clip.frame_alpha(frame).iter().enumerate() {
                let a = f32::from(*alpha) / 255.0;
                (0..3).for_each(|c| {
                    over.data[3 * i + c] = (a * f32::from(over.data[3 * i + c]) + (1.0 - a) * ground[c]) as u8
                });
            }
            sheet.paste(&over, column * size, row * size);
        }
        for landmark in observations.frame(frame) {
            let [x, y] = landmark.position_px;
            picture.set_pixel(x.max(0.0) as usize, y.max(0.0) as usize, [0, 255, 0]);
        }
        sheet.paste(&picture, column * size, 0);
    }
    let mut encoder = png::Encoder::new(std::fs::File::create(path).unwrap(), sheet.width as u32, sheet.height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.write_header().unwrap().write_image_data(&sheet.data).unwrap();
}

/// The clip panned over by the reader's own crop is nearly the clip held still: the head sits in the middle of every frame.
#[test]
fn a_crop_that_follows_keeps_the_head_in_the_middle() {
    let Some(path) = real_clip() else { return };
    let options = |crop| RealOptions { seconds: 3.0, size: 64, matte: false, crop, ..RealOptions::default() };
    let [fixed, following] =
        [CropMotion::Fixed, CropMotion::Following].map(|crop| load_real(&path, &options(crop), &mut go).unwrap());
    let wander = |recording: &RealRecording| {
        let nose = |frame: usize| recording.observations.frame(frame).nth(1).unwrap().position_px[0];
        let noses: Vec<f32> = (0..recording.clip.len()).map(nose).collect();
        let mean = noses.iter().sum::<f32>() / noses.len() as f32;
        (noses.iter().map(|x| (x - mean).powi(2)).sum::<f32>() / noses.len() as f32).sqrt()
    };
    println!("side {} and {}", fixed.squares[0].side_px, following.squares[0].side_px);
    println!("nose wanders {} px fixed, {} px following", wander(&fixed), wander(&following));
    assert!(following.squares[0].side_px <= fixed.squares[0].side_px);
    assert!(wander(&following) < wander(&fixed));
    assert_eq!(fixed.clip.len(), following.clip.len());
}
