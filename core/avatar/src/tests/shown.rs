//! What is shown of an avatar and given away: turntable, and one pose as plain Gaussians.

use heartian_space::{Camera, Clip};
use heartian_splat::{RasterOptions, psnr};

use super::{fitted, render_clip};
use crate::evaluate::planar;
use crate::{AvatarError, BakedPose, RenderOptions, TurntableOptions, bake, turntable};

fn covered(clip: &Clip, frame: usize) -> usize {
    clip.frame_alpha(frame).iter().filter(|alpha| **alpha > 127).count()
}

#[test]
fn a_turntable_is_a_loop_that_starts_at_the_front() -> Result<(), AvatarError> {
    let (_, _, avatar, _) = fitted()?;
    let options = TurntableOptions { seconds: 2.0, frames_per_second: 4.0, size: Some(48), ..Default::default() };
    let clip = turntable(&avatar, None, &options)?;
    assert_eq!((clip.len(), clip.width, clip.label.as_str()), (8, 48, "turntable"));
    // The ball looks the same size from everywhere that was seen; both halves of the loop pass the front.
    assert!((0..8).all(|frame| covered(&clip, frame) > covered(&clip, 0) / 2));
    assert_eq!(clip.frame(0), clip.frame(4));
    assert_ne!(clip.frame(2), clip.frame(6));
    let wrong = |options: TurntableOptions| turntable(&avatar, None, &options).is_err();
    assert!(wrong(TurntableOptions { most_degrees: f64::NAN, ..options }));
    assert!(wrong(TurntableOptions { seconds: 0.0, ..options }));
    assert!(wrong(TurntableOptions { seconds: 1e9, ..options }));
    assert!(wrong(TurntableOptions { frame: Some(1000), ..options }));
    Ok(())
}

/// No frame ever showed the back of the ball: it is closed all the same.
#[test]
fn the_back_of_the_head_is_closed() -> Result<(), AvatarError> {
    let (_, _, avatar, _) = fitted()?;
    let options = TurntableOptions { seconds: 4.0, frames_per_second: 1.0, most_degrees: 180.0, ..Default::default() };
    let clip = turntable(&avatar, None, &options)?;
    let (front, back) = (0, 1);
    assert!(covered(&clip, back) as f64 > 0.93 * covered(&clip, front) as f64);
    // The middle of the picture, half a radius around.
    let mut middle = (22..42).flat_map(|x| (22..42).map(move |y| y * clip.width + x));
    assert!(middle.all(|pixel| clip.frame_alpha(back)[pixel] > 230));
    Ok(())
}

#[test]
fn a_baked_pose_looks_like_its_frame_to_a_program_that_knows_no_light() -> Result<(), AvatarError> {
    let (_, track, avatar, _) = fitted()?;
    let rendered = render_clip(&avatar, &track, &RenderOptions::default())?;
    let scene = bake(&avatar, BakedPose::Frame(3), None)?;
    let activated = scene.activate();
    // The file's frame is that of a camera at the origin that looks along +z with y down.
    let rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let camera = Camera { rotation, ..avatar.camera };
    let (_, frame) = heartian_splat::render(&scene.view(&activated), &camera, &RasterOptions::default())?;
    let likeness = psnr(&frame.planes, &planar(&rendered, 3))?;
    assert!(likeness > 25.0, "{likeness}");
    let neutral = bake(&avatar, BakedPose::Neutral, None)?;
    assert_eq!(neutral.means.len(), avatar.len());
    assert!(neutral.colors.iter().flatten().all(|c| (0.0..=1.0).contains(c)));
    assert!(matches!(bake(&avatar, BakedPose::Frame(999), None), Err(AvatarError::Index { index: 999, .. })));
    Ok(())
}
