//! An avatar on a track as a clip: over black with its matte, 8 bits, under its own light or another.
//!
//! Frames are independent, so they are rendered in parallel and the result does not depend on the number of threads.
//! A clip holds straight colours: what is composited over black is divided by alpha before it is stored. A modulation
//! of zero gives the same bytes as none.

mod device;

use std::sync::Arc;

use heartian_face::Track;
use heartian_space::{Clip, Modulation, Sequence, color};
use heartian_splat::{Environment, Frame, Gpu, shade, srgb_encode};
use rayon::prelude::*;

use crate::AvatarError;
use crate::avatar::Avatar;
use crate::motion::FrameState;
use crate::picture::{AlbedoOffsets, Features, Scene};

/// What to render.
#[derive(Clone, Debug, Default)]
pub struct RenderOptions<'a> {
    /// The clip's label.
    pub label: &'a str,
    /// Light instead of the recording's.
    pub environment: Option<&'a Environment>,
    /// What is added to the albedo of some Gaussians, frame by frame.
    pub modulation: Option<&'a Modulation>,
    /// Side of the square picture instead of the recording's size, pixels.
    pub size: Option<usize>,
    /// The GPU to render on instead of the CPU; its frames are the same within a code or so.
    pub gpu: Option<&'a Arc<Gpu>>,
}

/// Where a frame's colours (RGB) and matte go.
struct PixelsMut<'a> {
    colors: &'a mut [u8],
    alpha: &'a mut [u8],
}

impl<'a> From<(&'a mut [u8], &'a mut [u8])> for PixelsMut<'a> {
    fn from((colors, alpha): (&'a mut [u8], &'a mut [u8])) -> Self {
        Self { colors, alpha }
    }
}

/// Renders every frame of a track.
///
/// # Errors
/// When the track does not fit the avatar, or the modulation names other frames or Gaussians.
pub fn render_clip(avatar: &Avatar, track: &Track, options: &RenderOptions<'_>) -> Result<Clip, AvatarError> {
    let states = avatar.states_for(track)?;
    let states: Vec<&FrameState> = states.iter().collect();
    render_states(avatar, &states, &track.times_seconds, options)
}

/// The avatar under another light.
pub fn relight(avatar: &Avatar, environment: Environment) -> Avatar {
    Avatar { environment, ..avatar.clone() }
}

/// Renders given states at given times.
pub(crate) fn render_states(
    avatar: &Avatar,
    states: &[&FrameState],
    times_seconds: &[f64],
    options: &RenderOptions<'_>,
) -> Result<Clip, AvatarError> {
    check_modulation(avatar, states.len(), options)?;
    let mut camera = avatar.camera;
    if let Some(size) = options.size {
        camera = camera.scaled_to(size, size);
    }
    let environment = options.environment.unwrap_or(&avatar.environment);
    let scene = |index: usize| {
        let motion = avatar.motion.motion(states[index]);
        let mut scene = Scene::new(&avatar.canonical, &motion, &camera, Features::Materials);
        if let Some(modulation) = options.modulation {
            let Modulation { gaussians, red_blue, .. } = modulation;
            scene.add_albedo(AlbedoOffsets { gaussians, green: modulation.frame(index), red_blue });
        }
        scene
    };
    let pixels = camera.width * camera.height;
    let (mut colors, mut alpha) = (vec![0; 3 * pixels * states.len()], vec![0; pixels * states.len()]);
    let frames =
        (colors.chunks_exact_mut((3 * pixels).max(1)).zip(alpha.chunks_exact_mut(pixels.max(1)))).map(PixelsMut::from);
    match options.gpu {
        Some(gpu) => {
            let (camera, modulation) = (&camera, options.modulation);
            device::frames(gpu, &device::Shown { avatar, camera, environment, states, modulation }, frames.collect())?;
        }
        None => frames.enumerate().collect::<Vec<_>>().into_par_iter().try_for_each(|(index, frame)| {
            let picture = scene(index).picture(&camera)?;
            let linear = shade(&picture.frame, &camera, environment)?;
            quantise(&picture.frame, &srgb_encode(&linear), frame);
            Ok::<(), AvatarError>(())
        })?,
    }
    let sequence = Sequence { frames: colors, alpha, times_seconds: times_seconds.to_vec() };
    Ok(Clip::new(options.label, camera.width, camera.height, sequence)?)
}

fn check_modulation(avatar: &Avatar, frames: usize, options: &RenderOptions<'_>) -> Result<(), AvatarError> {
    let Some(modulation) = options.modulation else { return Ok(()) };
    if modulation.times_seconds.len() != frames {
        let (expected, found) = (frames.to_string(), modulation.times_seconds.len().to_string());
        return Err(AvatarError::Mismatch { what: "frames of the modulation", expected, found });
    }
    match modulation.gaussians.iter().find(|&&index| index as usize >= avatar.len()) {
        None => Ok(()),
        Some(&index) => Err(AvatarError::Index { what: "the modulation", index: index as usize, count: avatar.len() }),
    }
}

/// Straight 8-bit colours and matte of a picture composited over black (planes, sRGB-encoded); written over zeros.
fn quantise(frame: &Frame, encoded: &[f32], to: PixelsMut<'_>) {
    let pixels = frame.width * frame.height;
    for (pixel, (color, matte)) in to.colors.as_chunks_mut::<3>().0.iter_mut().zip(to.alpha).enumerate() {
        *matte = color::quantise(1.0 - frame.transmittance[pixel]);
        // Divided by the matte as it is stored, so that compositing gives back what was rendered.
        let unit = f32::from(*matte) / 255.0;
        if *matte > 0 {
            *color = std::array::from_fn(|channel| color::quantise(encoded[channel * pixels + pixel] / unit));
        }
    }
}
