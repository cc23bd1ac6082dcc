//! All decoders on one clip: one pass over its frames, whatever their number.

use std::ops::ControlFlow;

use heartian_signal::Protocol;
use heartian_signal::methods::Rgb;
use heartian_signal::trace::{Weighting, mean_rgb};
use heartian_space::{Clip, Progress, Rgb8Image};

use crate::preprocess::{FaceBox, HAAR_ENLARGEMENT, Pixels, resize_area};
use crate::{DecoderError, Reader, Reading, Statistics, Wave};

/// Frames between two looks for a moving face (rPPG-Toolbox's dynamic detection).
const LOOK_EVERY: usize = 30;
/// Side of the crop whose mean the toolbox's classical methods read, pixels.
const TOOLBOX_SIDE: usize = 72;

/// Which pixels the classical methods average.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Averaged {
    /// Each pixel by its alpha.
    #[default]
    Matte,
    /// The whole frame, matte or not.
    Frame,
    /// The face crop resized to 72×72, as the toolbox does.
    Face,
}

/// How the face crop is found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Cut {
    /// The box around the first frame's matte.
    #[default]
    Matte,
    /// The face seen in the first frame, enlarged by half.
    Still,
    /// The face seen in every thirtieth frame, enlarged by half.
    Moving,
    /// The whole frame.
    Frame,
}

/// How a clip is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClipOptions {
    /// For classical methods.
    pub averaged: Averaged,
    /// For networks.
    pub cut: Cut,
    /// Over what networks' inputs are normalised.
    pub statistics: Statistics,
    /// Whose detrending the classical methods share.
    pub protocol: Protocol,
}

/// Tells the edges (left, top, right, bottom; pixels) of the face in a picture.
pub type Find<'a> = &'a dyn Fn(&Rgb8Image) -> Option<[f32; 4]>;

/// What each decoder finds in a clip, in their order; the person is shown to networks over black. `None` when stopped.
///
/// # Errors
/// When the pixels to average are none: a frame without matte, or a cut outside the frame.
pub fn read_clip(
    clip: &Clip,
    readers: &[Reader],
    options: &ClipOptions,
    find: Find<'_>,
    progress: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<Option<Vec<Result<Wave, DecoderError>>>, DecoderError> {
    let means = match options.averaged {
        Averaged::Matte => Some(mean_rgb(clip, Weighting::Alpha)?),
        Averaged::Frame => Some(mean_rgb(clip, Weighting::WholeFrame)?),
        Averaged::Face => None,
    };
    let mut reading = Reading::new(readers, options.statistics);
    let pictures = means.is_none() || reading.wants_crops();
    let mut cut = None;
    let black = Rgb8Image::filled(1, 1, [0; 3]);
    for index in 0..clip.len() {
        let picture = if pictures { clip.image_over_black(index) } else { black.clone() };
        if pictures && (cut.is_none() || options.cut == Cut::Moving && index.is_multiple_of(LOOK_EVERY)) {
            cut = face_box(clip, &picture, options.cut, find).or(cut);
        }
        let whole = || Pixels::of(&picture.data, picture.width, 0..picture.height, 0..picture.width);
        let face = cut.filter(|_| pictures).and_then(|face: FaceBox| {
            let (rows, columns) = face.crop(picture.width, picture.height);
            Pixels::of(&picture.data, picture.width, rows, columns)
        });
        let Some(face) = face.or_else(whole) else { continue };
        let color =
            means.as_ref().map_or_else(|| mean_of(&resize_area(&face, (TOOLBOX_SIDE, TOOLBOX_SIDE))), |m| m[index]);
        reading.frame(clip.times_seconds[index], color, &face);
        let done = Progress { step: index as u64 + 1, total: clip.len() as u64, metric: None };
        if pictures && progress(done).is_break() {
            return Ok(None);
        }
    }
    Ok(Some(reading.finish(&options.protocol)))
}

/// The box to cut out; `None` where there is nothing to see.
fn face_box(clip: &Clip, picture: &Rgb8Image, cut: Cut, find: Find<'_>) -> Option<FaceBox> {
    match cut {
        Cut::Frame => None,
        Cut::Matte => matte_box(clip),
        Cut::Still | Cut::Moving => Some(FaceBox::from_edges(find(picture)?)?.enlarged(HAAR_ENLARGEMENT)),
    }
}

/// The box around the first frame's matte.
fn matte_box(clip: &Clip) -> Option<FaceBox> {
    /// Fainter pixels are the rim.
    const HALF: u8 = 128;
    let inside = |index: &usize| clip.frame_alpha(0)[*index] >= HALF;
    let edges = (0..clip.width * clip.height).filter(inside).fold(None, |edges, index| {
        let (x, y) = ((index % clip.width) as f32, (index / clip.width) as f32);
        let [left, top, right, bottom] = edges.unwrap_or([x, y, x + 1.0, y + 1.0]);
        Some([left.min(x), top.min(y), right.max(x + 1.0), bottom.max(y + 1.0)])
    });
    FaceBox::from_edges(edges?)
}

fn mean_of(pixels: &[u8]) -> Rgb {
    let mut sums = [0u64; 3];
    for pixel in pixels.as_chunks::<3>().0 {
        (0..3).for_each(|c| sums[c] += u64::from(pixel[c]));
    }
    sums.map(|sum| sum as f64 / (pixels.len() / 3).max(1) as f64)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use heartian_signal::{Method, Preset, SignalError};
    use heartian_space::Sequence;

    use super::*;
    use crate::bench::seeded_weights;
    use crate::{Architecture, Network, Options, measure};

    /// A grey face with a pulse on black ground; `light` scales it.
    fn clip(frames: usize, light: f64) -> Clip {
        let (width, height) = (24, 20);
        let pixel = |index: usize| {
            let (frame, x, y) = (index / 480, index % 480 % 24, index % 480 / 24);
            let inside = (4..20).contains(&x) && (3..18).contains(&y);
            let beat = (std::f64::consts::TAU * 1.5 * frame as f64 / 30.0).sin();
            let dither = (index * 7919 % 1000) as f64 / 1000.0;
            let code = |base: f64, pulse: f64| (light * (base + pulse * beat) + light.min(1.0) * dither) as u8;
            (inside, [code(150.0, 0.6), code(110.0, 1.6), code(90.0, 1.0)])
        };
        let sequence = Sequence {
            frames: (0..480 * frames).flat_map(|index| pixel(index).1).collect(),
            alpha: (0..480 * frames).map(|index| if pixel(index).0 { 255 } else { 0 }).collect(),
            times_seconds: (0..frames).map(|frame| frame as f64 / 30.0).collect(),
        };
        Clip::new("test", width, height, sequence).unwrap()
    }

    fn options(averaged: Averaged, cut: Cut, statistics: Statistics) -> ClipOptions {
        ClipOptions { averaged, cut, statistics, protocol: Preset::ToolboxFine.protocol() }
    }

    fn read(clip: &Clip, readers: &[Reader], options: &ClipOptions) -> Vec<Result<Wave, DecoderError>> {
        let find = |_: &Rgb8Image| Some([4.0, 3.0, 20.0, 18.0]);
        read_clip(clip, readers, options, &find, &mut |_| ControlFlow::Continue(())).unwrap().unwrap()
    }

    fn physnet() -> Reader {
        let weights = seeded_weights(Architecture::PhysNet).unwrap();
        Reader::neural(Network::new(&weights, &Options::default()).unwrap())
    }

    #[test]
    fn methods_read_the_pulse_whatever_is_averaged() {
        let readers = [Method::Pos, Method::Green].map(Reader::Classical);
        let clip = clip(300, 1.0);
        for averaged in [Averaged::Matte, Averaged::Frame, Averaged::Face] {
            for cut in [Cut::Matte, Cut::Still, Cut::Moving, Cut::Frame] {
                let options = options(averaged, cut, Statistics::WholeClip);
                let waves = read(&clip, &readers, &options);
                for (key, measured) in measure(&readers, waves, &options.protocol) {
                    let bpm = measured.unwrap().rate.bpm;
                    assert!((bpm - 90.0).abs() < 1.0, "{key} {averaged:?} {cut:?}: {bpm}");
                }
            }
        }
    }

    /// One chunk is the whole clip, so both statistics are the same; of two chunks the stream decodes each alike.
    #[test]
    fn networks_are_fed_chunk_by_chunk() {
        let readers = [physnet()];
        let whole = |clip: &Clip, statistics| {
            read(clip, &readers, &options(Averaged::Matte, Cut::Matte, statistics)).remove(0).unwrap()
        };
        let one = clip(128, 1.0);
        assert_eq!(whole(&one, Statistics::WholeClip), whole(&one, Statistics::PerChunk));
        let two = clip(300, 1.0);
        let (all, parts) = (whole(&two, Statistics::WholeClip), whole(&two, Statistics::PerChunk));
        assert_eq!((all.values.len(), parts.values.len()), (256, 256));
        assert_eq!(parts.values[..128], whole(&one, Statistics::PerChunk).values[..]);
        assert!(all.values.iter().all(|value| value.is_finite()));
    }

    #[test]
    fn bad_clips_get_clear_errors() {
        let readers = [Reader::Classical(Method::Pos), Reader::Classical(Method::Green), physnet()];
        let options = options(Averaged::Frame, Cut::Matte, Statistics::WholeClip);
        let short = read(&clip(40, 1.0), &readers, &options);
        assert!(matches!(short[0], Err(DecoderError::Signal(SignalError::TooShort { .. }))), "{short:?}");
        assert!(matches!(short[2], Err(DecoderError::ShortClip { frames: 40, needed: 128, .. })), "{short:?}");
        let black = read(&clip(200, 0.0), &readers, &options);
        assert!(matches!(black[0], Err(DecoderError::Signal(SignalError::Dark { .. }))), "{black:?}");
        assert!(matches!(black[2], Err(DecoderError::Still { frames: 200, .. })), "{black:?}");
        let rates = measure(&readers, black, &options.protocol);
        assert!(rates.iter().all(|(_, rate)| rate.is_err()), "a black clip has no heart rate");
        let mut bare = clip(200, 1.0);
        bare.alpha.fill(0);
        let matte = ClipOptions { averaged: Averaged::Matte, ..options };
        let refused = read_clip(&bare, &readers, &matte, &|_| None, &mut |_| ControlFlow::Continue(()));
        assert!(matches!(refused, Err(DecoderError::Signal(SignalError::Masked { frame: 0 }))));
        assert!(read(&bare, &readers, &options)[2].is_err(), "nothing but black is shown to networks");
        let stopped = read_clip(&clip(20, 1.0), &readers, &options, &|_| None, &mut |_| ControlFlow::Break(()));
        assert!(matches!(stopped, Ok(None)));
    }
}
