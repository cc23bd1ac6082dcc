//! What must never happen to a fit: whatever is wrong with frames, mattes, track, light or parameters, every parameter of
//! the avatar is finite, or the fit is refused with a word of what to do.

use std::ops::ControlFlow;

use heartian_artifact::BundleReader;
use heartian_face::{FramePose, Track};
use heartian_space::{Clip, Host, Progress, Sequence};

use crate::{Avatar, AvatarError, TrainOptions, TrainReport, phantom, train};

const SIDE: usize = 28;
const FRAMES: usize = 8;

fn brief() -> TrainOptions {
    TrainOptions { steps: 16, gaussians: 150, ..TrainOptions::default() }
}

fn attempt(clip: &Clip, track: &Track) -> Result<(Avatar, TrainReport), AvatarError> {
    train(clip, track, &brief(), &mut |_: Progress| ControlFlow::Continue(()))
}

fn is_sound(avatar: &Avatar) -> bool {
    let poses = avatar.states.iter().flat_map(|state| state.pose);
    let coefficients = avatar.states.iter().flat_map(|state| &state.coefficients).map(|c| f64::from(*c));
    let light = avatar.environment.radiance.iter().flatten().map(|r| f64::from(*r));
    avatar.canonical.first_not_finite().is_none() && poses.chain(coefficients).chain(light).all(f64::is_finite)
}

/// A clip whose pixels and matte are what the function says of (frame, pixel).
fn painted(clip: &Clip, paint: impl Fn(usize, usize) -> ([u8; 3], u8)) -> Result<Clip, AvatarError> {
    let pixels = clip.width * clip.height;
    let all = (0..clip.len()).flat_map(|frame| (0..pixels).map(move |pixel| (frame, pixel)));
    let (colors, alpha): (Vec<[u8; 3]>, Vec<u8>) = all.map(|(frame, pixel)| paint(frame, pixel)).unzip();
    let sequence =
        Sequence { frames: colors.as_flattened().to_vec(), alpha, times_seconds: clip.times_seconds.clone() };
    Ok(Clip::new("input", clip.width, clip.height, sequence)?)
}

#[test]
fn no_picture_and_no_matte_poisons_a_parameter() -> Result<(), AvatarError> {
    let (clip, track) = phantom::recording(SIDE, FRAMES);
    let noise = |frame: usize, pixel: usize| (((frame * 7919 + pixel) * 2_654_435_761) >> 11) as u8;
    let own = |frame: usize, pixel: usize| -> [u8; 3] {
        let at = 3 * (frame * SIDE * SIDE + pixel);
        [clip.frames[at], clip.frames[at + 1], clip.frames[at + 2]]
    };
    let own_alpha = |frame: usize, pixel: usize| clip.alpha[frame * SIDE * SIDE + pixel];
    let spoiled: [(&str, Clip); 7] = [
        ("black", painted(&clip, |f, p| ([0; 3], own_alpha(f, p)))?),
        ("saturated", painted(&clip, |f, p| ([255; 3], own_alpha(f, p)))?),
        ("noise", painted(&clip, |f, p| ([noise(f, p), noise(f, 2 * p), noise(f, 3 * p)], noise(f, 5 * p)))?),
        ("no matte", painted(&clip, |f, p| (own(f, p), 0))?),
        ("all matte", painted(&clip, |f, p| (own(f, p), 255))?),
        (
            "matte empty in half of the frames",
            painted(&clip, |f, p| (own(f, p), if f % 2 == 0 { 0 } else { own_alpha(f, p) }))?,
        ),
        ("flashes", painted(&clip, |f, p| ([if f % 2 == 0 { 0 } else { 255 }; 3], own_alpha(f, p)))?),
    ];
    for (name, clip) in &spoiled {
        let (avatar, report) = attempt(clip, &track)?;
        assert!(is_sound(&avatar) && report.training.psnr_db.is_finite(), "{name}");
    }
    Ok(())
}

/// Each number of a pose.
fn numbers(pose: &mut FramePose) -> Vec<&mut f32> {
    let FramePose { rotation, translation, neck, jaw, eyes, eyelids, expression, .. } = pose;
    let [left, right] = eyes;
    let rigid = [rotation, translation, neck, jaw, left, right].into_iter().flatten();
    rigid.chain(eyelids).chain(expression).collect()
}

#[test]
fn no_track_poisons_a_parameter() {
    let (clip, track) = phantom::recording(SIDE, FRAMES);
    let count = numbers(&mut track.frames[0].clone()).len();
    for poison in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, -1e30, 1e4, 1e-40] {
        for slot in 0..count {
            let mut poisoned = track.clone();
            *numbers(&mut poisoned.frames[2]).swap_remove(slot) = poison;
            match attempt(&clip, &poisoned) {
                Ok((avatar, _)) => assert!(poison.is_finite() && is_sound(&avatar), "{poison} in {slot}"),
                Err(AvatarError::PoseNotFinite { frame: 2 }) => assert!(!poison.is_finite()),
                Err(error) => panic!("{poison} in {slot}: {error}"),
            }
        }
    }
}

/// Gives a state once, takes any.
struct Resuming(Option<Vec<u8>>, u64);

impl Host for Resuming {
    fn progress(&mut self, report: Progress) -> ControlFlow<()> {
        if report.step == self.1 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
    fn resume(&mut self) -> Option<Vec<u8>> {
        self.0.clone()
    }
    fn checkpoint(&mut self, state: &mut dyn FnMut() -> Option<Vec<u8>>) {
        self.0 = state();
    }
}

#[test]
fn a_state_with_a_poisoned_parameter_moment_or_light_is_refused() -> Result<(), Box<dyn std::error::Error>> {
    let (clip, track) = phantom::recording(SIDE, FRAMES);
    let whole = attempt(&clip, &track)?;
    let mut host = Resuming(None, 12);
    assert!(train(&clip, &track, &brief(), &mut host).is_err());
    let state = host.0.unwrap_or_default();
    for name in ["values.0", "values.4", "values.7", "first.1", "second.3", "light", "light.second", "offsets"] {
        let bytes = poisoned(&state, name)?;
        let mut host = Resuming(Some(bytes), 0);
        assert!(train(&clip, &track, &brief(), &mut host)? == whole, "{name}");
    }
    Ok(())
}

/// The state with one value of a tensor not finite.
fn poisoned(state: &[u8], name: &str) -> Result<Vec<u8>, Box<dyn std::error::Error>> {
    let reader = BundleReader::new(state)?;
    let at = if name == "offsets" {
        bytes_of(&reader.tensor::<f64>(name)?.1.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>(), state)
    } else {
        bytes_of(&reader.tensor::<f32>(name)?.1.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>(), state)
    };
    let at = at.ok_or("the tensor is not in the state")?;
    let mut state = state.to_vec();
    let nan = if name == "offsets" { f64::NAN.to_le_bytes().to_vec() } else { f32::NAN.to_le_bytes().to_vec() };
    state[at..at + nan.len()].copy_from_slice(&nan);
    Ok(state)
}

/// Where the bytes of a tensor stand in the file.
fn bytes_of(tensor: &[u8], file: &[u8]) -> Option<usize> {
    (0..file.len().checked_sub(tensor.len())?).find(|&at| file[at..].starts_with(tensor))
}

#[test]
fn one_frame_is_too_few_and_says_so() {
    let (clip, track) = phantom::recording(SIDE, 1);
    assert!(matches!(attempt(&clip, &track), Err(AvatarError::TooLittle { .. })));
}
