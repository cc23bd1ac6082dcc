//! The fit as a whole, on the ball: quality, determinism, what is refused, and what a render and its linear map promise.

mod device;
mod poison;
mod shaders;
mod shown;

use std::ops::ControlFlow;

use heartian_artifact::{Artifact, ArtifactError, BundleReader};
use heartian_face::Track;
use heartian_space::{Clip, Host, Modulation, Progress, Sequence, Skin};
use heartian_splat::{Environment, PhotometricWeights};

use crate::phantom;
use crate::picture::{AlbedoOffsets, Features, Scene};
use crate::{
    Avatar, AvatarError, FrozenRender, OperatorOptions, RenderOptions, SkinOptions, TrainOptions, TrainReport,
    albedo_operator, evaluate, relight, render_clip, select_skin, train,
};

fn quick() -> TrainOptions {
    TrainOptions { gaussians: 900, steps: 160, ..TrainOptions::default() }
}

fn onward(_: Progress) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

fn fitted() -> Result<(Clip, Track, Avatar, TrainReport), AvatarError> {
    let (clip, track) = phantom::recording(64, 24);
    let (avatar, report) = train(&clip, &track, &quick(), &mut onward)?;
    Ok((clip, track, avatar, report))
}

fn first_skin(avatar: &Avatar, track: &Track) -> Result<Skin, AvatarError> {
    select_skin(avatar, &track.baked_head(), &SkinOptions::default())
}

#[test]
fn a_short_fit_already_looks_like_the_recording_where_it_was_not_shown() -> Result<(), AvatarError> {
    let (clip, track, avatar, report) = fitted()?;
    let held_out = report.held_out.map_or(0.0, |score| score.psnr_db);
    assert!(held_out > 26.0, "{report:?}");
    assert!(avatar.len() <= 900 && avatar.training_frames == 20);
    let rendered = render_clip(&avatar, &track, &RenderOptions { label: "baseline_rendered", ..Default::default() })?;
    let again = evaluate(&rendered, &clip, &[20, 21, 22, 23])?;
    assert!((again.psnr_db - held_out).abs() < 1e-9, "the report is what anyone would measure");
    assert!(evaluate(&rendered, &clip, &[24]).is_err() && evaluate(&rendered, &clip, &[]).is_err());
    Ok(())
}

#[test]
fn the_same_fit_at_any_number_of_threads() -> Result<(), Box<dyn std::error::Error>> {
    let (clip, track) = phantom::recording(48, 12);
    let options = TrainOptions { steps: 60, gaussians: 400, ..quick() };
    let run = || train(&clip, &track, &options, &mut onward);
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build()?.install(run)?;
    let three = rayon::ThreadPoolBuilder::new().num_threads(3).build()?.install(run)?;
    assert!(one.0 == three.0);
    let other = train(&clip, &track, &TrainOptions { seed: 2, ..options }, &mut onward)?;
    assert!(one.0 != other.0, "the seed matters");
    Ok(())
}

/// Keeps every state, and asks to stop after some step.
#[derive(Default)]
struct Stopper {
    kept: Option<Vec<u8>>,
    stop_after: u64,
    first: Option<u64>,
}

impl Host for Stopper {
    fn progress(&mut self, report: Progress) -> ControlFlow<()> {
        self.first.get_or_insert(report.step);
        if report.step == self.stop_after { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
    fn resume(&mut self) -> Option<Vec<u8>> {
        self.kept.clone()
    }
    fn checkpoint(&mut self, state: &mut dyn FnMut() -> Option<Vec<u8>>) {
        self.kept = state();
    }
}

#[test]
fn a_fit_stopped_anywhere_and_resumed_gives_the_same_bytes() -> Result<(), AvatarError> {
    let (clip, track) = phantom::recording(48, 12);
    let options = TrainOptions { steps: 60, gaussians: 400, ..quick() };
    let whole = train(&clip, &track, &options, &mut onward)?;
    // In the warm-up, before and after the light, between density rounds, near the end.
    let mut host = Stopper { kept: None, stop_after: 0, first: None };
    for stop_after in [1, 7, 17, 18, 19, 33, 59] {
        let before = host.stop_after;
        host = Stopper { stop_after, first: None, ..host };
        assert!(matches!(train(&clip, &track, &options, &mut host), Err(AvatarError::Cancelled)));
        assert_eq!(host.first, Some(before + 1), "it goes on where it was");
    }
    host.stop_after = 0;
    assert!(train(&clip, &track, &options, &mut host)? == whole);
    assert!(train(&clip, &track, &options, &mut host)? == whole, "a state of the end is a state too");
    Ok(())
}

#[test]
fn a_state_that_does_not_fit_is_ignored() -> Result<(), AvatarError> {
    let (clip, track) = phantom::recording(48, 12);
    let options = TrainOptions { steps: 20, gaussians: 400, ..quick() };
    let whole = train(&clip, &track, &options, &mut onward)?;
    let mut other = Stopper { kept: None, stop_after: 10, first: None };
    let (short, short_track) = phantom::recording(48, 8);
    assert!(train(&short, &short_track, &options, &mut other).is_err());
    for kept in [other.kept, Some(Vec::new()), Some(b"no state at all".to_vec())] {
        let mut host = Stopper { kept, stop_after: 0, first: None };
        assert!(train(&clip, &track, &options, &mut host)? == whole);
        assert_eq!(host.first, Some(1));
    }
    Ok(())
}

#[test]
fn held_out_frames_are_never_looked_at() -> Result<(), AvatarError> {
    let (clip, track) = phantom::recording(48, 12);
    let options = TrainOptions { steps: 40, gaussians: 400, ..quick() };
    let (avatar, _) = train(&clip, &track, &options, &mut onward)?;
    let mut spoiled = clip.clone();
    let size = 48 * 48;
    spoiled.frames[3 * size * avatar.training_frames..].fill(77);
    spoiled.alpha[size * avatar.training_frames..].fill(255);
    assert!(train(&spoiled, &track, &options, &mut onward)?.0 == avatar);
    Ok(())
}

#[test]
fn a_modulation_of_nothing_changes_no_byte_and_of_something_only_green() -> Result<(), AvatarError> {
    let (_, track, avatar, _) = fitted()?;
    let skin = first_skin(&avatar, &track)?;
    let frames = track.frames.len();
    let modulation = |offset: f32| Modulation {
        gaussians: skin.gaussians.clone(),
        times_seconds: track.times_seconds.clone(),
        offsets: vec![offset; skin.gaussians.len() * frames],
        ..Modulation::default()
    };
    let render = |modulation: Option<&Modulation>| {
        render_clip(&avatar, &track, &RenderOptions { label: "rendered", modulation, ..Default::default() })
    };
    let plain = render(None)?;
    assert!(render(Some(&modulation(0.0)))? == plain);
    let brighter = render(Some(&modulation(0.05)))?;
    let sum = |clip: &Clip, channel: usize| -> u64 {
        clip.frames.iter().skip(channel).step_by(3).map(|v| u64::from(*v)).sum()
    };
    assert!(sum(&brighter, 1) > sum(&plain, 1) + 1000);
    assert_eq!((sum(&brighter, 0), sum(&brighter, 2)), (sum(&plain, 0), sum(&plain, 2)));
    let short = Modulation { times_seconds: vec![0.0], ..modulation(0.0) };
    assert!(matches!(render(Some(&short)), Err(AvatarError::Mismatch { .. })));
    let mut foreign = modulation(0.0);
    if let Some(last) = foreign.gaussians.last_mut() {
        *last = 1_000_000;
    }
    assert!(matches!(render(Some(&foreign)), Err(AvatarError::Index { .. })));
    Ok(())
}

#[test]
fn the_linear_map_predicts_the_modulated_render() -> Result<(), AvatarError> {
    let (clip, track, avatar, _) = fitted()?;
    let skin = first_skin(&avatar, &track)?;
    let options = OperatorOptions { cell_px: 4, ..OperatorOptions::default() };
    let operator = albedo_operator(&avatar, &skin, &clip, &options, &mut onward)?;
    assert_eq!(operator.frames.len(), avatar.training_frames);
    // A different small offset for every column; small enough that no albedo is clamped.
    let offsets: Vec<f32> = (0..skin.gaussians.len()).map(|i| 0.01 * ((i * 37 % 11) as f32 / 5.0 - 1.0)).collect();
    let frame = 3;
    let state = &avatar.states[operator.frames[frame] as usize];
    let mut scene = Scene::new(&avatar.canonical, &avatar.motion.motion(state), &avatar.camera, Features::Materials);
    scene.add_albedo(AlbedoOffsets { gaussians: &skin.gaussians, green: &offsets, red_blue: &[] });
    let picture = scene.picture(&avatar.camera)?;
    let linear = heartian_splat::shade(&picture.frame, &avatar.camera, &avatar.environment)?;
    let mean: Vec<f32> = (0..256)
        .map(|cell| {
            let (left, top) = (cell % 16 * 4, cell / 16 * 4);
            (0..16).map(|i| linear[64 * 64 + (top + i / 4) * 64 + left + i % 4]).sum::<f32>() / 16.0
        })
        .collect();
    let mut rows = operator.rows_of(frame);
    assert!(rows.len() > 20);
    assert!(rows.all(|row| {
        let change: f32 = operator.row(row).map(|(column, weight)| weight * offsets[column]).sum();
        let predicted = operator.base[row] + change;
        change != 0.0 && mean.iter().any(|mean| (mean - predicted).abs() < 2e-6)
    }));
    let thin = OperatorOptions { most_entries: 1, ..options };
    assert_eq!(albedo_operator(&avatar, &skin, &clip, &thin, &mut onward)?.frames.len(), 1);
    Ok(())
}

#[test]
fn the_rendered_loss_of_stage_2_has_the_slope_it_says() -> Result<(), AvatarError> {
    let (clip, track, avatar, _) = fitted()?;
    let skin = first_skin(&avatar, &track)?;
    let count = skin.gaussians.len();
    // D-SSIM is smooth; the absolute error's kinks would need steps below an f32's rounding.
    let smooth = PhotometricWeights { l1: 0.0, ..PhotometricWeights::default() };
    let frozen = FrozenRender::new(&avatar, &skin, &clip)?.with_weights(smooth);
    let mut gradient = vec![0.0; count];
    frozen.loss(3, &vec![0.002; count], &mut gradient)?;
    let direction: Vec<f32> = (0..count).map(|i| if i % 3 == 0 { 1.0 } else { 0.4 }).collect();
    let along = |step: f32| {
        let offsets: Vec<f32> = direction.iter().map(|d| 0.002 + step * d).collect();
        frozen.loss(3, &offsets, &mut vec![0.0; count])
    };
    let found = (along(2e-3)? - along(-2e-3)?) / 4e-3;
    let expected: f64 = gradient.iter().zip(&direction).map(|(g, d)| f64::from(*g) * f64::from(*d)).sum();
    assert!((found / expected - 1.0).abs() < 0.03, "{found} against {expected}");
    assert!(frozen.loss(clip.len(), &vec![0.0; count], &mut gradient).is_err());
    assert!(frozen.loss(0, &[0.0], &mut gradient).is_err());
    Ok(())
}

#[test]
fn light_scales_the_picture_and_the_avatar_survives_the_disk() -> Result<(), Box<dyn std::error::Error>> {
    let (_, track, avatar, _) = fitted()?;
    let bytes = avatar.to_bundle()?.to_bytes()?;
    assert!(Avatar::from_bundle(BundleReader::new(&bytes)?)? == avatar);
    let total = |avatar: &Avatar| -> Result<u64, AvatarError> {
        let clip = render_clip(avatar, &track, &RenderOptions::default())?;
        Ok(clip.frames.iter().map(|v| u64::from(*v)).sum())
    };
    let (dim, bright) = (Environment::uniform([0.2; 3]), Environment::uniform([0.6; 3]));
    assert!(total(&relight(&avatar, dim))? < total(&relight(&avatar, bright))?);
    let mut broken = avatar;
    broken.canonical.positions[5] = f32::NAN;
    let bytes = broken.to_bundle()?.to_bytes()?;
    assert!(matches!(Avatar::from_bundle(BundleReader::new(&bytes)?), Err(ArtifactError::Invalid(_))));
    Ok(())
}

#[test]
fn skin_is_in_front_near_the_mesh_and_never_silently_empty() -> Result<(), AvatarError> {
    let (_, track, avatar, _) = fitted()?;
    let skin = first_skin(&avatar, &track)?;
    assert!(skin.gaussians.len() > 50);
    assert!(skin.distances_metres.iter().all(|d| (0.0..=0.01).contains(d)));
    assert!(skin.gaussians.iter().all(|&i| avatar.canonical.position(i as usize)[2] > 0.0));
    assert!(skin.positions.iter().flatten().all(|p| (-1.0..=1.0).contains(p)));
    let far = SkinOptions { least_facing: 0.9999, ..SkinOptions::default() };
    let head = track.baked_head();
    assert!(matches!(select_skin(&avatar, &head, &far), Err(AvatarError::NoSkin { .. })));
    let zero = SkinOptions { threshold_metres: 0.0, ..SkinOptions::default() };
    assert!(matches!(select_skin(&avatar, &head, &zero), Err(AvatarError::Option { .. })));
    Ok(())
}

#[test]
fn bad_input_has_one_clear_answer() {
    let (clip, track) = phantom::recording(32, 8);
    let attempt = |clip: &Clip, track: &Track, options: &TrainOptions| train(clip, track, options, &mut onward);
    let options = TrainOptions { steps: 2, gaussians: 200, ..quick() };
    assert!(attempt(&clip, &track, &options).is_ok());
    let mut poisoned = track.clone();
    poisoned.frames[3].translation[2] = f32::NAN;
    assert!(matches!(attempt(&clip, &poisoned, &options), Err(AvatarError::PoseNotFinite { frame: 3 })));
    let mut short = track.clone();
    short.frames.pop();
    assert!(matches!(attempt(&clip, &short, &options), Err(AvatarError::Mismatch { .. })));
    let mut away = track.clone();
    away.frames.iter_mut().for_each(|pose| pose.translation[2] = 5.0);
    assert!(matches!(attempt(&clip, &away, &options), Err(AvatarError::TooLittle { .. })));
    let none = TrainOptions { gaussians: 0, ..options.clone() };
    assert!(matches!(attempt(&clip, &track, &none), Err(AvatarError::Option { name: "gaussians", .. })));
    let (brief, brief_track) = phantom::recording(32, 3);
    assert!(matches!(attempt(&brief, &brief_track, &options), Err(AvatarError::TooLittle { .. })));
    let stopped = train(&clip, &track, &options, &mut |_: Progress| ControlFlow::Break(()));
    assert!(matches!(stopped, Err(AvatarError::Cancelled)));
}

#[test]
fn black_white_and_unmatted_frames_leave_every_parameter_finite() -> Result<(), AvatarError> {
    let (clip, track) = phantom::recording(32, 8);
    for (color, alpha) in [(0, 255), (255, 255), (128, 0), (255, 1)] {
        let sequence = Sequence {
            frames: vec![color; clip.frames.len()],
            alpha: vec![alpha; clip.alpha.len()],
            times_seconds: clip.times_seconds.clone(),
        };
        let flat = Clip::new("input", 32, 32, sequence)?;
        let options = TrainOptions { steps: 30, gaussians: 200, ..quick() };
        let (avatar, report) = train(&flat, &track, &options, &mut onward)?;
        assert_eq!(avatar.canonical.first_not_finite(), None);
        assert!(avatar.environment.radiance.iter().flatten().all(|v| v.is_finite()));
        assert!(avatar.states.iter().all(|state| state.pose.iter().all(|v| v.is_finite())));
        assert!(report.training.psnr_db.is_finite());
    }
    Ok(())
}
