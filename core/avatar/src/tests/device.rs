//! The fit on a device against the CPU's: each kernel against its Rust text, one step, many steps, and that the result does
//! not depend on when anything was seen.
//!
//! On whatever adapter there is, a software one on most machines of CI; where there is none the tests say that they are
//! skipped.

use std::ops::ControlFlow;
use std::sync::{Arc, OnceLock};

use heartian_face::Track;
use heartian_space::{Camera, Clip, Host, Modulation, Progress, Sequence};
use heartian_splat::{Device, FitShape, Gpu, GpuBuffer, GpuFitter, GpuFrames, PhotometricWeights, SceneGradients};

use super::{Stopper, onward, quick};
use crate::canonical::Canonical;
use crate::coherent::{Neighbours, hold_flat};
use crate::density::Statistics;
use crate::device::{Given, Kernels, Values, View};
use crate::ground::Ground;
use crate::motion::FrameState;
use crate::optimiser::Rates;
use crate::picture::{Features, Scene};
use crate::refine::{RefineOptions, Refiner};
use crate::rig::{POSE_SIZE, Rig};
use crate::{Avatar, AvatarError, Motion, RenderOptions, TrainOptions, phantom, render_clip, train};

fn device() -> Option<&'static Arc<Gpu>> {
    static DEVICE: OnceLock<Option<Arc<Gpu>>> = OnceLock::new();
    let opened = DEVICE.get_or_init(|| Gpu::open(Device::Gpu).ok().flatten());
    if opened.is_none() {
        println!("skipped: no Vulkan, Metal or Direct3D 12 adapter, not even a software one, is here");
    }
    opened.as_ref()
}

fn noise(seed: u32) -> impl FnMut() -> f32 {
    let mut state = seed;
    move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1u32 << 23) as f32 - 1.0
    }
}

/// Relative distance of two lists in the mean square.
fn off(found: &[f32], exact: impl IntoIterator<Item = f64>) -> f64 {
    let exact: Vec<f64> = exact.into_iter().collect();
    assert_eq!(found.len(), exact.len());
    let (mut error, mut size) = (0.0, 0.0);
    for (a, b) in found.iter().zip(exact) {
        error += (f64::from(*a) - b).powi(2);
        size += b * b;
    }
    (error / size.max(1e-300)).sqrt()
}

fn wide(values: &[f32]) -> impl Iterator<Item = f64> + '_ {
    values.iter().map(|v| f64::from(*v))
}

const COUNT: usize = 150;
const MODES: usize = 3;
const FRAMES: usize = 6;
const FRAME: usize = 2;

/// Gaussians, tracked poses with offsets, and a skeleton, all of noise.
struct Case {
    canonical: Canonical,
    refiner: Refiner,
    rig: Rig,
    camera: Camera,
    ground: Ground,
}

impl Case {
    fn new(turn: f64) -> Self {
        let mut next = noise(5);
        let mut canonical = Canonical::zeros(COUNT, MODES);
        for (group, size) in canonical.groups_mut().into_iter().zip([0.03, 0.4, 1.0, 2.0, 2.0, 2.0, 2.0, 0.01, 0.7]) {
            group.iter_mut().for_each(|v| *v = size * next());
        }
        canonical.log_scales.iter_mut().for_each(|v| *v -= 5.0);
        // One that no joint moves, one without a rotation.
        canonical.weights[..5].fill(-0.1);
        canonical.rotations[8..12].fill(0.0);
        let rig = Rig {
            joints: [[0.0; 3], [0.01, -0.08, -0.03], [0.0, -0.02, 0.01], [0.03, 0.03, 0.05], [-0.03, 0.03, 0.05]],
        };
        let states: Vec<FrameState> = (0..FRAMES)
            .map(|_| {
                let mut pose: [f64; POSE_SIZE] = std::array::from_fn(|_| turn * f64::from(next()));
                pose[5] -= 0.8;
                FrameState { pose, coefficients: (0..MODES).map(|_| next()).collect() }
            })
            .collect();
        let options = RefineOptions { pose_rates: [2e-3, 1e-3, 0.0, 1e-2, 2e-2, 2e-2], ..RefineOptions::default() };
        let mut refiner = Refiner::new(&states, FRAMES, options);
        for visit in 0..3 * FRAMES {
            refiner.step(visit % FRAMES, (0..POSE_SIZE + MODES).map(|_| f64::from(next())), 0.5);
        }
        let mut rest = canonical.clone();
        rest.groups_mut().into_iter().flatten().for_each(|v| *v += 0.01 * next());
        let doubt = (0..COUNT).map(|i| if i % 4 == 0 { 0.0 } else { 0.5 + 0.5 * next() }).collect();
        let ground = Ground { rest, doubt, kind: (0..COUNT).map(|i| u8::from(i % 3 == 0)).collect() };
        Self { canonical, refiner, rig, camera: Camera::at_origin(48, 40, 70.0), ground }
    }

    fn motion(&self) -> Motion {
        let state = self.refiner.state(FRAME);
        Motion { joints: self.rig.transforms(&state.pose), coefficients: state.coefficients }
    }
}

/// A case on a device.
struct There {
    gpu: Arc<Gpu>,
    values: Values,
    kernels: Kernels,
    scene: heartian_splat::GpuScene,
}

impl There {
    fn new(gpu: &Arc<Gpu>, case: &Case, is_lit: bool) -> Result<Self, AvatarError> {
        let given = Given {
            canonical: &case.canonical,
            refiner: &case.refiner,
            rig: &case.rig,
            statistics: &Statistics::new(COUNT),
            neighbours: &Neighbours::new(&case.canonical),
            ground: &case.ground,
        };
        let values = Values::new(gpu, &given)?;
        let camera = &case.camera;
        let weights = PhotometricWeights::default();
        let shape = FitShape { count: COUNT, camera, is_lit, weights, mask_weight: 0.2, room: None };
        let scene = GpuFitter::new(gpu)?.reserve(&shape)?;
        let size = [camera.width, camera.height];
        let centre = camera.centre_in_world();
        let view = View { size, factor: 1, source_width: camera.width, is_lit, centre };
        let frames = GpuFrames::new(gpu, 1, camera.width * camera.height, 0)?;
        let kernels = values.record(&scene, &frames, &view)?;
        values.set_step(FRAME, 0.5, [1; 9], &Rates([0.0; 9]))?;
        Ok(Self { gpu: Arc::clone(gpu), values, kernels, scene })
    }

    fn floats(&self, buffer: &GpuBuffer) -> Result<Vec<f32>, AvatarError> {
        let words = self.gpu.start_reading(&[buffer]).take(&self.gpu)?;
        Ok(words[0].iter().map(|word| f32::from_bits(*word)).collect())
    }
}

#[test]
fn posed_gaussians_and_all_gradients_are_those_of_the_rust_text() -> Result<(), AvatarError> {
    let Some(gpu) = device() else { return Ok(()) };
    // Small angles, usual ones, and turns past half a circle.
    for (turn, is_lit) in [(0.3, true), (2.5, true), (1e-3, false)] {
        let case = Case::new(turn);
        let motion = case.motion();
        let there = There::new(gpu, &case, is_lit)?;
        there.kernels.before.submit()?;
        let words = crate::device::motion_words(&motion);
        assert!(off(&there.floats(&there.values.motion)?, wide(&words)) < 1e-6, "pose at {turn}");
        let kind = if is_lit { Features::Materials } else { Features::Albedo };
        let scene = Scene::new(&case.canonical, &motion, &case.camera, kind);
        let view = scene.gaussians();
        let geometry = there.floats(&there.scene.geometry)?;
        let rows = (0..COUNT).flat_map(|i| {
            let ([x, y, z], [a, b, c]) = (view.means[i], view.scales[i]);
            let [qw, qx, qy, qz] = view.rotations[i];
            [x, y, z, view.opacities[i], a, b, c, 0.0, qw, qx, qy, qz].map(f64::from)
        });
        assert!(off(&geometry, rows) < 1e-5, "geometry at {turn}");
        assert!(off(&there.floats(&there.scene.features)?, wide(view.features)) < 1e-5, "features at {turn}");

        let mut next = noise(9);
        let channels = view.channels;
        let upstream = SceneGradients {
            means: (0..COUNT).map(|_| [next(), next(), next()]).collect(),
            scales: (0..COUNT).map(|_| [next(), next(), next()]).collect(),
            rotations: (0..COUNT).map(|_| [next(), next(), next(), next()]).collect(),
            opacities: (0..COUNT).map(|_| next()).collect(),
            features: (0..COUNT * channels).map(|_| next()).collect(),
            means_px: (0..COUNT).map(|_| [next(), next()]).collect(),
            weights: (0..COUNT).map(|_| next()).collect(),
            radii_px: vec![1.0; COUNT],
        };
        bring(&there, &upstream, channels)?;
        let mut statistics = Statistics::new(COUNT);
        (0..2).for_each(|_| statistics.add(&upstream));
        let mut gradient = Canonical::zeros(COUNT, MODES);
        let by_motion = scene.backward(upstream, &case.canonical, &motion, &mut gradient).motion;
        there.kernels.after.submit()?;
        let found = there.floats(there.values.adam.gradients())?;
        let mut at = 0;
        for (group, exact) in gradient.groups().into_iter().enumerate() {
            let own = &found[at..at + exact.len()];
            // The gradient of a quaternion of no length is huge, and would hide all others.
            let alone = if group == 2 { 8..12 } else { 0..0 };
            let rest = |values: &[f32]| [&values[..alone.start], &values[alone.end..]].concat();
            let huge = off(&own[alone.clone()], wide(&exact[alone.clone()]));
            let error = off(&rest(own), wide(&rest(exact))).max(huge);
            println!("gradients of group {group}, turns of {turn} rad: {error:.1e}");
            assert!(error < 1e-4, "group {group} at {turn}: {error:e}");
            at += exact.len();
        }
        let words = crate::device::motion_words(&Motion {
            joints: by_motion.joints,
            coefficients: by_motion.coefficients.iter().map(|c| *c as f32).collect(),
        });
        let on_motion = there.floats(&there.values.on_motion)?;
        let error = off(&on_motion, wide(&words));
        println!("gradient of the motion, turns of {turn} rad: {error:.1e}");
        assert!(error < 1e-4, "motion at {turn}: {error:e}");
        there.kernels.after.submit()?;
        assert_eq!(there.floats(&there.values.on_motion)?, on_motion, "the same sums again");
        let found = there.floats(&there.values.statistics)?;
        let exact = (0..COUNT).flat_map(|i| {
            let frames = statistics.frames[i] as f32;
            [statistics.gradient_sum[i], frames, statistics.most_pixels[i], 0.0].map(f64::from)
        });
        assert!(off(&found, exact) < 1e-5);
        let state = case.refiner.state(FRAME);
        let pose = case.rig.backward(&state.pose, &by_motion.joints);
        poses_move_alike(&there, case, pose.into_iter().chain(by_motion.coefficients))?;
    }
    Ok(())
}

/// Sets the gradients that the rasteriser gives.
fn bring(there: &There, upstream: &SceneGradients, channels: usize) -> Result<(), AvatarError> {
    let rows: Vec<f32> = (0..COUNT)
        .flat_map(|i| {
            let ([x, y, z], [a, b, c]) = (upstream.means[i], upstream.scales[i]);
            let ([qw, qx, qy, qz], [u, v]) = (upstream.rotations[i], upstream.means_px[i]);
            [x, y, z, upstream.opacities[i], a, b, c, upstream.weights[i], qw, qx, qy, qz, u, v, 1.0, 0.0]
        })
        .collect();
    there.scene.on_geometry.write_floats(0, &rows)?;
    let width = 4 * (channels / 4 + 1);
    for (i, row) in upstream.features.chunks(channels).enumerate() {
        there.scene.on_features.write_floats(width * i, row)?;
    }
    Ok(())
}

/// One step of a frame's pose, after which others of its frames are as before.
fn poses_move_alike(there: &There, case: Case, gradient: impl Iterator<Item = f64>) -> Result<(), AvatarError> {
    let mut refiner = case.refiner;
    let before = refiner.state_rows().0;
    refiner.step(FRAME, gradient, 0.5);
    let (exact, visits) = refiner.state_rows();
    there.kernels.refine.submit()?;
    let found = there.floats(&there.values.refined)?;
    let part = exact.len() / 3;
    for (what, range) in [("offsets", 0..part), ("first", part..2 * part), ("second", 2 * part..3 * part)] {
        let error = off(&found[range.clone()], exact[range].iter().copied());
        assert!(error < 1e-4, "{what}: {error:e}");
    }
    let width = POSE_SIZE + MODES;
    let others = (0..part).filter(|i| i / width != FRAME);
    assert!(others.clone().all(|i| found[i] == before[i] as f32), "another frame moved");
    let words = there.gpu.start_reading(&[&there.values.visits]).take(&there.gpu)?;
    assert!(words[0].iter().zip(visits).all(|(a, b)| *a as i32 == *b));
    Ok(())
}

#[test]
fn neighbours_draw_each_other_as_on_the_cpu_and_a_stop_holds_all() -> Result<(), AvatarError> {
    let Some(gpu) = device() else { return Ok(()) };
    let mut case = Case::new(0.3);
    let there = There::new(gpu, &case, true)?;
    there.scene.status.write(0, &[1])?;
    there.values.adam.gradients().write_floats(0, &vec![1.0; there.values.adam.gradients().words()])?;
    there.values.set_step(FRAME, 0.5, [1; 9], &Rates([0.1; 9]))?;
    let state = |there: &There| -> Result<Vec<Vec<f32>>, AvatarError> {
        let values = &there.values;
        [values.adam.parameters(), values.adam.moments(), &values.refined, &values.statistics]
            .map(|buffer| there.floats(buffer))
            .into_iter()
            .collect()
    };
    let before = state(&there)?;
    for kernels in [&there.kernels.before, &there.kernels.after, &there.kernels.refine, &there.kernels.smooth] {
        kernels.submit()?;
    }
    assert!(state(&there)? == before, "a stopped step changes nothing");
    there.scene.status.write(0, &[0])?;
    there.kernels.smooth.submit()?;
    let neighbours = Neighbours::new(&case.canonical);
    neighbours.smooth(&mut case.canonical, &case.ground.rest.positions, 0.5);
    hold_flat(&mut case.canonical);
    case.ground.hold(&mut case.canonical, &neighbours, 0.5);
    let found = there.floats(there.values.adam.parameters())?;
    let exact = case.canonical.groups().into_iter().flatten().map(|v| f64::from(*v));
    let error = off(&found, exact);
    assert!(error < 1e-6, "{error:e}");
    assert!(found != before[0]);
    Ok(())
}

fn small() -> TrainOptions {
    TrainOptions { steps: 30, gaussians: 150, device: Device::Gpu, ..quick() }
}

/// A fit through all its stages (warm-up, light, density rounds, coherence, poses), and the same one watched: whoever asks
/// for checkpoints, stops and goes on gets the same bits.
#[test]
fn a_fit_on_a_device_is_that_of_the_cpu_however_it_is_watched() -> Result<(), AvatarError> {
    let Some(gpu) = device() else { return Ok(()) };
    let (clip, track) = phantom::recording(40, 8);
    let there = train(&clip, &track, &small(), &mut onward)?;
    let cpu = train(&clip, &track, &TrainOptions { device: Device::Cpu, ..small() }, &mut onward)?;
    let (a, b) = (cpu.1.training.psnr_db, there.1.training.psnr_db);
    println!("{a} dB on the CPU, {b} dB on the device");
    assert!((a - b).abs() < 0.1, "{a} dB on the CPU, {b} dB on the device");
    assert_eq!(cpu.1.steps, there.1.steps);
    assert_eq!(cpu.0.len(), there.0.len());
    for (group, (a, b)) in cpu.0.canonical.groups().into_iter().zip(there.0.canonical.groups()).enumerate() {
        let error = off(b, wide(a));
        println!("parameters of group {group} after {} steps: {error:.1e}", there.1.steps);
        assert!(error < 1e-3, "group {group}: {error:e}");
    }
    assert_eq!(cpu.1.history.len(), there.1.history.len());
    for ((step, psnr), (other_step, other)) in cpu.1.history.iter().zip(&there.1.history) {
        assert!(step == other_step && (psnr - other).abs() < 0.1, "{step}: {psnr} {other}");
    }
    let mut host = Stopper { stop_after: 13, ..Stopper::default() };
    assert!(matches!(train(&clip, &track, &small(), &mut host), Err(AvatarError::Cancelled)));
    let mut host = Resumer(host.kept.take());
    let resumed = train(&clip, &track, &small(), &mut host)?;
    assert!(resumed.0 == there.0 && resumed.1 == there.1);

    frames_look_alike(gpu, &cpu.0, &track)
}

#[test]
fn black_white_and_unmatted_frames_leave_every_parameter_finite_there_too() -> Result<(), AvatarError> {
    if device().is_none() {
        return Ok(());
    }
    let (clip, track) = phantom::recording(24, 8);
    for (color, alpha) in [(0, 255), (255, 1)] {
        let sequence = Sequence {
            frames: vec![color; clip.frames.len()],
            alpha: vec![alpha; clip.alpha.len()],
            times_seconds: clip.times_seconds.clone(),
        };
        let flat = Clip::new("input", 24, 24, sequence)?;
        let (avatar, report) =
            train(&flat, &track, &TrainOptions { steps: 12, gaussians: 100, ..small() }, &mut onward)?;
        assert_eq!(avatar.canonical.first_not_finite(), None);
        assert!(avatar.environment.radiance.iter().flatten().all(|v| v.is_finite()));
        assert!(avatar.states.iter().all(|state| state.pose.iter().all(|v| v.is_finite())));
        assert!(report.training.psnr_db.is_finite());
    }
    Ok(())
}

/// Plain frames and frames with offsets on their albedo, of one channel and of three.
fn frames_look_alike(gpu: &Arc<Gpu>, avatar: &Avatar, track: &Track) -> Result<(), AvatarError> {
    let gaussians: Vec<u32> = (0..avatar.len() as u32).step_by(2).collect();
    let count = gaussians.len();
    let modulation = |red_blue: Vec<[f32; 2]>| Modulation {
        times_seconds: track.times_seconds.clone(),
        offsets: (0..count * track.frames.len()).map(|i| 0.2 * (i as f32 * 0.7).sin()).collect(),
        gaussians: gaussians.clone(),
        red_blue,
    };
    let mut clips = Vec::new();
    for modulation in [None, Some(modulation(Vec::new())), Some(modulation(vec![[0.5, -2.0]; count]))] {
        let frames = |gpu| {
            render_clip(avatar, track, &RenderOptions { gpu, modulation: modulation.as_ref(), ..Default::default() })
        };
        let (here, there) = (frames(None)?, frames(Some(gpu))?);
        for frame in [0, track.frames.len() - 1] {
            for i in (0..here.width * here.height).filter(|&i| here.frame_alpha(frame)[i] > 32) {
                let off = (0..3).map(|c| here.frame(frame)[3 * i + c].abs_diff(there.frame(frame)[3 * i + c])).max();
                assert!(off.is_some_and(|off| off <= 2), "pixel {i}: {off:?}");
            }
        }
        clips.push(there);
    }
    assert!(clips[0] != clips[1] && clips[1] != clips[2]);
    Ok(())
}

/// Goes on from a state and asks for no other.
struct Resumer(Option<Vec<u8>>);

impl Host for Resumer {
    fn progress(&mut self, _: Progress) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }
    fn resume(&mut self) -> Option<Vec<u8>> {
        self.0.take()
    }
}
