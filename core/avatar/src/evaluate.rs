//! How well rendered frames match recorded ones: peak signal-to-noise ratio and structural similarity of 8-bit frames
//! over black, as means over frames.

use heartian_space::Clip;
use heartian_splat::{psnr, ssim};
use rayon::prelude::*;

use crate::AvatarError;
use crate::avatar::Avatar;
use crate::render::{RenderOptions, render_states};

/// A mean over frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Score {
    /// Peak signal-to-noise ratio, decibels, peak 1.
    pub psnr_db: f64,
    /// Structural similarity, at most 1.
    pub ssim: f64,
}

/// Scores the given frames of a rendered clip against the recording.
///
/// # Errors
/// When the clips differ in size or length, or a frame does not exist.
pub fn evaluate(rendered: &Clip, recorded: &Clip, frames: &[usize]) -> Result<Score, AvatarError> {
    let pairs: Vec<(usize, usize)> = frames.iter().map(|&frame| (frame, frame)).collect();
    evaluate_pairs(rendered, recorded, &pairs)
}

/// The same for a clip that was rendered for some frames only: (frame of `rendered`, frame of `recorded`).
fn evaluate_pairs(rendered: &Clip, recorded: &Clip, pairs: &[(usize, usize)]) -> Result<Score, AvatarError> {
    let size = |clip: &Clip| format!("{}×{}", clip.width, clip.height);
    if (rendered.width, rendered.height) != (recorded.width, recorded.height) {
        let (expected, found) = (size(recorded), size(rendered));
        return Err(AvatarError::Mismatch { what: "picture size of the rendered clip", expected, found });
    }
    let last = |clip: &Clip| format!("frames up to {}", clip.len() - 1);
    for &(ours, theirs) in pairs {
        if ours >= rendered.len() || theirs >= recorded.len() {
            let (expected, found) = (last(recorded), format!("frame {}", ours.max(theirs)));
            return Err(AvatarError::Mismatch { what: "frames to score", expected, found });
        }
    }
    if pairs.is_empty() {
        let remedy = "hold out at least one frame";
        return Err(AvatarError::TooLittle { what: "no frame to score", found: 0, remedy });
    }
    let scores: Vec<Score> = pairs
        .par_iter()
        .map(|&(ours, theirs)| {
            let (a, b) = (planar(rendered, ours), planar(recorded, theirs));
            // Equal frames have no noise; 100 dB stands for it, as a mean with infinity says nothing.
            let psnr_db = psnr(&a, &b)?.min(100.0);
            Ok(Score { psnr_db, ssim: ssim(&a, &b, rendered.width, rendered.height)? })
        })
        .collect::<Result<_, AvatarError>>()?;
    let mean = |value: fn(&Score) -> f64| scores.iter().map(value).sum::<f64>() / scores.len() as f64;
    Ok(Score { psnr_db: mean(|score| score.psnr_db), ssim: mean(|score| score.ssim) })
}

/// Renders the given frames of the avatar's own recording and scores them.
pub(crate) fn evaluate_states(avatar: &Avatar, recorded: &Clip, frames: &[usize]) -> Result<Score, AvatarError> {
    let states: Vec<_> = frames.iter().map(|&frame| &avatar.states[frame]).collect();
    let times: Vec<f64> = frames.iter().map(|&frame| recorded.times_seconds[frame]).collect();
    let rendered = render_states(avatar, &states, &times, &RenderOptions::default())?;
    let pairs: Vec<(usize, usize)> = frames.iter().copied().enumerate().collect();
    evaluate_pairs(&rendered, recorded, &pairs)
}

/// One frame over black as planes in [0, 1].
pub(crate) fn planar(clip: &Clip, frame: usize) -> Vec<f32> {
    let image = clip.image_over_black(frame);
    let pixels = image.data.as_chunks::<3>().0;
    (0..3).flat_map(|channel| pixels.iter().map(move |pixel| f32::from(pixel[channel]) / 255.0)).collect()
}
