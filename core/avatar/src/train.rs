//! Stage 1: fitting an avatar to a tracked clip.
//!
//! First the Gaussians are laid out on the head with the recording's own colours; then they are fitted at half
//! resolution without shading; then the light is guessed from the skin, colours become albedo, and everything is fitted
//! at full resolution with deferred shading in linear light and the sRGB transfer at the edge. The last 15 % of the
//! frames are never looked at before the final measurement: their poses are the tracked ones plus a global correction
//! learned on training frames. The result is a pure function of clip, track and options, at any number of threads; on a
//! device, where the steps stay (`resident.rs`), of that device too.

mod appearance;
mod checkpoint;
mod resident;
mod schedule;
mod targets;
mod views;

use glam::{Quat, Vec3};
use heartian_face::{HeadModel, Track};
use heartian_space::{Clip, Host, Progress};
use heartian_splat::{Device, Gpu, logit};

use crate::AvatarError;
use crate::avatar::Avatar;
use crate::canonical::Canonical;
use crate::coherent::{Neighbours, hold_flat};
use crate::color::observed_colors;
use crate::deform::deform;
use crate::density::{Statistics, control};
use crate::evaluate::{Score, evaluate_states};
use crate::ground::Ground;
use crate::hull::with_hair;
use crate::initialise::Scaffold;
use crate::light::{LightSample, fit_light, irradiance};
use crate::motion::{FittedMotion, FrameState, MotionModel};
use crate::optimiser::Optimiser;
use crate::refine::{RefineOptions, Refiner};
use crate::surface::MeshView;
use appearance::{Appearance, StepLoss};
use checkpoint::Course;
use resident::Resident;
use schedule::{FrameOrder, Schedule};
pub(crate) use targets::Level;
use views::{skin_like, views};

/// Fewest training frames worth fitting.
const FEWEST_FRAMES: usize = 4;
/// Steps from one smoothing over neighbours to the next.
const SMOOTH_EVERY: u32 = 10;
/// The fit may stop early when the live figure gains less than this in a twentieth of the steps, decibels.
const PLATEAU_DB: f64 = 0.01;

/// How to fit.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainOptions {
    /// Most Gaussians, 100 to 200000.
    pub gaussians: usize,
    /// Steps of one frame each, at most; 1 to 1000000.
    pub steps: u32,
    /// Which order frames are seen in.
    pub seed: u64,
    /// Most expression modes kept, 0 to 64.
    pub expression_modes: usize,
    /// Joint refinement of the training frames' poses.
    pub refine: RefineOptions,
    /// Part of the clip at its end that is held out, 0 to 0.5.
    pub held_out: f64,
    /// What makes the steps; laying out, density control and the guess of the light are always the CPU's.
    pub device: Device,
}

impl Default for TrainOptions {
    fn default() -> Self {
        Self {
            gaussians: 14_000,
            steps: 3000,
            seed: 1,
            expression_modes: 12,
            refine: RefineOptions::default(),
            held_out: 0.15,
            device: Device::Cpu,
        }
    }
}

/// What came of a fit.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainReport {
    /// Steps made; fewer than asked for when the fit stopped gaining.
    pub steps: u32,
    /// Gaussians of the avatar.
    pub gaussians: usize,
    /// Motion coefficients of the avatar: those that the training frames excite.
    pub modes: usize,
    /// Tracked numbers that could have moved it.
    pub drivers: usize,
    /// Peak signal-to-noise ratio and structural similarity over the held-out frames; `None` when none is held out.
    pub held_out: Option<Score>,
    /// The same over up to twenty training frames.
    pub training: Score,
    /// (step, live training PSNR in decibels), a hundred or so points.
    pub history: Vec<(u32, f64)>,
}

/// Fits an avatar.
///
/// # Errors
/// When clip and track do not belong together, there are too few frames, an option is out of range, a tracked pose is
/// not finite, or `host` breaks.
pub fn train(
    clip: &Clip,
    track: &Track,
    options: &TrainOptions,
    host: &mut dyn Host,
) -> Result<(Avatar, TrainReport), AvatarError> {
    let training = check(clip, track, options)?;
    let head = track.baked_head();
    let mut fit = Fit::new(clip, track, &head, training, options)?;
    let Course { step: steps, history, .. } = fit.run(host)?;
    let avatar = fit.finish();
    let held_out: Vec<usize> = (training..clip.len()).collect();
    let some: Vec<usize> = (0..training).step_by(training.div_ceil(20)).collect();
    let report = TrainReport {
        steps,
        gaussians: avatar.len(),
        modes: avatar.canonical.modes,
        drivers: avatar.motion.width(),
        held_out: (!held_out.is_empty()).then(|| evaluate_states(&avatar, clip, &held_out)).transpose()?,
        training: evaluate_states(&avatar, clip, &some)?,
        history,
    };
    Ok((avatar, report))
}

/// Checks the inputs; returns the number of training frames.
fn check(clip: &Clip, track: &Track, options: &TrainOptions) -> Result<usize, AvatarError> {
    let in_range = [
        ("gaussians", options.gaussians as f64, 100.0, 200_000.0, "100 to 200000"),
        ("steps", f64::from(options.steps), 1.0, 1e6, "1 to 1000000"),
        ("expression_modes", options.expression_modes as f64, 0.0, 64.0, "0 to 64"),
        ("held_out", options.held_out, 0.0, 0.5, "0 to 0.5"),
    ];
    for (name, value, low, high, range) in in_range {
        if !(low..=high).contains(&value) {
            return Err(AvatarError::Option { name, value, range });
        }
    }
    let size = |width: usize, height: usize| format!("{width}×{height}");
    let (camera, mismatch) = (&track.camera, |what, expected, found| AvatarError::Mismatch { what, expected, found });
    if (camera.width, camera.height) != (clip.width, clip.height) {
        let (expected, found) = (size(clip.width, clip.height), size(camera.width, camera.height));
        return Err(mismatch("picture size of the track", expected, found));
    }
    if track.frames.len() != clip.len() {
        return Err(mismatch("frames of the track", clip.len().to_string(), track.frames.len().to_string()));
    }
    if let Some(frame) = track.frames.iter().position(|pose| !pose.is_finite()) {
        return Err(AvatarError::PoseNotFinite { frame });
    }
    let held_out = (clip.len() as f64 * options.held_out).ceil() as usize;
    let training = clip.len() - held_out;
    if training < FEWEST_FRAMES {
        let remedy = "give a longer clip (a few seconds)";
        return Err(AvatarError::TooLittle { what: "too few frames to train on", found: training, remedy });
    }
    Ok(training)
}

/// A fit on its way.
struct Fit<'a> {
    clip: &'a Clip,
    track: &'a Track,
    head: &'a HeadModel,
    options: &'a TrainOptions,
    model: MotionModel,
    canonical: Canonical,
    optimiser: Optimiser,
    refiner: Refiner,
    appearance: Appearance,
    /// What makes the steps, unless the CPU does.
    resident: Option<Resident>,
    statistics: Statistics,
    /// Of the present Gaussians.
    neighbours: Neighbours,
    /// As they were laid out, and where that is to be believed rather than pictures.
    ground: Ground,
    /// Of one step; kept, because clearing it is cheaper than asking for fresh memory.
    gradient: Canonical,
    training: usize,
}

impl<'a> Fit<'a> {
    fn new(
        clip: &'a Clip,
        track: &'a Track,
        head: &'a HeadModel,
        training: usize,
        options: &'a TrainOptions,
    ) -> Result<Self, AvatarError> {
        let frames: Vec<usize> = (0..training).collect();
        let FittedMotion { model, basis } = MotionModel::fit(track, head, &frames, options.expression_modes)?;
        let states: Vec<FrameState> = track.frames.iter().map(|pose| model.state(pose)).collect();
        let views: Vec<(usize, FrameState)> =
            views(track, training).into_iter().map(|frame| (frame, states[frame].clone())).collect();
        let bald = Scaffold { clip, camera: track.camera, head, model: &model, basis: &basis, views: &views };
        let hairy = with_hair(&bald);
        let scaffold = Scaffold { head: &hairy, ..bald };
        let mesh_views: Vec<MeshView> = scaffold.mesh_views();
        // Some room is left for density control to put Gaussians where they are missed.
        let (mut canonical, mut ground) = scaffold.lay_out(&mesh_views, options.gaussians * 4 / 5);
        if canonical.is_empty() {
            let remedy = "the tracked head lies outside every picture; track the clip again";
            return Err(AvatarError::TooLittle { what: "no part of the head is in sight", found: 0, remedy });
        }
        let colors = observed_colors(&scaffold, &mesh_views, &canonical);
        canonical.albedo_logits = colors.iter().flatten().map(|c| logit(c.clamp(0.003, 0.97))).collect();
        let neighbours = Neighbours::new(&canonical);
        ground.rest = canonical.clone();
        let unseen = vec![0.0; canonical.len()];
        ground.finish(&mut canonical, &neighbours, &unseen);
        Ok(Self {
            clip,
            track,
            head,
            options,
            optimiser: Optimiser::new(&canonical),
            refiner: Refiner::new(&states, training, options.refine),
            appearance: Appearance::unshaded(),
            resident: Gpu::open(options.device)?
                .map(|gpu| Resident::new(&gpu, clip, training, Schedule::new(options.steps)))
                .transpose()?,
            statistics: Statistics::new(canonical.len()),
            neighbours,
            ground,
            gradient: Canonical::zeros(canonical.len(), canonical.modes),
            training,
            model,
            canonical,
        })
    }

    /// Makes the steps, those already made by an earlier run of the same fit left out; returns where it ended.
    fn run(&mut self, host: &mut dyn Host) -> Result<Course, AvatarError> {
        let schedule = Schedule::new(self.options.steps);
        let order = FrameOrder::new(self.training, self.options.seed);
        let start = Course { step: 0, order, live: [0.0; 2], history: Vec::new() };
        let kept = host.resume().and_then(|state| checkpoint::restore(self, &state));
        let mut course = kept.unwrap_or(start);
        let total = u64::from(schedule.steps());
        let every = (schedule.steps() / 100).max(1);
        while course.step < schedule.steps() && !self.is_settled(&schedule, &mut course, every)? {
            let step = course.step;
            if !schedule.is_warm_up(step) && self.appearance.is_unshaded() {
                self.come_home(&mut course, every, true)?;
                self.turn_on_the_light();
            }
            let level = Level::new(&self.track.camera, if schedule.is_warm_up(step) { 2 } else { 1 });
            let frame = course.order.draw();
            if self.resident.is_none() {
                let squared_error = self.step(&schedule, step, frame, &level)?.squared_error;
                course.note(step, squared_error, every);
            } else {
                for (step, squared_error) in self.step_there(step, frame, &level)? {
                    course.note(step, squared_error, every);
                }
            }
            course.step = step + 1;
            if schedule.controls_density(step) {
                self.come_home(&mut course, every, true)?;
                self.control_density();
            }
            let metric = course.psnr_db().map(|psnr_db| ("psnr_db", psnr_db));
            let stop = host.progress(Progress { step: u64::from(course.step), total, metric }).is_break();
            host.checkpoint(&mut || {
                self.come_home(&mut course, every, false).ok()?;
                checkpoint::save(self, &course).ok()
            });
            if stop {
                return Err(AvatarError::Cancelled);
            }
        }
        self.come_home(&mut course, every, true)?;
        Ok(course)
    }

    /// Whether the fit gains no more after the last step made.
    fn is_settled(&mut self, schedule: &Schedule, course: &mut Course, every: u32) -> Result<bool, AvatarError> {
        if course.step == 0 || !schedule.may_stop(course.step - 1) {
            return Ok(false);
        }
        // The history changes at its points only; what comes back from a device late is waited for there, so that the
        // answer does not depend on who asked for a checkpoint.
        let is_first = course.step == 1 || !schedule.may_stop(course.step - 2);
        if is_first || course.step.is_multiple_of(every) {
            self.catch_up(course, every)?;
        }
        Ok(plateaued(&course.history, schedule.steps()))
    }

    /// One frame.
    fn step(&mut self, schedule: &Schedule, step: u32, frame: usize, level: &Level) -> Result<StepLoss, AvatarError> {
        let target = level.target(self.clip, frame);
        let motion = self.model.motion(&self.refiner.state(frame));
        self.gradient.clear();
        let (canonical, gradient, at) = (&self.canonical, &mut self.gradient, (level, schedule.decay(step)));
        let (loss, picture) = self.appearance.step(canonical, &motion, at, &target, gradient)?;
        self.statistics.add(&picture.scene);
        if schedule.refines(step) {
            let state = self.refiner.state(frame);
            let pose = self.model.rig.backward(&state.pose, &picture.motion.joints);
            let all = pose.into_iter().chain(picture.motion.coefficients.iter().copied());
            self.refiner.step(frame, all, f64::from(schedule.decay(step)));
        }
        self.optimiser.step(&mut self.canonical, &self.gradient, &schedule.rates(step))?;
        if (step + 1).is_multiple_of(SMOOTH_EVERY) {
            self.neighbours.smooth(&mut self.canonical, &self.ground.rest.positions, schedule.decay(step));
            hold_flat(&mut self.canonical);
            self.ground.hold(&mut self.canonical, &self.neighbours, schedule.decay(step));
        }
        Ok(loss)
    }

    fn control_density(&mut self) {
        let limits = (self.options.gaussians, self.pixels_per_metre());
        let round = control(&self.canonical, &self.statistics, |index| self.ground.keeps(index), limits);
        self.optimiser.regroup(&round.kept, round.canonical.widths());
        self.ground.regroup(&round, &self.canonical);
        self.canonical = round.canonical;
        self.statistics = Statistics::new(self.canonical.len());
        self.gradient = Canonical::zeros(self.canonical.len(), self.canonical.modes);
        self.neighbours = Neighbours::new(&self.canonical);
    }

    /// Size in the picture of what lies where the head does, in the middle training frame.
    fn pixels_per_metre(&self) -> f32 {
        let pose = self.refiner.state(self.training / 2).pose;
        let head = Vec3::new(pose[3] as f32, pose[4] as f32, pose[5] as f32);
        let camera = &self.track.camera;
        camera.focal_px[0] / camera.camera_from_world_point(head).z.max(0.01)
    }

    /// Guesses the light from the skin's colours and divides it out of all colours.
    fn turn_on_the_light(&mut self) {
        let normals = self.mean_world_normals();
        let skin = skin_like(self.head, &self.canonical);
        let samples: Vec<LightSample> = skin
            .into_iter()
            .filter(|&index| self.canonical.opacity(index) > 0.2 && normals[index].z > 0.1)
            .map(|index| LightSample { normal: normals[index], color: self.canonical.albedo(index) })
            .collect();
        let environment = fit_light(&samples);
        for (index, normal) in normals.iter().enumerate() {
            let light = irradiance(&environment, *normal);
            let color = self.canonical.albedo(index);
            for channel in 0..3 {
                let albedo = (color[channel] / light[channel]).clamp(0.003, 0.97);
                self.canonical.albedo_logits[3 * index + channel] = logit(albedo);
            }
        }
        self.appearance = Appearance::shaded(environment);
        self.optimiser = Optimiser::new(&self.canonical);
    }

    /// Normals toward the camera in the pose of the middle training frame.
    fn mean_world_normals(&self) -> Vec<Vec3> {
        let motion = self.model.motion(&self.refiner.state(self.training / 2));
        let deformed = deform(&self.canonical, &motion);
        let centre = self.track.camera.centre_in_world();
        let of = |(q, p): (&[f32; 4], &[f32; 3])| {
            let normal = Quat::from_xyzw(q[1], q[2], q[3], q[0]) * Vec3::Z;
            if normal.dot(centre - Vec3::from_array(*p)) < 0.0 { -normal } else { normal }
        };
        deformed.rotations.as_chunks::<4>().0.iter().zip(deformed.positions.as_chunks::<3>().0).map(of).collect()
    }

    fn finish(mut self) -> Avatar {
        self.ground.finish(&mut self.canonical, &self.neighbours, &self.statistics.most_pixels);
        Avatar {
            canonical: self.canonical,
            motion: self.model,
            environment: self.appearance.environment(),
            camera: self.track.camera,
            states: self.refiner.all_states(),
            times_seconds: self.clip.times_seconds.clone(),
            training_frames: self.training,
        }
    }
}

/// Whether the live figure gained too little over the last twentieth of the plan.
fn plateaued(history: &[(u32, f64)], steps: u32) -> bool {
    let Some(&(now, psnr)) = history.last() else { return false };
    let before = history.iter().rev().find(|(step, _)| now - step >= steps / 20);
    before.is_some_and(|(_, before)| psnr - before < PLATEAU_DB)
}
