//! A fit's values on a device, and the kernels that move them: canonical parameters with their moments, poses, coherence
//! and statistics. Each kernel's WGSL stands beside the Rust text that it is the twin of.
//!
//! Always holds: a step that had no room, and every step behind it, changes none of these values (see `GpuScene::status`).
//! Poses are in single precision here.

use std::sync::Arc;

use glam::Vec3;
use heartian_splat::{AdamGroup, Gpu, GpuAdam, GpuBuffer, GpuCall, GpuFrames, GpuKernels, GpuScene, SplatError};

use crate::canonical::{Canonical, GROUPS};
use crate::coherent::Neighbours;
use crate::deform::Motion;
use crate::density::Statistics;
use crate::ground::Ground;
use crate::optimiser::{self, Rates};
use crate::refine::Refiner;
use crate::rig::{JOINTS, POSE_SIZE, Rig};

/// Deformation and activations, there and back.
pub(crate) const PICTURE: &str = concat!(include_str!("deform.wgsl"), include_str!("picture.wgsl"));
const REFINE: &str = concat!(include_str!("rig.wgsl"), include_str!("refine.wgsl"));
const COHERENT: &str = include_str!("coherent.wgsl");
const GROUND: &str = include_str!("ground.wgsl");
const DENSITY: &str = include_str!("density.wgsl");
const TARGETS: &str = include_str!("train/targets.wgsl");

/// All of them.
#[cfg(test)]
pub(crate) const TEXTS: [&str; 6] = [PICTURE, REFINE, COHERENT, GROUND, DENSITY, TARGETS];

/// Gaussians of a workgroup, but for the way back whose sums they are, too.
pub(crate) const GROUP: usize = 64;
/// Pixels of a workgroup.
const PIXELS: usize = 256;
/// Words of the joints' transforms.
const JOINT_WORDS: usize = 12 * JOINTS;

/// All values of a fit but the light.
pub(crate) struct Values {
    gpu: Arc<Gpu>,
    count: usize,
    modes: usize,
    pub adam: GpuAdam,
    /// Joints' transforms and coefficients of the step's frame, and the gradient by them.
    pub motion: GpuBuffer,
    pub on_motion: GpuBuffer,
    block_sums: GpuBuffer,
    tracked: GpuBuffer,
    pub refined: GpuBuffer,
    pub visits: GpuBuffer,
    pub statistics: GpuBuffer,
    /// The ground: as laid out, and doubt and kind of each.
    rest: GpuBuffer,
    doubts: GpuBuffer,
    neighbours: GpuBuffer,
    drawn: GpuBuffer,
    body: GpuBuffer,
    visit: GpuBuffer,
    sheet: GpuBuffer,
    ground: GpuBuffer,
}

/// What values are made of.
pub(crate) struct Given<'a> {
    pub canonical: &'a Canonical,
    pub refiner: &'a Refiner,
    pub rig: &'a Rig,
    pub statistics: &'a Statistics,
    pub neighbours: &'a Neighbours,
    pub ground: &'a Ground,
}

/// Where the picture is taken from, and of what.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View {
    /// Pixels of the level, and source pixels along each side of one.
    pub size: [usize; 2],
    pub factor: usize,
    pub source_width: usize,
    pub is_lit: bool,
    /// Of the camera, world.
    pub centre: Vec3,
}

/// The kernels of a step around the rasteriser, and those that not every step has.
pub(crate) struct Kernels {
    /// Pose, posed Gaussians, target.
    pub before: GpuKernels,
    /// Gradients, statistics, descent.
    pub after: GpuKernels,
    /// The step of the frame's pose; to be made between `after`'s gradients and the next frame.
    pub refine: GpuKernels,
    pub smooth: GpuKernels,
}

fn bits(values: impl IntoIterator<Item = f32>) -> Vec<u32> {
    values.into_iter().map(f32::to_bits).collect()
}

impl Values {
    /// Brings everything to a device.
    ///
    /// # Errors
    /// When the device cannot hold it.
    pub fn new(gpu: &Arc<Gpu>, given: &Given<'_>) -> Result<Self, SplatError> {
        let (count, modes) = (given.canonical.len(), given.canonical.modes);
        let widths = given.canonical.widths();
        let ranges = optimiser::ranges();
        let groups: [AdamGroup; GROUPS] =
            std::array::from_fn(|i| AdamGroup { count: count * widths[i], range: [ranges[i].0, ranges[i].1] });
        let sums = JOINT_WORDS + modes;
        let new = |what, words| GpuBuffer::new(gpu, what, words);
        let tracked = given.refiner.tracked_rows();
        let (rows, visits) = given.refiner.state_rows();
        let visit = visit_words(given.refiner, given.rig, visits.len());
        let values = Self {
            gpu: Arc::clone(gpu),
            count,
            modes,
            adam: GpuAdam::new(gpu, &groups, optimiser::options())?,
            motion: new("the motion", sums)?,
            on_motion: new("the motion's gradient", sums)?,
            block_sums: new("the motion's gradient", sums * count.div_ceil(GROUP))?,
            tracked: new("the tracked poses", tracked.len())?,
            refined: new("the refined poses", rows.len())?,
            visits: new("the refined poses", visits.len())?,
            statistics: new("the statistics", 4 * count)?,
            rest: new("the ground", given.ground.rest.groups().iter().map(|group| group.len()).sum())?,
            doubts: new("the ground", 2 * count)?,
            neighbours: new("the neighbours", given.neighbours.rows().len())?,
            drawn: new("the neighbours' means", 8 * count)?,
            body: GpuBuffer::constants(gpu, &[0; 8])?,
            visit: GpuBuffer::constants(gpu, &visit)?,
            sheet: GpuBuffer::constants(gpu, &[0; 8])?,
            ground: GpuBuffer::constants(gpu, &[0; 12])?,
        };
        bring(given.canonical, values.adam.parameters())?;
        values.tracked.write_floats(0, &tracked)?;
        values.refined.write(0, &bits(rows.iter().map(|v| *v as f32)))?;
        values.visits.write(0, &visits.iter().map(|v| *v as u32).collect::<Vec<_>>())?;
        let s = given.statistics;
        let rows = s.gradient_sum.iter().zip(&s.frames).zip(&s.most_pixels);
        values.statistics.write(0, &bits(rows.flat_map(|((sum, frames), most)| [*sum, *frames as f32, *most, 0.0])))?;
        bring(&given.ground.rest, &values.rest)?;
        let doubts = given.ground.doubt.iter().zip(&given.ground.kind);
        let doubts: Vec<f32> = doubts.flat_map(|(doubt, kind)| [*doubt, f32::from(*kind)]).collect();
        values.doubts.write_floats(0, &doubts)?;
        values.neighbours.write(0, given.neighbours.rows())?;
        Ok(values)
    }

    /// Number of Gaussians.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Sets all first moments, then all second ones.
    ///
    /// # Errors
    /// When they are of other Gaussians.
    pub fn set_moments(&self, halves: [Vec<f32>; 2]) -> Result<(), SplatError> {
        self.adam.moments().write_floats(0, &halves[0])?;
        self.adam.moments().write_floats(halves[0].len(), &halves[1])
    }

    /// What the next submission's step is: its frame, the factor on pose rates, and of each group the steps and rates.
    ///
    /// # Errors
    /// None for values that were made.
    pub fn set_step(&self, frame: usize, decay: f32, steps: [u32; GROUPS], rates: &Rates) -> Result<(), SplatError> {
        let rates: Vec<(u32, f32)> = steps.into_iter().zip(rates.0).collect();
        self.adam.set_rates(&rates)?;
        self.visit.write(0, &[frame as u32])?;
        self.visit.write_floats(3, &[decay])?;
        self.ground.write(0, &crate::ground::constants([self.count, self.modes], decay))?;
        self.sheet.write(0, &crate::coherent::constants(self.count, decay))
    }

    /// Records the kernels over these values for a scene; its buffers, and the frames', must outlive no later reservation.
    ///
    /// # Errors
    /// When the device refused one.
    pub fn record(&self, scene: &GpuScene, frames: &GpuFrames, view: &View) -> Result<Kernels, SplatError> {
        self.body.write(0, &body_words([self.count, self.modes], view.is_lit, view.centre))?;
        let level = [view.size[0], view.size[1], view.factor, view.source_width].map(|v| v as u32);
        let level = GpuBuffer::constants(&self.gpu, &level)?;
        let (parameters, gradients) = (self.adam.parameters(), self.adam.gradients());
        let (body, visit, status) = ((0, &self.body), (0, &self.visit), &scene.status);
        let over = self.count.div_ceil(GROUP);

        let mut before = GpuKernels::new(&self.gpu);
        let bindings = [visit, (1, &self.tracked), (2, &self.refined), (4, &self.motion)];
        before.add(&GpuCall { text: REFINE, entry: "pose", bindings: &bindings, workgroups: 1 })?;
        let bindings = [body, (1, parameters), (2, &self.motion), (3, &scene.geometry), (4, &scene.features)];
        before.add(&GpuCall { text: PICTURE, entry: "pose_scene", bindings: &bindings, workgroups: over })?;
        let bindings = [(0, &level), (1, frames.current()), (2, &scene.wanted)];
        let workgroups = (view.size[0] * view.size[1]).div_ceil(PIXELS);
        before.add(&GpuCall { text: TARGETS, entry: "unfold", bindings: &bindings, workgroups })?;

        let mut after = GpuKernels::new(&self.gpu);
        let bindings = [
            body,
            (1, parameters),
            (2, &self.motion),
            (5, &scene.on_geometry),
            (6, &scene.on_features),
            (7, gradients),
            (8, &self.block_sums),
        ];
        after.add(&GpuCall { text: PICTURE, entry: "pull_back", bindings: &bindings, workgroups: over })?;
        let bindings = [body, (8, &self.block_sums), (9, &self.on_motion)];
        let workgroups = JOINT_WORDS + self.modes;
        after.add(&GpuCall { text: PICTURE, entry: "sum_motion", bindings: &bindings, workgroups })?;
        let round = GpuBuffer::constants(&self.gpu, &[self.count as u32, 0, 0, 0])?;
        let bindings = [(0, &round), (1, &scene.on_geometry), (2, &self.statistics), (3, status)];
        after.add(&GpuCall { text: DENSITY, entry: "collect", bindings: &bindings, workgroups: over })?;
        self.adam.record(&mut after, status)?;

        let mut refine = GpuKernels::new(&self.gpu);
        let bindings =
            [visit, (1, &self.tracked), (2, &self.refined), (3, &self.visits), (5, &self.on_motion), (6, status)];
        refine.add(&GpuCall { text: REFINE, entry: "refine", bindings: &bindings, workgroups: 1 })?;
        let smooth = self.record_smooth(status)?;
        Ok(Kernels { before, after, refine, smooth })
    }

    fn record_smooth(&self, status: &GpuBuffer) -> Result<GpuKernels, SplatError> {
        let mut smooth = GpuKernels::new(&self.gpu);
        let (parameters, workgroups) = (self.adam.parameters(), self.count.div_ceil(GROUP));
        let (sheet, drawn, status) = ((0, &self.sheet), (4, &self.drawn), (5, status));
        let bindings = [sheet, (1, parameters), (2, &self.rest), (3, &self.neighbours), drawn, status];
        smooth.add(&GpuCall { text: COHERENT, entry: "draw", bindings: &bindings, workgroups })?;
        let bindings = [sheet, (1, parameters), drawn, status];
        smooth.add(&GpuCall { text: COHERENT, entry: "settle", bindings: &bindings, workgroups })?;
        let (ground, rest, doubts) = ((0, &self.ground), (2, &self.rest), (6, &self.doubts));
        let bindings = [ground, (1, parameters), rest, (3, &self.neighbours), drawn, status, doubts];
        smooth.add(&GpuCall { text: GROUND, entry: "draw", bindings: &bindings, workgroups })?;
        let bindings = [ground, (1, parameters), rest, drawn, status, doubts];
        smooth.add(&GpuCall { text: GROUND, entry: "settle", bindings: &bindings, workgroups })?;
        Ok(smooth)
    }
}

/// Sets the canonical parameters, group after group.
///
/// # Errors
/// When the buffer has not their length.
pub(crate) fn bring(canonical: &Canonical, parameters: &GpuBuffer) -> Result<(), SplatError> {
    let mut at = 0;
    for group in canonical.groups() {
        parameters.write_floats(at, group)?;
        at += group.len();
    }
    Ok(())
}

/// `Body` of `deform.wgsl`, of so many Gaussians and coefficients.
pub(crate) fn body_words([count, modes]: [usize; 2], is_lit: bool, centre: Vec3) -> Vec<u32> {
    let features = if is_lit { 8 } else { 3 };
    let mut words: Vec<u32> = [count, modes, features, count.div_ceil(GROUP)].map(|v| v as u32).to_vec();
    words.extend(bits(centre.to_array().into_iter().chain([0.0])));
    words
}

/// `Visit` of `refine.wgsl`, of no frame yet.
fn visit_words(refiner: &Refiner, rig: &Rig, frames: usize) -> Vec<u32> {
    let options = refiner.options();
    let rates = options.pose_rates.iter().chain([&options.coefficient_rate, &0.0]).map(|rate| *rate as f32);
    let smoothing = [options.pose_smoothing as f32, options.coefficient_smoothing as f32, 0.0, 0.0];
    let joints = rig.joints.iter().flat_map(|joint| [joint[0] as f32, joint[1] as f32, joint[2] as f32, 0.0]);
    let mut words = vec![0, refiner.width() as u32, frames as u32, 0];
    words.extend(bits(rates.chain(smoothing).chain(joints)));
    words
}

/// A motion's words as `deform.wgsl` reads them.
pub(crate) fn motion_words(motion: &Motion) -> Vec<f32> {
    let rows = motion
        .joints
        .iter()
        .flat_map(|joint| (0..3).flat_map(move |row| (0..4).map(move |c| joint.col(c)[row] as f32)));
    rows.chain(motion.coefficients.iter().copied()).collect()
}

/// Numbers of a frame that fit one workgroup of `refine.wgsl`.
const _: () = assert!(POSE_SIZE + 64 + 11 <= 128);
