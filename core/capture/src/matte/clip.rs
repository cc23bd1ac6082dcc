//! Matting a clip that is already cut: by the person network, by a key colour, or from a folder of masks.
//!
//! Whatever tells person from ground, the same refinement follows ([`super::refine`]): the image's own edges, what hangs
//! together with the face, where the fitted head ends, colours at the rim. Masks from a folder are taken as they are.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use heartian_face::Observations;
use heartian_face::models::FaceNets;
use heartian_face::nets::PersonMatte;
use heartian_space::{Clip, Progress, Rgb8Image, Sequence};
use rayon::prelude::*;

use super::{Body, Evidence, LOOKS, refine, smoothstep};
use crate::CaptureError;
use crate::video::{self, VideoOptions};

/// Frames matted at once.
const BATCH: usize = 16;
/// Indices of the face mesh.
const LANDMARKS: usize = 468;

/// What tells person from ground.
#[derive(Clone, Debug, PartialEq)]
pub enum MatteSource {
    /// The installed person network.
    Person,
    /// A ground of one colour: how far a pixel's hue is from it, as a share of the key's own saturation.
    Key {
        /// The ground's colour, sRGB.
        color: [u8; 3],
        /// Nearer than this is ground, twice as far is person; 0–1.
        tolerance: f32,
    },
    /// A folder of PNG masks in natural order, one a frame and of the clip's size: white is the person.
    Masks(PathBuf),
}

/// The clip with a new matte, and colours at its rim freed of the ground.
///
/// # Errors
/// Networks not installed; masks that cannot be read, are too few, or of another size; `progress` breaks.
pub fn matte_clip(
    mut clip: Clip,
    landmarks: &Observations,
    source: &MatteSource,
    progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<Clip, CaptureError> {
    match source {
        MatteSource::Masks(folder) => clip.alpha = masks(folder, &clip)?,
        MatteSource::Person => {
            let nets = FaceNets::load()?;
            refined(&mut clip, landmarks, &|image| probability(&nets.person, image), progress)?;
        }
        MatteSource::Key { color, tolerance } => {
            refined(&mut clip, landmarks, &|image| Ok(keyed(image, *color, *tolerance)), progress)?;
        }
    }
    Ok(clip)
}

fn probability(person: &PersonMatte, image: &Rgb8Image) -> Result<Vec<f32>, CaptureError> {
    Ok(person.probability(image)?)
}

type Teller<'a> = dyn Fn(&Rgb8Image) -> Result<Vec<f32>, CaptureError> + Sync + 'a;

fn refined(
    clip: &mut Clip,
    landmarks: &Observations,
    teller: &Teller<'_>,
    progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<(), CaptureError> {
    let (width, height, total) = (clip.width, clip.height, clip.len());
    if width != height {
        return Err(CaptureError::Option {
            name: "width",
            value: width as f64,
            range: "the clip's height: mattes are of squares",
        });
    }
    let coverage = vec![1.0; width * height];
    let picture = |clip: &Clip, frame: usize| Rgb8Image::from_data(width, height, clip.frame(frame).to_vec());
    let mut go_on = || progress(Progress { step: 0, total: total as u64, metric: None });
    let mut body = Body::fitted(landmarks, &mut go_on)?;
    if let Some(body) = &mut body {
        for frame in (0..total).step_by(total.div_ceil(LOOKS)) {
            let image = picture(clip, frame)?;
            body.look(frame, &image, &teller(&image)?, &nearest_face(landmarks, frame));
        }
    }
    for from in (0..total).step_by(BATCH) {
        let to = (from + BATCH).min(total);
        let matted: Vec<Result<(Rgb8Image, Vec<u8>), CaptureError>> = (from..to)
            .into_par_iter()
            .map(|frame| {
                let mut image = picture(clip, frame)?;
                let probability = teller(&image)?;
                let (face, cut) = (nearest_face(landmarks, frame), body.as_ref().map(|body| body.cut(frame, &image)));
                let evidence =
                    Evidence { probability: &probability, coverage: &coverage, face: &face, body: cut.as_ref() };
                let alpha = refine(&mut image, &evidence);
                Ok((image, alpha))
            })
            .collect();
        for (frame, matted) in (from..to).zip(matted) {
            let (image, alpha) = matted?;
            let pixels = width * height;
            clip.frames[frame * pixels * 3..(frame + 1) * pixels * 3].copy_from_slice(&image.data);
            clip.alpha[frame * pixels..(frame + 1) * pixels].copy_from_slice(&alpha);
        }
        if progress(Progress { step: to as u64, total: total as u64, metric: None }).is_break() {
            return Err(CaptureError::Cancelled);
        }
    }
    Ok(())
}

/// Landmarks of the nearest frame with a face, by their index; unseen ones are NaN.
pub(crate) fn nearest_face(landmarks: &Observations, frame: usize) -> Vec<[f32; 3]> {
    let near =
        (0..landmarks.len()).filter(|other| landmarks.has_face(*other)).min_by_key(|other| other.abs_diff(frame));
    let mut points = vec![[f32::NAN; 3]; LANDMARKS];
    for landmark in near.into_iter().flat_map(|frame| landmarks.frame(frame)) {
        if let Some(point) = points.get_mut(landmark.index as usize) {
            *point = [landmark.position_px[0], landmark.position_px[1], 0.0];
        }
    }
    points
}

/// Probability of a person against a ground of one colour.
fn keyed(image: &Rgb8Image, color: [u8; 3], tolerance: f32) -> Vec<f32> {
    // Blue- and red-difference, so that shadows on the ground count little.
    let hue = |pixel: [u8; 3]| {
        let [r, g, b] = pixel.map(f32::from);
        let luma = 0.299 * r + 0.587 * g + 0.114 * b;
        [b - luma, r - luma]
    };
    let key = hue(color);
    let saturation = key[0].hypot(key[1]).max(8.0);
    let far = |pixel: &[u8; 3]| {
        let own = hue(*pixel);
        (own[0] - key[0]).hypot(own[1] - key[1]) / saturation
    };
    let person = |pixel: &[u8; 3]| smoothstep(tolerance, 2.0 * tolerance.max(1e-3), far(pixel));
    image.data.as_chunks::<3>().0.iter().map(person).collect()
}

fn masks(folder: &Path, clip: &Clip) -> Result<Vec<u8>, CaptureError> {
    let wrong = |reason: String| CaptureError::Masks { folder: folder.to_owned(), reason };
    let mut alpha = Vec::with_capacity(clip.alpha.len());
    let video = video::open(folder, &VideoOptions::default())?;
    let mut frames = 0;
    video::for_each_frame(video, |frame| -> Result<ControlFlow<()>, CaptureError> {
        let image = frame.image;
        if (image.width, image.height) != (clip.width, clip.height) {
            let (width, height) = (image.width, image.height);
            return Err(wrong(format!("mask {frames} is {width}×{height}, the clip {}×{}", clip.width, clip.height)));
        }
        alpha.extend(image.data.as_chunks::<3>().0.iter().map(|pixel| pixel[1]));
        frames += 1;
        Ok(if frames == clip.len() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) })
    })?;
    if frames < clip.len() {
        return Err(wrong(format!("it holds {frames} masks for {} frames", clip.len())));
    }
    Ok(alpha)
}

/// Intersection over union of two clips' mattes, soft: the sum of the smaller over the sum of the larger alpha, over all
/// pixels of the frames both have; 1 when both are empty.
pub fn matte_iou(a: &Clip, b: &Clip) -> f64 {
    let (mut both, mut either) = (0u64, 0u64);
    for (x, y) in a.alpha.iter().zip(&b.alpha) {
        both += u64::from(*x.min(y));
        either += u64::from(*x.max(y));
    }
    if either == 0 { 1.0 } else { both as f64 / either as f64 }
}

/// The person network's matte of up to `frames` frames, spread evenly, against the clip's own alpha: [`matte_iou`].
///
/// # Errors
/// As [`matte_clip`]; no clip without frames.
pub fn network_iou(truth: &Clip, landmarks: &Observations, frames: usize) -> Result<f64, CaptureError> {
    let count = frames.clamp(1, truth.len().max(1));
    let chosen: Vec<usize> = (0..count).map(|k| k * truth.len() / count).collect();
    let sequence = Sequence {
        frames: chosen.iter().flat_map(|frame| truth.frame(*frame)).copied().collect(),
        alpha: chosen.iter().flat_map(|frame| truth.frame_alpha(*frame)).copied().collect(),
        times_seconds: chosen.iter().map(|frame| truth.times_seconds[*frame]).collect(),
    };
    let sample = Clip::new(&truth.label, truth.width, truth.height, sequence)?;
    let seen = chosen.iter().map(|frame| landmarks.has_face(*frame).then(|| landmarks.frame(*frame).collect()));
    let seen = Observations::new(landmarks.width, landmarks.height, sample.times_seconds.clone(), seen.collect())?;
    let mut go_on = |_: Progress| ControlFlow::Continue(());
    Ok(matte_iou(&matte_clip(sample.clone(), &seen, &MatteSource::Person, &mut go_on)?, &sample))
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::synthetic::{SyntheticOptions, generate};

    fn go(_: Progress) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    #[test]
    fn the_network_finds_the_synthetic_head() {
        let options = SyntheticOptions { seconds: 1.0, frames_per_second: 5.0, ..SyntheticOptions::default() };
        let truth = generate(&options, &mut go).unwrap();
        let found = match matte_clip(truth.clip.clone(), &truth.observations, &MatteSource::Person, &mut go) {
            Ok(found) => found,
            Err(error @ CaptureError::Models(_)) => return println!("skipped: {error}"),
            Err(error) => panic!("{error}"),
        };
        let iou = matte_iou(&found, &truth.clip);
        println!("matte iou {iou:.4}");
        assert_eq!(network_iou(&truth.clip, &truth.observations, 99).unwrap(), iou, "all frames there are");
        if let Some(folder) = std::env::var_os("HEARTIAN_SHOW") {
            std::fs::write(Path::new(&folder).join("found.rgb"), found.image_over_black(2).data).unwrap();
            std::fs::write(Path::new(&folder).join("truth.rgb"), truth.clip.image_over_black(2).data).unwrap();
            std::fs::write(Path::new(&folder).join("frame.rgb"), truth.clip.frame(2)).unwrap();
        }
        assert!(iou > 0.97, "{iou}");
    }

    #[test]
    fn a_ground_of_one_colour_is_keyed_out_and_masks_are_taken_as_they_are() {
        let (size, green) = (64usize, [20u8, 200, 40]);
        let head = |i: usize| (i % size).abs_diff(32).pow(2) + (i / size).abs_diff(28).pow(2) < 18 * 18;
        let frames: Vec<u8> = (0..size * size).flat_map(|i| if head(i) { [210, 160, 130] } else { green }).collect();
        let sequence = Sequence { frames, alpha: vec![0; size * size], times_seconds: vec![0.0] };
        let clip = Clip::new("input", size, size, sequence).unwrap();
        let nobody = Observations::new(size, size, vec![0.0], vec![None]).unwrap();
        let key = MatteSource::Key { color: green, tolerance: 0.2 };
        let keyed = matte_clip(clip.clone(), &nobody, &key, &mut go).unwrap();
        let mut want = clip.clone();
        want.alpha = (0..size * size).map(|i| if head(i) { 255 } else { 0 }).collect();
        println!("key iou {:.4}", matte_iou(&keyed, &want));
        assert!(matte_iou(&keyed, &want) > 0.98, "{}", matte_iou(&keyed, &want));
        assert_eq!((matte_iou(&want, &want), matte_iou(&clip, &clip), matte_iou(&clip, &want)), (1.0, 1.0, 0.0));

        let folder = tempfile::tempdir().unwrap();
        let write = |size: usize| {
            let file = std::fs::File::create(folder.path().join("0.png")).unwrap();
            let mut encoder = png::Encoder::new(file, size as u32, size as u32);
            encoder.set_color(png::ColorType::Rgb);
            let pixels: Vec<u8> = (0..size * size).flat_map(|i| [if i % 2 == 0 { 255 } else { 0 }; 3]).collect();
            encoder.write_header().unwrap().write_image_data(&pixels).unwrap();
        };
        let source = MatteSource::Masks(folder.path().to_owned());
        write(size);
        assert_eq!(matte_clip(clip.clone(), &nobody, &source, &mut go).unwrap().alpha[..4], [255, 0, 255, 0]);
        write(size / 2);
        assert!(matches!(matte_clip(clip.clone(), &nobody, &source, &mut go), Err(CaptureError::Masks { .. })));
    }
}
