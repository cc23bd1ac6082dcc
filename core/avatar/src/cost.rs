//! What a training step and a Gaussian cost: seconds of each stage, and bytes of the state. For reading, never for tests.

use std::time::Instant;

use heartian_space::Clip;
use heartian_splat::{
    FrameGradient, PhotometricWeights, RasterOptions, backward, composite, photometric, prepare, shade, shade_backward,
    srgb_encode, srgb_encode_backward,
};

use crate::AvatarError;
use crate::avatar::Avatar;
use crate::canonical::Canonical;
use crate::optimiser::{Optimiser, Rates};
use crate::picture::{Features, Picture, Scene};
use crate::train::Level;

/// Stages of a step, in the order of [`step_cost`].
pub const STAGES: [&str; 9] = [
    "deform and activate",
    "project, sort, bin",
    "blend",
    "shade and encode",
    "loss",
    "shade back",
    "blend back",
    "deform back",
    "Adam",
];

/// Median seconds of each stage of a shaded training step at the recording's resolution, over `repeats` frames, at least
/// one. The avatar is not changed.
///
/// # Errors
/// When the clip is not the avatar's recording.
pub fn step_cost(avatar: &Avatar, clip: &Clip, repeats: usize) -> Result<[f64; STAGES.len()], AvatarError> {
    let mut seconds: Vec<Vec<f64>> = vec![Vec::new(); STAGES.len()];
    let (mut canonical, mut optimiser) = (avatar.canonical.clone(), Optimiser::new(&avatar.canonical));
    let mut gradient = Canonical::zeros(avatar.len(), avatar.canonical.modes);
    for repeat in 0..repeats.max(1) {
        let frame = repeat * 7919 % avatar.training_frames.max(1);
        let step = Step { avatar, clip, frame };
        step.run(&mut gradient, &mut |stage, spent| seconds[stage].push(spent))?;
        let start = Instant::now();
        optimiser.step(&mut canonical, &gradient, &Rates([1e-6; crate::canonical::GROUPS]))?;
        seconds[8].push(start.elapsed().as_secs_f64());
    }
    let median = |stage: &Vec<f64>| {
        let mut sorted = stage.clone();
        sorted.sort_by(f64::total_cmp);
        sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
    };
    let medians: Vec<f64> = seconds.iter().map(median).collect();
    Ok(std::array::from_fn(|stage| medians[stage]))
}

/// Bytes of training state a Gaussian: parameters, gradients, both moments and the ground's rest, and what density control
/// counts and the ground doubts.
pub fn state_bytes_per_gaussian(modes: usize) -> usize {
    let values: usize = Canonical::zeros(0, modes).widths().iter().sum();
    const STATISTICS: usize = 3;
    const DOUBT_AND_KIND: usize = 2;
    (5 * values + STATISTICS + DOUBT_AND_KIND) * size_of::<f32>()
}

struct Step<'a> {
    avatar: &'a Avatar,
    clip: &'a Clip,
    frame: usize,
}

impl Step<'_> {
    /// Everything of a step up to the gradients, with the time of each stage.
    fn run(&self, gradient: &mut Canonical, spent: &mut dyn FnMut(usize, f64)) -> Result<(), AvatarError> {
        let Avatar { canonical, motion, environment, camera, states, .. } = self.avatar;
        let state = states.get(self.frame).ok_or(AvatarError::Index {
            what: "the step to time",
            index: self.frame,
            count: states.len(),
        })?;
        let level = Level::new(camera, 1);
        let target = level.target(self.clip, self.frame);
        let motion = motion.motion(state);
        let mut start = Instant::now();
        let mut lap = |stage: usize| {
            let now = Instant::now();
            spent(stage, now.duration_since(start).as_secs_f64());
            start = now;
        };
        let scene = Scene::new(canonical, &motion, camera, Features::Materials);
        lap(0);
        let prepared = prepare(&scene.gaussians(), camera, &RasterOptions::default())?;
        lap(1);
        let picture = Picture { frame: composite(&prepared), scene, prepared };
        lap(2);
        let linear = shade(&picture.frame, camera, environment)?;
        let encoded = srgb_encode(&linear);
        lap(3);
        let mut on_image = vec![0.0; encoded.len()];
        let size = [camera.width, camera.height];
        photometric(&encoded, &target.rgb, size, PhotometricWeights::default(), &mut on_image)?;
        lap(4);
        srgb_encode_backward(&linear, &mut on_image)?;
        let back = shade_backward(&picture.frame, camera, environment, &on_image)?;
        lap(5);
        let upstream = FrameGradient { planes: &back.planes, depth: &[], transmittance: &back.transmittance };
        let on_scene = backward(&picture.scene.gaussians(), &picture.prepared, &picture.frame, &upstream)?;
        lap(6);
        gradient.clear();
        picture.scene.backward(on_scene, canonical, &motion, gradient);
        lap(7);
        Ok(())
    }
}
