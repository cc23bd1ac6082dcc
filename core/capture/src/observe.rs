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
    let mut follower = FaceFollower::new(&nets.detector, &nets.landmarks).with_irises(nets.irises.as_ref());
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

#[cfg(test)]
mod tests {
    //! Frames of `../shared/data/franck.mp4`; without it, or without the installed networks, these say so and pass.
    use std::error::Error;
    use std::path::Path;

    use heartian_face::{FaceError, HeadModel, TrackOptions, track};
    use heartian_space::Sequence;

    use super::*;
    use crate::video::{self, VideoOptions};

    fn go(_: Progress) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    type Prepared = Option<(FaceNets, Vec<Rgb8Image>)>;

    /// The networks and the recording's first frames; `None` without them, having said why.
    fn frames(count: usize) -> Result<Prepared, Box<dyn Error>> {
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/franck.mp4");
        let Ok(nets) = FaceNets::load() else {
            println!("skipped: the face models are not installed (`heartian models install`)");
            return Ok(None);
        };
        if !source.exists() {
            println!("skipped: ../shared/data is not there");
            return Ok(None);
        }
        let mut found = Vec::new();
        let video = video::open(&source, &VideoOptions::default())?;
        video::for_each_frame(video, |frame| {
            found.push(frame.image);
            Ok::<_, CaptureError>(if found.len() < count { ControlFlow::Continue(()) } else { ControlFlow::Break(()) })
        })?;
        Ok(Some((nets, found)))
    }

    fn clip(frames: &[Rgb8Image]) -> Result<Clip, Box<dyn Error>> {
        let (width, height) = (frames[0].width, frames[0].height);
        let sequence = Sequence {
            frames: frames.iter().flat_map(|frame| frame.data.iter().copied()).collect(),
            alpha: vec![255; frames.len() * width * height],
            times_seconds: (0..frames.len()).map(|t| t as f64 / 25.0).collect(),
        };
        Ok(Clip::new("input", width, height, sequence)?)
    }

    fn halved(image: &Rgb8Image) -> Rgb8Image {
        let mut small = Rgb8Image::filled(image.width / 2, image.height / 2, [0; 3]);
        for y in 0..small.height {
            (0..small.width).for_each(|x| small.set_pixel(x, y, image.pixel(2 * x, 2 * y)));
        }
        small
    }

    #[test]
    fn of_two_faces_the_larger_is_followed_or_the_one_asked_for() -> Result<(), Box<dyn Error>> {
        let Some((nets, frames)) = frames(1)? else { return Ok(()) };
        let (one, small) = (&frames[0], halved(&frames[0]));
        let mut both = Rgb8Image::filled(one.width + small.width, one.height, [40; 3]);
        both.paste(one, 0, 0);
        both.paste(&small, one.width, 0);
        for (rank, right) in [(0, false), (1, true)] {
            let mut follower = FaceFollower::new(&nets.detector, &nets.landmarks).of_rank(rank);
            let face = follower.next(&both)?.ok_or("no face")?;
            assert_eq!(face.points_px[1][0] > one.width as f32, right, "rank {rank}");
        }
        Ok(())
    }

    #[test]
    fn three_black_seconds_are_a_marked_gap_and_a_black_clip_is_refused() -> Result<(), Box<dyn Error>> {
        let Some((_, mut frames)) = frames(20)? else { return Ok(()) };
        let black = Rgb8Image::filled(frames[0].width, frames[0].height, [0; 3]);
        let after = frames.split_off(12);
        let gap = frames.len()..frames.len() + 75;
        frames.extend(vec![black.clone(); gap.len()]);
        frames.extend(after);
        let observations = observe_clip(&clip(&frames)?, &mut go)?;
        let found = track(&HeadModel::procedural(), &observations, &TrackOptions::default(), &mut go)?;
        for (t, pose) in found.frames.iter().enumerate() {
            assert_eq!(pose.fitted, !gap.contains(&t), "frame {t}");
            assert!(pose.is_finite());
        }
        let dark = observe_clip(&clip(&vec![black; 3])?, &mut go)?;
        let refused = track(&HeadModel::procedural(), &dark, &TrackOptions::default(), &mut go);
        assert!(matches!(refused, Err(FaceError::NoFace { frames: 3 })));
        Ok(())
    }
}
