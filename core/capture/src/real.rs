//! A real recording: video in; head crop, matte and landmarks out.
//!
//! The video is read three times and never held whole: to follow the face, to look at what the person wears, and to cut
//! out the square that holds the head ([`CropMotion`]: fixed, or going with it). Landmarks come in pixels of the crop, raw (the tracker smooths), and `None` where no
//! face is seen. Frame times are those of the recording, so that a pulse trace on the same clock stays aligned when
//! `start_seconds` is not 0.

use std::ops::ControlFlow;
use std::path::Path;

use heartian_face::models::FaceNets;
use heartian_face::nets::{FaceFollower, FaceLandmarks};
use heartian_face::{Landmark, Observations};
use heartian_space::{Clip, Progress, Rgb8Image, Sequence};
use rayon::prelude::*;

use crate::CaptureError;
use crate::crop::{CropMotion, CropSquare, Cropper, Points};
use crate::matte::{Body, Evidence, LOOKS, nearest_face, refine};
use crate::video::{self, VideoOptions};

/// Full frames held at once.
const BATCH_FRAMES: usize = 16;
/// The most memory for frames and matte.
const LARGEST_CLIP_BYTES: usize = 6 << 30;

/// Which part of a recording to take, and how.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RealOptions {
    /// Where to begin, seconds from the recording's start.
    pub start_seconds: f64,
    /// How much to take, seconds; infinite for all.
    pub seconds: f64,
    /// Side of the crop, pixels, 32–4096.
    pub size: usize,
    /// How the crop lies over the clip.
    pub crop: CropMotion,
    /// Whether to cut the head out; without, alpha is 255 wherever the camera saw.
    pub matte: bool,
    /// Frame rate of a folder of pictures that has no file of times.
    pub folder_hertz: f64,
    /// Rate to which uneven frames are brought, hertz; as they are when left out.
    pub resample_hertz: Option<f64>,
    /// Which face is followed where there are several: 0 the largest, 1 the next, and so on.
    pub face: usize,
}

impl Default for RealOptions {
    fn default() -> Self {
        Self {
            start_seconds: 0.0,
            seconds: f64::INFINITY,
            size: 256,
            crop: CropMotion::Fixed,
            matte: true,
            folder_hertz: 30.0,
            resample_hertz: None,
            face: 0,
        }
    }
}

/// A recording ready for the tracker and the trainer.
#[derive(Clone, Debug, PartialEq)]
pub struct RealRecording {
    /// The clip labelled `input`.
    pub clip: Clip,
    /// Landmarks of every frame, in pixels of the clip.
    pub observations: Observations,
    /// Where each frame lies in the source.
    pub squares: Vec<CropSquare>,
    /// What was doubtful in the source and read all the same, a line each.
    pub warnings: Vec<String>,
}

/// Reads a recording. Progress runs over twice the frames: following, then cutting.
///
/// # Errors
/// Options out of range; everything a video reader can meet; networks not installed; no face in any frame; cancelled.
pub fn load_real(
    source: &Path,
    options: &RealOptions,
    progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<RealRecording, CaptureError> {
    check(options)?;
    let nets = FaceNets::load()?;
    let followed = follow(source, options, &nets, progress)?;
    let faces: Vec<Option<&Points>> =
        followed.faces.iter().map(|face| face.as_ref().map(|face| face.points_px.as_slice())).collect();
    let Some(squares) = options.crop.squares(&faces, &followed.times_seconds) else {
        let frames = followed.faces.len();
        return Err(CaptureError::NoFace { source_path: source.to_owned(), frames });
    };
    let seen = |(face, square): (&Option<FaceLandmarks>, &CropSquare)| {
        face.as_ref().map(|face| landmarks(face, *square, options.size))
    };
    let frames = followed.faces.iter().zip(&squares).map(seen);
    let observations = Observations::new(options.size, options.size, followed.times_seconds.clone(), frames.collect())?;
    let cutter = Cutter {
        options,
        nets: &nets,
        squares: &squares,
        frame_size: followed.frame_size,
        observations: &observations,
    };
    let clip = cutter.cut(source, progress)?;
    Ok(RealRecording { clip, observations, squares, warnings: followed.warnings })
}

fn check(options: &RealOptions) -> Result<(), CaptureError> {
    let size = options.size as f64;
    for (name, value, range, fine) in [
        ("seconds", options.seconds, "positive", options.seconds > 0.0),
        ("start_seconds", options.start_seconds, "0 or more, and finite", (0.0..1e9).contains(&options.start_seconds)),
        ("size", size, "from 32 to 4096 pixels", (32.0..=4096.0).contains(&size)),
    ] {
        if !fine {
            return Err(CaptureError::Option { name, value, range });
        }
    }
    Ok(())
}

/// What the first pass learns.
struct Followed {
    times_seconds: Vec<f64>,
    faces: Vec<Option<FaceLandmarks>>,
    frame_size: (usize, usize),
    warnings: Vec<String>,
}

/// Calls `each` with every frame of the chosen part, while a thread decodes the frames after it.
fn for_each_frame(
    source: &Path,
    options: &RealOptions,
    mut each: impl FnMut(f64, Rgb8Image) -> Result<(), CaptureError>,
) -> Result<Vec<String>, CaptureError> {
    let RealOptions { start_seconds, folder_hertz, resample_hertz, .. } = *options;
    let reading = VideoOptions { start_seconds, folder_hertz, resample_hertz };
    let video = video::open(source, &reading)?;
    let mut first = None;
    video::for_each_frame(video, |frame| {
        let from = *first.get_or_insert(frame.seconds);
        if frame.seconds - from >= options.seconds - 1e-6 {
            return Ok(ControlFlow::Break(()));
        }
        each(frame.seconds, frame.image)?;
        Ok(ControlFlow::Continue(()))
    })
}

fn follow(
    source: &Path,
    options: &RealOptions,
    nets: &FaceNets,
    progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<Followed, CaptureError> {
    let mut follower =
        FaceFollower::new(&nets.detector, &nets.landmarks).with_irises(nets.irises.as_ref()).of_rank(options.face);
    let mut followed =
        Followed { times_seconds: Vec::new(), faces: Vec::new(), frame_size: (0, 0), warnings: Vec::new() };
    let frame_bytes = options.size * options.size * 4;
    let warnings = for_each_frame(source, options, |seconds, image| {
        followed.frame_size = (image.width, image.height);
        followed.faces.push(follower.next(&image)?);
        followed.times_seconds.push(seconds);
        let frames = followed.faces.len();
        if frames * frame_bytes > LARGEST_CLIP_BYTES {
            let gibibytes = (frames * frame_bytes) as f64 / f64::from(1 << 30);
            return Err(CaptureError::TooLarge { frames, size: options.size, gibibytes });
        }
        let seen = followed.faces.iter().flatten().count() as f64 / frames as f64;
        report(progress, Progress { step: frames as u64, total: 0, metric: Some(("faces_seen", seen)) })
    })?;
    Ok(Followed { warnings, ..followed })
}

fn report(progress: &mut dyn FnMut(Progress) -> ControlFlow<()>, said: Progress) -> Result<(), CaptureError> {
    if progress(said).is_break() { Err(CaptureError::Cancelled) } else { Ok(()) }
}

fn landmarks(face: &FaceLandmarks, square: CropSquare, size: usize) -> Vec<Landmark> {
    let points = face.points_px.iter().enumerate();
    let landmark = |(index, [x, y, _]): (usize, &[f32; 3])| Landmark {
        index: index as u32,
        position_px: square.crop_from_source([*x, *y], size),
        weight: face.presence,
    };
    points.map(landmark).collect()
}

/// Cuts the head out of every frame, once the first pass knows where it is.
struct Cutter<'a> {
    options: &'a RealOptions,
    nets: &'a FaceNets,
    squares: &'a [CropSquare],
    frame_size: (usize, usize),
    observations: &'a Observations,
}

impl Cutter<'_> {
    /// The cropper of a frame; a video that grew since it was followed keeps the last one.
    fn cropper(&self, frame: usize) -> Cropper {
        let square = self.squares[frame.min(self.squares.len() - 1)];
        Cropper::new(square, self.frame_size, self.options.size)
    }

    /// Looks at frames spread over the recording: how the head sits on its neck, and what the person wears.
    fn body(
        &self,
        source: &Path,
        progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
    ) -> Result<Option<Body>, CaptureError> {
        let total = self.observations.len();
        let mut go_on = || progress(Progress { step: total as u64, total: 2 * total as u64, metric: None });
        let Some(mut body) = Body::fitted(self.observations, &mut go_on)? else { return Ok(None) };
        let mut frame = 0;
        for_each_frame(source, self.options, |_, image| {
            if frame % total.div_ceil(LOOKS) == 0 {
                let crop = self.cropper(frame).crop(&image);
                let probability = self.nets.person.probability(&crop)?;
                body.look(frame, &crop, &probability, &nearest_face(self.observations, frame));
            }
            frame += 1;
            if go_on().is_break() { Err(CaptureError::Cancelled) } else { Ok(()) }
        })?;
        Ok(Some(body))
    }

    /// The last pass: crops and mattes, in batches over all cores; frames keep their order.
    fn cut(&self, source: &Path, progress: &mut dyn FnMut(Progress) -> ControlFlow<()>) -> Result<Clip, CaptureError> {
        let (size, total) = (self.options.size, self.observations.len());
        let body = if self.options.matte { self.body(source, progress)? } else { None };
        let mut frames = Vec::with_capacity(total * size * size * 3);
        let mut alpha = Vec::with_capacity(total * size * size);
        let mut batch: Vec<Rgb8Image> = Vec::with_capacity(BATCH_FRAMES);
        let mut flush = |batch: &mut Vec<Rgb8Image>| -> Result<(), CaptureError> {
            let first = alpha.len() / (size * size);
            let cut_one = |(i, image): (usize, &Rgb8Image)| self.cut_one((first + i, image), body.as_ref());
            for done in batch.par_iter().enumerate().map(cut_one).collect::<Vec<_>>() {
                let (crop, matte) = done?;
                frames.extend_from_slice(&crop.data);
                alpha.extend_from_slice(&matte);
            }
            batch.clear();
            let step = (total + alpha.len() / (size * size)) as u64;
            report(progress, Progress { step, total: 2 * total as u64, metric: None })
        };
        for_each_frame(source, self.options, |_, image| {
            batch.push(image);
            if batch.len() == BATCH_FRAMES { flush(&mut batch) } else { Ok(()) }
        })?;
        flush(&mut batch)?;
        let sequence = Sequence { frames, alpha, times_seconds: self.observations.times_seconds.clone() };
        Ok(Clip::new("input", size, size, sequence)?)
    }

    fn cut_one(
        &self,
        (frame, image): (usize, &Rgb8Image),
        body: Option<&Body>,
    ) -> Result<(Rgb8Image, Vec<u8>), CaptureError> {
        let cropper = self.cropper(frame);
        let (mut crop, coverage) = (cropper.crop(image), cropper.coverage());
        if !self.options.matte {
            return Ok((crop, coverage.iter().map(|part| (part * 255.0 + 0.5) as u8).collect()));
        }
        let probability = self.nets.person.probability(&crop)?;
        let (face, cut) = (nearest_face(self.observations, frame), body.map(|body| body.cut(frame, &crop)));
        let evidence = Evidence { probability: &probability, coverage: &coverage, face: &face, body: cut.as_ref() };
        let matte = refine(&mut crop, &evidence);
        Ok((crop, matte))
    }
}

#[cfg(test)]
mod tests;
