//! From a network's rough person mask to the matte of a head and neck.
//!
//! The mask is joined with the face the landmarks outline, its edge is moved to the image's own edges by a guided
//! filter, clothes and what is not connected to the face go, the neck is cut off where the fitted mesh ends, and colours at
//! the rim are freed of the background. All planes are `size × size`, values in [0, 1].

mod body;
mod clip;
mod clothes;
mod guided;
mod neck;
mod outline;
mod rim;

use heartian_space::Rgb8Image;

use crate::crop::Points;
pub(crate) use body::{Body, BodyCut, LOOKS};
pub(crate) use clip::nearest_face;
pub use clip::{MatteSource, matte_clip, matte_iou, network_iou};
pub(crate) use outline::keep_connected;

/// What is needed beside the picture to cut a head out.
pub(crate) struct Evidence<'a> {
    /// The network's probability of a person.
    pub probability: &'a [f32],
    /// Which part of each pixel the camera saw.
    pub coverage: &'a [f32],
    /// Landmarks in crop pixels, of this frame or the nearest with a face.
    pub face: &'a Points,
    /// What is not head; nothing is cut off without.
    pub body: Option<&'a BodyCut>,
}

/// The matte of one square crop; colours at its rim are replaced by the head's own.
pub(crate) fn refine(image: &mut Rgb8Image, evidence: &Evidence<'_>) -> Vec<u8> {
    let size = image.width;
    let scale = size as f32 / 256.0;
    let face = outline::face_mask(evidence.face, size);
    let mut joined: Vec<f32> = evidence.probability.iter().zip(&face).map(|(p, face)| p.max(*face)).collect();
    if let Some(body) = evidence.body {
        joined.iter_mut().zip(&body.worn).for_each(|(person, worn)| *person *= 1.0 - worn);
    }
    let radius = ((5.0 * scale).round() as usize).max(1);
    joined = guided::filter(image, &joined, radius, 4e-4);
    // The filtered mask has faint veils where the mask was sure: cut both ends and steepen the middle.
    let person: Vec<f32> = joined.iter().map(|p| smoothstep(0.40, 0.95, *p)).collect();
    let mut alpha: Vec<f32> = person.iter().zip(&face).map(|(p, face)| p.max(*face)).collect();
    keep_connected(&mut alpha, size, &face);
    rim::replace_background(image, &alpha, scale);
    if let Some(body) = evidence.body {
        alpha.iter_mut().zip(&body.kept).for_each(|(alpha, kept)| *alpha *= kept);
    }
    alpha.iter().zip(evidence.coverage).map(|(alpha, part)| (alpha * part * 255.0 + 0.5) as u8).collect()
}

/// 0 below `low`, 1 above `high`, smooth between.
fn smoothstep(low: f32, high: f32, value: f32) -> f32 {
    let t = ((value - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
