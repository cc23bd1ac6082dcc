//! The tracker against motion it was not told: exact Jacobians, accuracy under noise and dropouts, and bad input.

use std::f64::consts::TAU;

use glam::{DQuat, Vec3};

use super::frame::{Shared, linearised};
use super::points::rotation;
use super::*;
use crate::observations::Landmark;

/// A small seeded generator (SplitMix64).
pub struct Random(pub u64);

impl Random {
    pub fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.uniform()).ln()).sqrt() * (TAU * self.uniform()).cos()
    }
}

/// A talking, blinking, nodding head and what a noisy detector sees of it.
pub struct Scene {
    pub poses: Vec<FramePose>,
    pub observations: Observations,
}

/// 256² pixels, eye corners about 70 pixels apart.
pub fn scene(head: &HeadModel, frames: usize, (noise_px, dropout): (f64, f64), seed: u64) -> Result<Scene, FaceError> {
    let mut random = Random(seed);
    let identity: Vec<f32> = (0..head.identity.count).map(|_| (0.7 * random.normal()) as f32).collect();
    let person = head.with_identity(&identity);
    let camera = Camera::at_origin(256, 256, 307.2);
    let phases: Vec<f64> = (0..head.expression.count + 4).map(|_| TAU * random.uniform()).collect();
    let times: Vec<f64> = (0..frames).map(|t| t as f64 / 30.0).collect();
    let (mut poses, mut seen) = (Vec::new(), Vec::new());
    for &time in &times {
        let wave = |hertz: f64, phase: f64| (TAU * hertz * time + phase).sin();
        let mut pose = FramePose::rest(head.expression.count);
        pose.rotation = [0.12 * wave(0.35, phases[0]), 0.25 * wave(0.22, phases[1]), 0.06 * wave(0.3, phases[2])]
            .map(|angle| angle as f32);
        pose.translation = [0.01 * wave(0.3, 1.0) as f32, 0.0, -0.40 + 0.01 * wave(0.1, 0.0) as f32];
        pose.jaw[0] = (0.10 * (1.0 + wave(1.7, phases[3])) * (0.5 + 0.5 * wave(0.4, 0.0))) as f32;
        for (value, phase) in pose.expression.iter_mut().zip(&phases[4..]) {
            *value = (0.35 * wave(0.5, *phase)) as f32;
        }
        let blink = (-((time % 1.7 - 0.8) / 0.07).powi(2)).exp() as f32;
        pose.eyelids = [blink; 2];
        let vertices = person.pose(&pose);
        let landmarks = head.landmarks.iter().filter_map(|anchor| {
            let pixel = camera.project(Vec3::from_array(person.landmark_position(anchor, &vertices)))?;
            let noisy = [pixel.x, pixel.y].map(|value| value + (noise_px * random.normal()) as f32);
            (random.uniform() >= dropout).then_some(Landmark { index: anchor.index, position_px: noisy, weight: 1.0 })
        });
        seen.push(Some(landmarks.collect()));
        poses.push(pose);
    }
    for frame in seen.iter_mut().skip(frames / 2).take(frames / 20) {
        *frame = None;
    }
    Ok(Scene { poses, observations: Observations::new(256, 256, times, seen)? })
}

pub fn silent(_: Progress) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len() as f64;
    let (ma, mb) = (mean(a), mean(b));
    let sum = |f: &dyn Fn(f64, f64) -> f64| a.iter().zip(b).map(|(x, y)| f(x - ma, y - mb)).sum::<f64>();
    sum(&|x, y| x * y) / (sum(&|x, _| x * x) * sum(&|_, y| y * y)).sqrt()
}

#[test]
fn the_jacobian_is_the_derivative() -> Result<(), FaceError> {
    let head = HeadModel::procedural();
    let scene = scene(&head, 1, (3.0, 0.0), 3)?;
    let points = Points::new(&head);
    let seen = seen(&points, &scene.observations, 0);
    let mut random = Random(11);
    let identity: Vec<f64> = (0..points.identity_count()).map(|_| random.normal()).collect();
    let mut state = State::rest(points.expression_count());
    state.rotation = rotation(DVec3::new(0.2, -0.3, 0.1));
    state.translation = DVec3::new(0.02, 0.01, -0.5);
    state.jaw = DVec3::new(0.2, 0.03, -0.02);
    state.expression.iter_mut().for_each(|value| *value = 0.4 * random.normal());
    state.eyelids = [0.4, 0.6];
    let lens = Lens { focal: 300.0, centre: DVec2::splat(128.0) };
    // A wide scale keeps the robust weights at 1, so that rows are plain residuals.
    let shared = Shared { identity: points.identity_count(), focal: true };
    let residuals = |state: &State, identity: &[f64], lens: Lens| -> Option<super::linear::Design> {
        let shape = points.shape(identity);
        linearised(&Setting { points: &points, shape: &shape, lens, scale_px: 1e5, prior: &[] }, &seen, state, shared)
    };
    let Some(design) = residuals(&state, &identity, lens) else { return Err(FaceError::Cancelled) };
    let own = state.unknowns();
    let h = 1e-5;
    for k in 0..own + shared.count() {
        let moved = |sign: f64| {
            let (mut state, mut identity, mut lens) = (state.clone(), identity.clone(), lens);
            if k < own {
                let mut step = vec![0.0; own];
                step[k] = sign * h;
                state = state.stepped(&step);
            } else if k < own + identity.len() {
                identity[k - own] += sign * h;
            } else {
                lens.focal *= (sign * h).exp();
            }
            residuals(&state, &identity, lens)
        };
        let (Some(after), Some(before)) = (moved(1.0), moved(-1.0)) else { return Err(FaceError::Cancelled) };
        let largest = design.column(k).iter().fold(0.0_f64, |a, b| a.max(b.abs()));
        for (row, exact) in design.column(k).iter().enumerate() {
            let slope = (after.column(design.width)[row] - before.column(design.width)[row]) / (2.0 * h);
            assert!((slope - exact).abs() <= 2e-4 * largest + 1e-12, "unknown {k}, row {row}: {slope} {exact}");
        }
    }
    Ok(())
}

#[test]
fn it_follows_a_talking_head_through_noise_and_dropouts() -> Result<(), FaceError> {
    let head = HeadModel::procedural();
    let scene = scene(&head, 180, (0.7, 0.05), 42)?;
    let track = track(&head, &scene.observations, &TrackOptions::default(), &mut silent)?;
    let turn = |v: [f32; 3]| DQuat::from_scaled_axis(DVec3::from_array(v.map(f64::from)));
    // Where the head's own frame sits is a matter of its identity: compare turns from the first frame.
    let relative = |poses: &[FramePose], t: usize| turn(poses[t].rotation) * turn(poses[0].rotation).inverse();
    let frames = scene.poses.len();
    let (mut turned, mut straight) = (0.0, 0.0);
    for t in 0..frames {
        turned += relative(&scene.poses, t).angle_between(relative(&track.frames, t)).to_degrees() / frames as f64;
        straight +=
            turn(scene.poses[t].rotation).angle_between(turn(track.frames[t].rotation)).to_degrees() / frames as f64;
    }
    let jaw = |poses: &[FramePose]| poses.iter().map(|pose| f64::from(pose.jaw[0])).collect::<Vec<f64>>();
    let jaw = correlation(&jaw(&scene.poses), &jaw(&track.frames));
    let blinks = |pose: &FramePose| pose.eyelids[0] + pose.eyelids[1] > 1.0;
    let (mut hit, mut wrong) = (0.0, 0.0);
    for (truth, found) in scene.poses.iter().zip(&track.frames).filter(|(_, found)| found.fitted) {
        match (blinks(truth), blinks(found)) {
            (true, true) => hit += 1.0,
            (false, false) => {}
            _ => wrong += 1.0,
        }
    }
    let f1 = 2.0 * hit / (2.0 * hit + wrong);
    println!(
        "rotation {turned:.2}° from the first frame, {straight:.2}° absolute; jaw r {jaw:.3}; blink F1 {f1:.3}; \
         landmark rms {:.2} px of {:.1}",
        track.landmark_rms_px, track.interocular_px
    );
    assert!(straight <= 1.5 && turned <= 1.5);
    assert!(jaw >= 0.95);
    assert!(f1 >= 0.95);
    assert!(track.landmark_rms_px <= 0.03 * track.interocular_px);
    assert!(track.frames[91].is_finite() && !track.frames[91].fitted && track.frames[0].fitted);
    Ok(())
}

/// What a detector sees of the template turned by `yaw`, exactly.
fn turned(head: &HeadModel, yaw: f64) -> Vec<Landmark> {
    let camera = Camera::at_origin(256, 256, 563.2);
    let pose = FramePose { rotation: [0.0, yaw as f32, 0.0], translation: [0.0, 0.0, -0.8], ..FramePose::rest(0) };
    let vertices = head.pose(&pose);
    let landmark = |anchor: &crate::LandmarkAnchor| {
        let pixel = camera.project(Vec3::from_array(head.landmark_position(anchor, &vertices)))?;
        Some(Landmark { index: anchor.index, position_px: pixel.to_array(), weight: 1.0 })
    };
    head.landmarks.iter().filter_map(landmark).collect()
}

#[test]
fn a_head_is_followed_into_profile_and_what_is_no_face_becomes_a_gap() -> Result<(), FaceError> {
    let head = HeadModel::procedural();
    let yaw = |t: usize| 1.35 * (TAU * t as f64 / 120.0).sin();
    let mut frames: Vec<Option<Vec<Landmark>>> = (0..60).map(|t| Some(turned(&head, yaw(t)))).collect();
    let mut random = Random(9);
    for landmark in frames[40..43].iter_mut().flatten().flatten() {
        landmark.position_px = [0, 1].map(|_| (128.0 + 60.0 * random.normal()) as f32);
    }
    let observations = Observations::new(256, 256, (0..60).map(|t| t as f64 / 30.0).collect(), frames)?;
    let options = TrackOptions { focal_px: Some(563.2), ..TrackOptions::default() };
    let found = track(&head, &observations, &options, &mut silent)?;
    for (t, pose) in found.frames.iter().enumerate() {
        assert_eq!(pose.fitted, !(40..43).contains(&t), "frame {t}");
        let error = (f64::from(pose.rotation[1]) - yaw(t)).to_degrees();
        assert!(error.abs() < 3.0, "frame {t}: {error}");
    }
    Ok(())
}

/// Still frames of the template, for tests of input.
fn frames_of(head: &HeadModel, count: usize) -> Vec<Option<Vec<Landmark>>> {
    let camera = Camera::at_origin(128, 128, 150.0);
    let pose = FramePose { translation: [0.0, 0.0, -0.5], ..FramePose::rest(0) };
    let vertices = head.pose(&pose);
    let landmark = |anchor: &crate::LandmarkAnchor| {
        let pixel = camera.project(Vec3::from_array(head.landmark_position(anchor, &vertices)))?;
        Some(Landmark { index: anchor.index, position_px: pixel.to_array(), weight: 1.0 })
    };
    vec![Some(head.landmarks.iter().filter_map(landmark).collect()); count]
}

fn times(count: usize) -> Vec<f64> {
    (0..count).map(|t| t as f64 / 25.0).collect()
}

fn tracked(head: &HeadModel, frames: Vec<Option<Vec<Landmark>>>) -> Result<Track, FaceError> {
    let observations = Observations::new(128, 128, times(frames.len()), frames)?;
    track(head, &observations, &TrackOptions::default(), &mut silent)
}

#[test]
fn bad_input_has_a_definite_answer() -> Result<(), FaceError> {
    let head = HeadModel::procedural();
    let good = frames_of(&head, 1);
    let one = tracked(&head, good.clone())?;
    assert!(one.frames.len() == 1 && one.landmark_rms_px < 0.2, "one frame is enough: {}", one.landmark_rms_px);
    assert!(matches!(tracked(&head, vec![None, Some(vec![])]), Err(FaceError::NoFace { frames: 2 })));
    let few = vec![good[0].as_ref().map(|frame| frame[..5].to_vec())];
    assert!(matches!(tracked(&head, few), Err(FaceError::TooFewLandmarks { found: 5, .. })));
    let mut broken = good.clone();
    broken[0].iter_mut().flatten().take(1).for_each(|landmark| landmark.position_px[1] = f32::NAN);
    assert!(matches!(tracked(&head, broken), Err(FaceError::Landmark { what: "y", .. })));
    let twice = vec![good[0].as_ref().map(|frame| vec![frame[3]; 2])];
    assert!(matches!(tracked(&head, twice), Err(FaceError::Observations(_))));
    assert!(matches!(Observations::new(0, 9, times(1), good.clone()), Err(FaceError::ImageSize { .. })));
    assert!(matches!(Observations::new(9, 9, vec![], vec![]), Err(FaceError::Observations(_))));
    assert!(matches!(Observations::new(9, 9, vec![1.0, 1.0], frames_of(&head, 2)), Err(FaceError::Observations(_))));
    let observations = Observations::new(128, 128, times(1), good)?;
    let wild = TrackOptions { focal_px: Some(f64::NAN), ..TrackOptions::default() };
    assert!(matches!(track(&head, &observations, &wild, &mut silent), Err(FaceError::Option { .. })));
    let stop = &mut |_| ControlFlow::Break(());
    assert!(matches!(track(&head, &observations, &TrackOptions::default(), stop), Err(FaceError::Cancelled)));
    // Landmarks of no face at all: an answer or a typed error, never a panic.
    let mut random = Random(5);
    let noise = vec![Some(
        head.landmarks
            .iter()
            .map(|anchor| Landmark {
                index: anchor.index,
                position_px: [0, 1].map(|_| (1e6 * random.normal()) as f32),
                weight: 1.0,
            })
            .collect(),
    )];
    if let Ok(track) = tracked(&head, noise) {
        assert!(track.frames.iter().all(FramePose::is_finite));
    }
    let point = vec![good_point(&head)];
    assert!(tracked(&head, point).is_err(), "all landmarks in one place");
    Ok(())
}

fn good_point(head: &HeadModel) -> Option<Vec<Landmark>> {
    let landmark = |index: u32| Landmark { index, position_px: [64.0, 64.0], weight: 1.0 };
    Some(head.landmarks.iter().map(|anchor| landmark(anchor.index)).collect())
}

#[test]
fn threads_do_not_change_a_bit_and_a_track_travels() -> Result<(), Box<dyn std::error::Error>> {
    use heartian_artifact::{Artifact, BundleReader};
    let head = HeadModel::procedural();
    let scene = scene(&head, 30, (0.5, 0.05), 7)?;
    let run = |threads: usize| -> Result<Vec<u8>, Box<dyn std::error::Error + Send + Sync>> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        let options = TrackOptions { key_frames: 6, ..TrackOptions::default() };
        let track = pool.install(|| track(&head, &scene.observations, &options, &mut silent))?;
        Ok(track.to_bundle()?.to_bytes()?)
    };
    let (one, three) = (run(1), run(3));
    let (one, three) = (one.map_err(|e| e.to_string())?, three.map_err(|e| e.to_string())?);
    assert!(one == three);
    let track = Track::from_bundle(BundleReader::new(&one)?)?;
    assert_eq!(track.to_bundle()?.to_bytes()?, one);
    let bytes = scene.observations.to_bundle()?.to_bytes()?;
    assert_eq!(Observations::from_bundle(BundleReader::new(&bytes)?)?, scene.observations);
    Ok(())
}
