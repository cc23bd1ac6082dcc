//! A clip's frames on a GPU: the avatar goes there once, a frame sends its motion and what is added to its albedo, and is
//! deformed, composited, shaded, encoded and quantised there, some frames ahead of those that were read back.

use std::sync::Arc;

use heartian_space::{Camera, Modulation};
use heartian_splat::{Environment, Gpu, GpuBuffer, GpuCall, GpuKernels, GpuPresenter, SplatError};

use super::PixelsMut;
use crate::AvatarError;
use crate::avatar::Avatar;
use crate::device::{GROUP, PICTURE, body_words, bring, motion_words};
use crate::motion::FrameState;

/// What is shown.
pub(super) struct Shown<'a> {
    pub avatar: &'a Avatar,
    pub camera: &'a Camera,
    pub environment: &'a Environment,
    pub states: &'a [&'a FrameState],
    pub modulation: Option<&'a Modulation>,
}

/// Renders every state, each to its place.
///
/// # Errors
/// When the device cannot hold the avatar, or failed.
pub(super) fn frames(gpu: &Arc<Gpu>, shown: &Shown<'_>, mut places: Vec<PixelsMut<'_>>) -> Result<(), AvatarError> {
    let there = There::new(gpu, shown)?;
    let mut presenter = GpuPresenter::new(gpu)?;
    let mut kernels = there.record(&mut presenter, shown)?;
    let (mut sent, mut done) = (0, 0);
    while done < places.len() {
        while sent < places.len() && presenter.in_flight() < GpuPresenter::AHEAD {
            there.set(shown, sent)?;
            presenter.submit_made(&[&kernels])?;
            sent += 1;
        }
        match presenter.collect()? {
            Some(codes) => {
                split(&codes, &mut places[done]);
                done += 1;
            }
            // It had no room and has now: this frame and those behind it are sent again.
            None => {
                sent = done;
                kernels = there.record(&mut presenter, shown)?;
            }
        }
    }
    Ok(())
}

/// The avatar there.
struct There {
    gpu: Arc<Gpu>,
    parameters: GpuBuffer,
    motion: GpuBuffer,
    body: GpuBuffer,
    tint: Option<Tint>,
}

/// Whose albedo is changed, and by how much in the frame.
struct Tint {
    gaussians: GpuBuffer,
    green: GpuBuffer,
    red_blue: GpuBuffer,
    count: usize,
}

impl There {
    fn new(gpu: &Arc<Gpu>, shown: &Shown<'_>) -> Result<Self, SplatError> {
        let canonical = &shown.avatar.canonical;
        let words = canonical.groups().iter().map(|group| group.len()).sum();
        let size = [canonical.len(), canonical.modes];
        let own = Self {
            gpu: Arc::clone(gpu),
            parameters: GpuBuffer::new(gpu, "the avatar", words)?,
            motion: GpuBuffer::new(gpu, "the motion", 60 + canonical.modes)?,
            body: GpuBuffer::constants(gpu, &body_words(size, true, shown.camera.centre_in_world()))?,
            tint: shown.modulation.map(|modulation| Tint::new(gpu, modulation)).transpose()?,
        };
        bring(canonical, &own.parameters)?;
        Ok(own)
    }

    fn record(&self, presenter: &mut GpuPresenter, shown: &Shown<'_>) -> Result<GpuKernels, SplatError> {
        let count = shown.avatar.len();
        let [geometry, features] = presenter.reserve(count, shown.camera, shown.environment)?;
        let mut kernels = GpuKernels::new(&self.gpu);
        let bindings = [(0, &self.body), (1, &self.parameters), (2, &self.motion), (3, &geometry), (4, &features)];
        let workgroups = count.div_ceil(GROUP);
        kernels.add(&GpuCall { text: PICTURE, entry: "pose_scene", bindings: &bindings, workgroups })?;
        if let Some(tint) = &self.tint {
            let own = [(10, &tint.gaussians), (11, &tint.green), (12, &tint.red_blue)];
            let bindings = [(0, &self.body), (4, &features), own[0], own[1], own[2]];
            let workgroups = tint.count.div_ceil(GROUP);
            kernels.add(&GpuCall { text: PICTURE, entry: "tint", bindings: &bindings, workgroups })?;
        }
        Ok(kernels)
    }

    /// Brings what is a frame's own, before whatever is submitted next.
    fn set(&self, shown: &Shown<'_>, frame: usize) -> Result<(), SplatError> {
        let motion = shown.avatar.motion.motion(shown.states[frame]);
        let mut words = motion_words(&motion);
        words.resize(self.motion.words(), 0.0);
        self.motion.write_floats(0, &words)?;
        match (&self.tint, shown.modulation) {
            (Some(tint), Some(modulation)) => tint.green.write_floats(0, modulation.frame(frame)),
            _ => Ok(()),
        }
    }
}

impl Tint {
    fn new(gpu: &Arc<Gpu>, modulation: &Modulation) -> Result<Self, SplatError> {
        let count = modulation.gaussians.len();
        let own = Self {
            gaussians: GpuBuffer::new(gpu, "the skin", 1 + count)?,
            green: GpuBuffer::new(gpu, "the offsets of the albedo", count)?,
            red_blue: GpuBuffer::new(gpu, "the offsets of the albedo", 2 * count)?,
            count,
        };
        own.gaussians.write(0, &[count as u32])?;
        own.gaussians.write(1, &modulation.gaussians)?;
        own.red_blue.write_floats(0, modulation.red_blue.as_flattened())?;
        Ok(own)
    }
}

/// Colours and matte of pixels of four bytes.
fn split(codes: &[u8], to: &mut PixelsMut<'_>) {
    let places = to.colors.as_chunks_mut::<3>().0.iter_mut().zip(to.alpha.iter_mut());
    for ([r, g, b, a], (color, matte)) in codes.as_chunks::<4>().0.iter().zip(places) {
        (*color, *matte) = ([*r, *g, *b], *a);
    }
}
