//! How a person before a camera moves: slow sway, talking in phrases, blinking, glances and brows.
//!
//! Everything is a smooth function of time and the seed. Angles are radians, times seconds, lengths metres.

use std::f64::consts::TAU;

use glam::{Quat, Vec3};
use heartian_face::FramePose;

use super::random::{Random, Stream};

/// Largest yaw, pitch and roll at motion scale 1.
const SWAY_RADIANS: [f64; 3] = [8.0_f64.to_radians(), 5.0_f64.to_radians(), 3.0_f64.to_radians()];
/// Largest translation along each axis at motion scale 1.
const SHIFT_METRES: f64 = 0.010;
/// Jaw rotation of a wide-open syllable.
const JAW_RADIANS: f64 = 8.0_f64.to_radians();
/// The head turns about a point this far below its origin.
const PIVOT_IN_HEAD: Vec3 = Vec3::new(0.0, -0.11, -0.02);
const BLINK_SECONDS: f64 = 0.15;

/// What a face does at one time, before a head model's own coefficients.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Gesture {
    /// Mouth opening, in [0, 1].
    pub(crate) open: f64,
    /// Mouth corners apart, in [0, 1].
    pub(crate) spread: f64,
    /// Lips rounded forward, in [0, 1].
    pub(crate) pucker: f64,
    /// A smile, in [0, 1].
    pub(crate) smile: f64,
    /// Brows up, in [−0.3, 1].
    pub(crate) brows: f64,
    /// Lids, 0 = open, 1 = closed.
    pub(crate) lids: f64,
    /// Yaw and pitch of the gaze relative to the head.
    pub(crate) gaze_radians: [f64; 2],
}

/// Mode numbers of the built-in head's expression basis.
mod mode {
    pub const SMILE: [usize; 2] = [0, 1];
    pub const STRETCH: usize = 4;
    pub const PUCKER: usize = 5;
    pub const FUNNEL: usize = 6;
    pub const UPPER_LIP_UP: usize = 7;
    pub const LOWER_LIP_DOWN: usize = 9;
    pub const INNER_BROWS_UP: usize = 15;
    pub const OUTER_BROWS_UP: [usize; 2] = [16, 17];
    pub const BROWS_DOWN: usize = 18;
}

impl Gesture {
    /// Expression coefficients of a model with `count` modes in the built-in head's order; modes beyond are left out.
    pub(crate) fn coefficients(&self, count: usize) -> Vec<f32> {
        let mut coefficients = vec![0.0f32; count];
        let mut add = |mode: usize, value: f64| {
            if let Some(coefficient) = coefficients.get_mut(mode) {
                *coefficient += value as f32;
            }
        };
        for side in 0..2 {
            add(mode::SMILE[side], 0.5 * self.smile + 0.15 * self.spread);
            add(mode::OUTER_BROWS_UP[side], 0.8 * self.brows.max(0.0));
        }
        add(mode::STRETCH, 0.6 * self.spread);
        add(mode::PUCKER, 0.7 * self.pucker);
        add(mode::FUNNEL, 0.5 * self.pucker);
        add(mode::UPPER_LIP_UP, 0.25 * self.open);
        add(mode::LOWER_LIP_DOWN, 0.35 * self.open);
        add(mode::INNER_BROWS_UP, 0.7 * self.brows.max(0.0));
        add(mode::BROWS_DOWN, (-self.brows).max(0.0));
        coefficients
    }
}

/// A recording's whole motion.
#[derive(Clone, Debug)]
pub(crate) struct Motion {
    scale: f64,
    sway: [Wander; 3],
    shift: [Wander; 3],
    brows: Wander,
    smile: Wander,
    syllables: Vec<Syllable>,
    blinks_seconds: Vec<f64>,
    glances: Vec<Glance>,
}

impl Motion {
    /// `scale` multiplies the head's sway, the mouth's and the brows' movement; blinks and glances stay.
    pub(crate) fn new(seed: u64, seconds: f64, scale: f64) -> Self {
        let random = Random::new(seed, Stream::Motion);
        let wander = |number: u64, hertz: [f64; 2]| Wander::new(random.substream(number), hertz);
        Self {
            scale,
            sway: std::array::from_fn(|axis| wander(axis as u64, [0.05, 0.35])),
            shift: std::array::from_fn(|axis| wander(3 + axis as u64, [0.04, 0.30])),
            brows: wander(6, [0.08, 0.5]),
            smile: wander(8, [0.05, 0.25]),
            syllables: speech(Random::new(seed, Stream::Speech), seconds),
            blinks_seconds: blinks(Random::new(seed, Stream::Blinks), seconds),
            glances: glances(random.substream(7), seconds),
        }
    }

    /// World-from-head at a time, as rotation and translation, for a head that rests at `rest_translation`.
    pub(crate) fn head(&self, seconds: f64, rest_translation: Vec3) -> (Quat, Vec3) {
        let [yaw, pitch, roll]: [f64; 3] =
            std::array::from_fn(|axis| self.scale * SWAY_RADIANS[axis] * self.sway[axis].at(seconds));
        let rotation = Quat::from_euler(glam::EulerRot::YXZ, yaw as f32, pitch as f32, roll as f32);
        let shift = Vec3::from_array(std::array::from_fn(|axis| {
            (self.scale * SHIFT_METRES * self.shift[axis].at(seconds)) as f32
        }));
        (rotation, rest_translation + shift + PIVOT_IN_HEAD - rotation * PIVOT_IN_HEAD)
    }

    /// What the face does at a time.
    pub(crate) fn gesture(&self, seconds: f64) -> Gesture {
        let smile = self.scale * smooth(self.smile.at(seconds) * 1.5);
        let brows = self.scale * brow_height(self.brows.at(seconds));
        let mut gesture = Gesture { smile, brows, ..Gesture::default() };
        for syllable in &self.syllables {
            let bump = self.scale * bump((seconds - syllable.seconds) / syllable.width_seconds);
            gesture.open += syllable.open * bump;
            gesture.spread += syllable.spread * bump;
            gesture.pucker += syllable.pucker * bump;
        }
        for value in [&mut gesture.open, &mut gesture.spread, &mut gesture.pucker] {
            *value = value.min(1.2);
        }
        gesture.lids =
            self.blinks_seconds.iter().map(|blink| lid((seconds - blink) / BLINK_SECONDS)).fold(0.0, f64::max);
        gesture.gaze_radians = self.gaze(seconds);
        gesture
    }

    /// The pose of a model's rigid parts: head, jaw and eyes. Expression and lids are left to the caller.
    pub(crate) fn pose(&self, seconds: f64, rest_translation: Vec3, expression_count: usize) -> (FramePose, Gesture) {
        let gesture = self.gesture(seconds);
        let (rotation, translation) = self.head(seconds, rest_translation);
        let [yaw, pitch] = gesture.gaze_radians;
        let eye = [pitch as f32, yaw as f32, 0.0];
        let pose = FramePose {
            rotation: rotation.to_scaled_axis().to_array(),
            translation: translation.to_array(),
            jaw: [(JAW_RADIANS * gesture.open) as f32, 0.0, 0.0],
            eyes: [eye, eye],
            eyelids: [gesture.lids as f32; 2],
            fitted: true,
            ..FramePose::rest(expression_count)
        };
        (pose, gesture)
    }

    fn gaze(&self, seconds: f64) -> [f64; 2] {
        let after = self.glances.partition_point(|glance| glance.seconds <= seconds);
        let target = |number: usize| self.glances.get(number).map_or([0.0; 2], |glance| glance.gaze_radians);
        if after == 0 {
            return [0.0; 2];
        }
        // A saccade takes about 50 ms.
        let done = smooth((seconds - self.glances[after - 1].seconds) / 0.05);
        let (from, to) = (if after >= 2 { target(after - 2) } else { [0.0; 2] }, target(after - 1));
        std::array::from_fn(|axis| from[axis] + done * (to[axis] - from[axis]))
    }
}

/// A smooth random walk in [−1, 1]: four sines of unrelated frequencies.
#[derive(Clone, Copy, Debug)]
struct Wander {
    terms: [[f64; 3]; 4],
}

impl Wander {
    fn new(random: Random, [low_hertz, high_hertz]: [f64; 2]) -> Self {
        // Slower terms are stronger; the weights sum to 1.
        const WEIGHTS: [f64; 4] = [0.40, 0.28, 0.20, 0.12];
        let terms = std::array::from_fn(|term| {
            let within = (term as f64 + random.uniform(2 * term as u64)) / 4.0;
            let hertz = low_hertz * (high_hertz / low_hertz).powf(within);
            [hertz, random.between(2 * term as u64 + 1, 0.0, TAU), WEIGHTS[term]]
        });
        Self { terms }
    }

    fn at(&self, seconds: f64) -> f64 {
        self.terms.iter().map(|[hertz, phase, weight]| weight * (TAU * hertz * seconds + phase).sin()).sum()
    }
}

#[derive(Clone, Copy, Debug)]
struct Syllable {
    seconds: f64,
    width_seconds: f64,
    open: f64,
    spread: f64,
    pucker: f64,
}

/// Phrases of one and a half to four seconds with pauses between them; three to six syllables a second.
fn speech(random: Random, seconds: f64) -> Vec<Syllable> {
    let mut syllables = Vec::new();
    let (mut time, mut phrase) = (random.between(0, 0.2, 0.9), 0u64);
    while time < seconds + 1.0 {
        phrase += 1;
        let phrase_random = random.substream(phrase);
        let end = time + phrase_random.between(0, 1.5, 4.0);
        let mut count = 0u64;
        while time < end {
            count += 1;
            let draw = |what: u64, low: f64, high: f64| phrase_random.between(8 * count + what, low, high);
            let step = draw(0, 0.17, 0.32);
            let vowel = draw(1, -1.0, 1.0);
            syllables.push(Syllable {
                seconds: time + step / 2.0,
                width_seconds: 1.5 * step,
                open: draw(2, 0.15, 0.85),
                spread: vowel.max(0.0) * draw(3, 0.2, 0.8),
                pucker: (-vowel).max(0.0) * draw(4, 0.2, 0.8),
            });
            time += step;
        }
        time = end + phrase_random.between(1, 0.6, 1.8);
    }
    syllables
}

fn blinks(random: Random, seconds: f64) -> Vec<f64> {
    let mut times = Vec::new();
    let mut time = random.between(0, 0.5, 2.5);
    while time < seconds {
        times.push(time);
        time += random.between(times.len() as u64, 2.0, 5.0);
    }
    times
}

#[derive(Clone, Copy, Debug)]
struct Glance {
    seconds: f64,
    gaze_radians: [f64; 2],
}

fn glances(random: Random, seconds: f64) -> Vec<Glance> {
    let mut list: Vec<Glance> = Vec::new();
    let mut time = random.between(0, 0.3, 1.0);
    while time < seconds {
        let draw = random.substream(list.len() as u64 + 1);
        // Every other glance returns to the camera.
        let size = if list.len().is_multiple_of(2) { 1.0 } else { 0.15 };
        let gaze_radians = [size * draw.between(0, -0.12, 0.12), size * draw.between(1, -0.06, 0.06)];
        list.push(Glance { seconds: time, gaze_radians });
        time += draw.between(2, 0.6, 2.4);
    }
    list
}

/// A raised cosine over [−0.5, 0.5], 1 at 0.
fn bump(x: f64) -> f64 {
    if x.abs() < 0.5 { 0.5 + 0.5 * (TAU * x).cos() } else { 0.0 }
}

/// Lids close in the first 40 % of a blink and open over the rest.
fn lid(x: f64) -> f64 {
    if (0.0..0.4).contains(&x) {
        smooth(x / 0.4)
    } else if (0.4..1.0).contains(&x) {
        1.0 - smooth((x - 0.4) / 0.6)
    } else {
        0.0
    }
}

/// Mostly at rest, now and then up, seldom a little down.
fn brow_height(wander: f64) -> f64 {
    if wander > 0.0 { smooth(wander * 1.6) } else { 0.3 * wander }
}

fn smooth(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use heartian_face::HeadModel;

    #[test]
    fn motion_stays_within_its_bounds_and_is_smooth() {
        let motion = Motion::new(3, 60.0, 1.0);
        let rest = Vec3::new(0.0, 0.0, -1.0);
        let mut before: Option<(Quat, Gesture)> = None;
        for step in 0..6000 {
            let seconds = f64::from(step) * 0.01;
            let (rotation, translation) = motion.head(seconds, rest);
            let (yaw, pitch, roll) = rotation.to_euler(glam::EulerRot::YXZ);
            for (angle, limit) in [yaw, pitch, roll].into_iter().zip(SWAY_RADIANS) {
                assert!(f64::from(angle.abs()) <= limit + 1e-5);
            }
            assert!((translation - rest).length() < 0.05);
            let gesture = motion.gesture(seconds);
            if let Some((last, previous)) = before {
                assert!(last.angle_between(rotation) < 0.01, "a head turns slowly");
                assert!((gesture.open - previous.open).abs() < 0.25 && (gesture.lids - previous.lids).abs() < 0.4);
            }
            before = Some((rotation, gesture));
        }
    }

    #[test]
    fn eyes_close_every_few_seconds_and_mouths_rest_between_phrases() {
        let motion = Motion::new(8, 60.0, 1.0);
        assert!(motion.blinks_seconds.windows(2).all(|pair| (2.0..5.0).contains(&(pair[1] - pair[0]))));
        let at = |share: fn(&Gesture) -> bool| {
            (0..6000).filter(|step| share(&motion.gesture(f64::from(*step) * 0.01))).count() as f64 / 6000.0
        };
        let (closed, silent, open) = (at(|g| g.lids > 0.5), at(|g| g.open < 0.01), at(|g| g.open > 0.4));
        assert!((0.005..0.08).contains(&closed), "{closed}");
        assert!((0.1..0.6).contains(&silent) && open > 0.1, "{silent} {open}");
    }

    /// The mode numbers are the built-in head's; should its order change, this says so.
    #[test]
    fn gestures_move_the_built_in_head_as_their_names_say() {
        let head = HeadModel::procedural();
        let landmark = |gesture: Gesture, index: u32| {
            let pose = FramePose {
                expression: gesture.coefficients(head.expression.count),
                ..FramePose::rest(head.expression.count)
            };
            let vertices = head.pose(&pose);
            let anchor = head.landmarks.iter().find(|anchor| anchor.index == index);
            anchor.map_or(Vec3::NAN, |anchor| Vec3::from_array(head.landmark_position(anchor, &vertices)))
        };
        let moved = |gesture: Gesture, index: u32| landmark(gesture, index) - landmark(Gesture::default(), index);
        let (left_corner, upper_lip, lower_lip, inner_brow, outer_brow) = (291, 0, 17, 336, 293);
        let least = 1e-3;
        assert!(moved(Gesture { spread: 1.0, ..Gesture::default() }, left_corner).x > least);
        assert!(moved(Gesture { smile: 1.0, ..Gesture::default() }, left_corner).y > least);
        let pucker = Gesture { pucker: 1.0, ..Gesture::default() };
        assert!(moved(pucker, left_corner).x < -least && moved(pucker, upper_lip).z > least);
        let open = Gesture { open: 1.0, ..Gesture::default() };
        assert!(moved(open, lower_lip).y < -least && moved(open, upper_lip).y > 0.5 * least);
        let up = Gesture { brows: 1.0, ..Gesture::default() };
        assert!(moved(up, inner_brow).y > least && moved(up, outer_brow).y > least);
        assert!(moved(Gesture { brows: -0.3, ..Gesture::default() }, inner_brow).y < -0.5 * least);
    }

    #[test]
    fn scale_zero_is_a_still_head() {
        let motion = Motion::new(8, 10.0, 0.0);
        let rest = Vec3::new(0.0, 0.0, -1.0);
        assert_eq!(motion.head(1.0, rest), motion.head(7.3, rest));
        assert_eq!(motion.gesture(2.0).open, 0.0);
    }
}
