//! Landmarks of a clip that came without: the installed networks look at every frame.

use std::ops::ControlFlow;

use heartian_face::models::FaceNets;
use heartian_face::nets::FaceFollower;
use heartian_face::{Landmark, Observations};
use heartian_space::{Clip, Progress, Rgb8Image};

use crate::CaptureError;

/// Finds the landmarks in every frame, in pixels of the clip; frames without a face have none.
///
/// # Errors
/// When the networks are not installed or `progress` breaks.
pub fn observe_clip(
    clip: &Clip,
    progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<Observations, CaptureError> {
    let nets = FaceNets::load()?;
    let mut follower = FaceFollower::new(&nets.detector, &nets.landmarks);
    let mut frames = Vec::with_capacity(clip.len());
    for index in 0..clip.len() {
        let image = Rgb8Image::from_data(clip.width, clip.height, clip.frame(index).to_vec())?;
        let face = follower.next(&image)?;
        frames.push(face.map(|face| {
            let points = face.points_px.iter().enumerate();
            let landmark = |(index, [x, y, _]): (usize, &[f32; 3])| Landmark {
                index: index as u32,
                position_px: [*x, *y],
                weight: face.presence,
            };
            points.map(landmark).collect()
        }));
        if progress(Progress { step: index as u64 + 1, total: clip.len() as u64, metric: None }).is_break() {
            return Err(CaptureError::Cancelled);
        }
    }
    Ok(Observations::new(clip.width, clip.height, clip.times_seconds.clone(), frames)?)
}
