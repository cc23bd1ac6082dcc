//! A fit that stays on a device: a step sends a few hundred bytes (which frame, which rates), and nothing is waited for.
//!
//! What the steps report (their error, whether there was room) comes back a batch of steps later, always the same number
//! of steps later. A step without room changes nothing there and stops all behind it; they are sent again once there is
//! room. So the result is a pure function of clip, track, options and device. Where the host has to look or to change
//! something (density, light, a checkpoint, the end) everything is brought back to the `Fit`, which counts then.

use std::collections::VecDeque;
use std::sync::Arc;

use heartian_space::Clip;
use heartian_splat::{Adam, FitShape, Gpu, GpuFitter, GpuFrames, GpuReading, PhotometricWeights};

use super::appearance::{Appearance, MASK_WEIGHT, light_rate};
use super::checkpoint::Course;
use super::schedule::Schedule;
use super::{Fit, SMOOTH_EVERY};
use crate::AvatarError;
use crate::canonical::GROUPS;
use crate::density::Statistics;
use crate::device::{Given, Kernels, Values, View};
use crate::optimiser::{Optimiser, options};
use crate::train::Level;

/// Steps whose reports are read together.
const BATCH: usize = 16;
/// Bytes of frames that stay on the device; the others are sent each time they are drawn.
const FRAMES_BYTES: usize = 1 << 30;

/// A step on its way.
#[derive(Clone, Copy, Debug)]
struct Sent {
    step: u32,
    frame: usize,
    slot: usize,
}

/// The device's part of a fit.
pub(super) struct Resident {
    gpu: Arc<Gpu>,
    fitter: GpuFitter,
    frames: GpuFrames,
    schedule: Schedule,
    /// Entries to make room for at first, instead of a guess.
    room: Option<usize>,
    /// Nothing while the host's values count.
    stage: Option<Stage>,
    /// Steps whose reports were not read yet, oldest first.
    sent: VecDeque<Sent>,
    /// Reports on their way back, and of how many of the oldest steps.
    reading: Option<(GpuReading, usize)>,
    slots: usize,
}

/// Between two changes by the host.
struct Stage {
    values: Values,
    kernels: Kernels,
    level: Level,
    is_lit: bool,
    /// The first step, and how many each group and the light had made before.
    first: u32,
    steps: [u32; GROUPS],
    light_steps: u32,
}

/// Steps with their squared errors, in order.
type Reported = Vec<(u32, f64)>;

impl Resident {
    /// Nothing there yet but the kernels.
    ///
    /// # Errors
    /// When the device failed, or cannot hold a frame.
    pub fn new(gpu: &Arc<Gpu>, clip: &Clip, training: usize, schedule: Schedule) -> Result<Self, AvatarError> {
        Ok(Self {
            gpu: Arc::clone(gpu),
            fitter: GpuFitter::new(gpu)?,
            frames: GpuFrames::new(gpu, training, clip.width * clip.height, FRAMES_BYTES)?,
            schedule,
            room: None,
            stage: None,
            sent: VecDeque::new(),
            reading: None,
            slots: 0,
        })
    }

    /// Sends one step; gives what older ones reported, if that is due.
    ///
    /// # Errors
    /// When the device cannot hold the fit, or failed.
    fn step(&mut self, fit: &Fit<'_>, step: u32, frame: usize, level: &Level) -> Result<Reported, AvatarError> {
        if self.stage.is_none() {
            self.stage = Some(self.enter(fit, step, level)?);
        }
        self.send(fit.clip, step, frame)?;
        let covered = self.reading.as_ref().map_or(0, |(_, covered)| *covered);
        // Never more on their way than reports are kept of, also when many were sent again.
        if self.sent.len() < (covered + BATCH).min(GpuFitter::REPORTS - 1) {
            return Ok(Vec::new());
        }
        let reported = self.read(fit.clip)?;
        self.reading = Some((self.fitter.start_reports()?, self.sent.len()));
        Ok(reported)
    }

    /// Waits until every step is made; gives what they reported.
    ///
    /// # Errors
    /// When the device failed.
    fn drain(&mut self, clip: &Clip) -> Result<Reported, AvatarError> {
        let mut reported = self.read(clip)?;
        while !self.sent.is_empty() {
            self.reading = Some((self.fitter.start_reports()?, self.sent.len()));
            reported.extend(self.read(clip)?);
        }
        Ok(reported)
    }

    /// Lets the host's values count: they are brought to the device before the next step.
    fn forget(&mut self) {
        self.stage = None;
    }

    /// Brings all that the steps changed back to the host. Every step must have been made.
    ///
    /// # Errors
    /// When the device failed.
    fn fetch(&self, fit: &mut Fit<'_>, next: u32) -> Result<(), AvatarError> {
        let Some(stage) = &self.stage else { return Ok(()) };
        let made = next - stage.first;
        let values = &stage.values;
        let wanted =
            [values.adam.parameters(), values.adam.moments(), &values.refined, &values.visits, &values.statistics];
        let parts = self.gpu.start_reading(&wanted).take(&self.gpu)?;
        let floats = |part: usize| parts[part].iter().map(|word| f32::from_bits(*word)).collect::<Vec<f32>>();
        let (parameters, moments, rows) = (floats(0), floats(1), floats(4));
        let (half, mut at) = (parameters.len(), 0);
        let mut adams = Vec::with_capacity(GROUPS);
        for (group, steps) in fit.canonical.groups_mut().into_iter().zip(stage.steps) {
            let own = at..at + group.len();
            group.copy_from_slice(&parameters[own.clone()]);
            let halves = [moments[own.clone()].to_vec(), moments[half + own.start..half + own.end].to_vec()];
            adams.extend(Adam::from_parts(options(), halves, steps + made));
            at = own.end;
        }
        if let Ok(adams) = adams.try_into() {
            fit.optimiser = Optimiser::from_groups(adams);
        }
        let offsets: Vec<f64> = floats(2).into_iter().map(f64::from).collect();
        fit.refiner.restore(&offsets, &parts[3].iter().map(|visits| *visits as i32).collect::<Vec<_>>());
        let rows = rows.as_chunks::<4>().0;
        fit.statistics = Statistics {
            gradient_sum: rows.iter().map(|row| row[0]).collect(),
            frames: rows.iter().map(|row| row[1] as u32).collect(),
            most_pixels: rows.iter().map(|row| row[2]).collect(),
        };
        if stage.is_lit {
            let (environment, moments) = self.fitter.light()?;
            if let Some(appearance) = Appearance::from_state(environment, moments, stage.light_steps + made) {
                fit.appearance = appearance;
            }
        }
        Ok(())
    }

    /// Brings the host's values to the device.
    fn enter(&mut self, fit: &Fit<'_>, first: u32, level: &Level) -> Result<Stage, AvatarError> {
        let given = Given {
            canonical: &fit.canonical,
            refiner: &fit.refiner,
            rig: &fit.model.rig,
            statistics: &fit.statistics,
            neighbours: &fit.neighbours,
            ground: &fit.ground,
        };
        let values = Values::new(&self.gpu, &given)?;
        let adams = fit.optimiser.groups();
        values.set_moments([0, 1].map(|half| adams.iter().flat_map(|adam| adam.moments()[half]).copied().collect()))?;
        let light = fit.appearance.state();
        if let Some((environment, adam)) = light {
            self.fitter.set_light(environment, adam.moments())?;
        }
        let is_lit = light.is_some();
        let kernels = self.prepare(&values, level, is_lit, fit.canonical.len())?;
        Ok(Stage {
            values,
            kernels,
            level: *level,
            is_lit,
            first,
            steps: std::array::from_fn(|group| adams[group].steps()),
            light_steps: light.map_or(0, |(_, adam)| adam.steps()),
        })
    }

    /// Room for the scene, and the kernels around it.
    fn prepare(&mut self, values: &Values, level: &Level, is_lit: bool, count: usize) -> Result<Kernels, AvatarError> {
        let camera = &level.camera;
        let weights = PhotometricWeights::default();
        let shape = FitShape { count, camera, is_lit, weights, mask_weight: MASK_WEIGHT, room: self.room };
        let scene = self.fitter.reserve(&shape)?;
        let view = View {
            size: [camera.width, camera.height],
            factor: level.factor,
            source_width: level.source_width,
            is_lit,
            centre: camera.centre_in_world(),
        };
        Ok(values.record(&scene, &self.frames, &view)?)
    }

    fn send(&mut self, clip: &Clip, step: u32, frame: usize) -> Result<(), AvatarError> {
        let Some(stage) = &self.stage else { return Ok(()) };
        let packed = self.frames.is_wanted(frame).then(|| packed(clip, frame));
        self.frames.choose(frame, packed.as_deref())?;
        let (decay, made) = (self.schedule.decay(step), step - stage.first + 1);
        stage.values.set_step(frame, decay, stage.steps.map(|steps| steps + made), &self.schedule.rates(step))?;
        let Kernels { before, after, refine, smooth } = &stage.kernels;
        let mut then = vec![after];
        if self.schedule.refines(step) {
            then.push(refine);
        }
        if (step + 1).is_multiple_of(SMOOTH_EVERY) {
            then.push(smooth);
        }
        let light = stage.is_lit.then(|| light_rate(stage.light_steps + made, decay));
        self.fitter.submit(self.slots, &[before], &then, light.as_ref())?;
        self.sent.push_back(Sent { step, frame, slot: self.slots });
        self.slots += 1;
        Ok(())
    }

    /// Takes the reports that are on their way, and sends steps that had no room again.
    fn read(&mut self, clip: &Clip) -> Result<Reported, AvatarError> {
        let Some((reading, covered)) = self.reading.take() else { return Ok(Vec::new()) };
        let words = reading.take(&self.gpu)?;
        let reports: Vec<_> =
            self.sent.iter().take(covered).map(|sent| GpuFitter::report(&words[0], sent.slot)).collect();
        let made = reports.iter().position(|report| report.is_stopped).unwrap_or(reports.len());
        let done = self.sent.drain(..made).zip(&reports);
        let reported = done.map(|(sent, report)| (sent.step, report.squared_error)).collect();
        if made < reports.len() {
            let entries = reports[made..].iter().map(|report| report.entries).max().unwrap_or_default();
            self.fitter.make_room(entries)?;
            if let Some(stage) = self.stage.take() {
                let count = stage.values.count();
                let kernels = self.prepare(&stage.values, &stage.level, stage.is_lit, count)?;
                self.stage = Some(Stage { kernels, ..stage });
            }
            for sent in std::mem::take(&mut self.sent) {
                self.send(clip, sent.step, sent.frame)?;
            }
        }
        Ok(reported)
    }
}

impl Fit<'_> {
    /// Waits for the reports of all steps that a device was sent.
    pub(super) fn catch_up(&mut self, course: &mut Course, every: u32) -> Result<(), AvatarError> {
        let Some(resident) = &mut self.resident else { return Ok(()) };
        for (step, squared_error) in resident.drain(self.clip)? {
            course.note(step, squared_error, every);
        }
        Ok(())
    }

    /// Brings what the device changed back; `leave` when the host is going to change it.
    pub(super) fn come_home(&mut self, course: &mut Course, every: u32, leave: bool) -> Result<(), AvatarError> {
        self.catch_up(course, every)?;
        let Some(mut resident) = self.resident.take() else { return Ok(()) };
        let fetched = resident.fetch(self, course.step);
        if leave {
            resident.forget();
        }
        self.resident = Some(resident);
        fetched
    }

    /// Sends one step to the device; gives what older ones report.
    pub(super) fn step_there(&mut self, step: u32, frame: usize, level: &Level) -> Result<Reported, AvatarError> {
        let Some(mut resident) = self.resident.take() else { return Ok(Reported::new()) };
        let reported = resident.step(self, step, frame, level);
        self.resident = Some(resident);
        reported
    }
}

/// A frame in words: straight sRGB and matte, eight bits each, red lowest.
fn packed(clip: &Clip, frame: usize) -> Vec<u32> {
    let colors = clip.frame(frame).as_chunks::<3>().0.iter().zip(clip.frame_alpha(frame));
    colors.map(|([r, g, b], matte)| u32::from_le_bytes([*r, *g, *b, *matte])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::TrainOptions;
    use crate::phantom;
    use heartian_space::Progress;
    use heartian_splat::Device;
    use std::ops::ControlFlow;

    /// With hardly any room at first, steps are stopped and sent again, in the warm-up and at full size; with room for no
    /// frame, frames are sent each time.
    #[test]
    fn steps_without_room_and_frames_without_a_place_change_no_bit() -> Result<(), AvatarError> {
        if !matches!(Gpu::open(Device::Gpu), Ok(Some(_))) {
            println!("skipped: no Vulkan, Metal or Direct3D 12 adapter, not even a software one, is here");
            return Ok(());
        }
        let (clip, track) = phantom::recording(32, 8);
        let head = track.baked_head();
        let options = TrainOptions { steps: 18, gaussians: 120, device: Device::Gpu, ..TrainOptions::default() };
        let mut fits = Vec::new();
        for narrow in [false, true] {
            let mut fit = Fit::new(&clip, &track, &head, 6, &options)?;
            if let Some(resident) = fit.resident.as_mut().filter(|_| narrow) {
                resident.room = Some(20);
                resident.frames = GpuFrames::new(&resident.gpu, 6, 32 * 32, 4 * 32 * 32)?;
            }
            let course = fit.run(&mut |_: Progress| ControlFlow::Continue(()))?;
            let sent = fit.resident.as_ref().map_or(0, |resident| resident.slots);
            let made = course.step as usize;
            assert!(if narrow { sent > made } else { sent == made }, "{sent} steps were sent, {made} made");
            fits.push((fit.canonical, fit.refiner.all_states(), course.history));
        }
        assert!(fits[0] == fits[1]);
        Ok(())
    }
}
