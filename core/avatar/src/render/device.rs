//! A clip's frames on a GPU: deformed here, and composited, shaded, encoded and quantised there, some frames ahead of
//! those that were read back.

use std::sync::Arc;

use heartian_space::Camera;
use heartian_splat::{Environment, Gpu, GpuPresenter};

use super::Pixels;
use crate::AvatarError;
use crate::picture::Scene;

/// Colours and matte of `count` frames whose scenes `scene` makes.
///
/// # Errors
/// When the device cannot hold a scene, or failed.
pub(super) fn frames(
    gpu: &Arc<Gpu>,
    camera: &Camera,
    environment: &Environment,
    count: usize,
    scene: impl Fn(usize) -> Scene,
) -> Result<Vec<Pixels>, AvatarError> {
    let mut presenter = GpuPresenter::new(gpu)?;
    let mut frames = Vec::with_capacity(count);
    let mut sent = 0;
    while frames.len() < count {
        while sent < count && presenter.in_flight() < GpuPresenter::AHEAD {
            presenter.submit(&scene(sent).gaussians(), camera, environment)?;
            sent += 1;
        }
        match presenter.collect()? {
            Some(codes) => frames.push(split(&codes)),
            // It had no room and has now: this frame and those behind it are sent again.
            None => sent = frames.len(),
        }
    }
    Ok(frames)
}

/// Colours and matte of pixels of four bytes.
fn split(codes: &[u8]) -> Pixels {
    let pixels = codes.as_chunks::<4>().0;
    let colors = pixels.iter().flat_map(|[r, g, b, _]| [*r, *g, *b]).collect();
    (colors, pixels.iter().map(|[.., matte]| *matte).collect())
}
