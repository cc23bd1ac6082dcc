//! Closing the eyes of a head that has no shape for it: the upper lid slides over the eyeball to the lower one.

use crate::HeadModel;
use crate::model::{Basis, LandmarkAnchor, joint};

/// From one corner of the eye to the other along the upper and along the lower lid; the subject's left eye, then the right.
const UPPER: [[u32; 9]; 2] =
    [[263, 466, 388, 387, 386, 385, 384, 398, 362], [33, 246, 161, 160, 159, 158, 157, 173, 133]];
const LOWER: [[u32; 9]; 2] =
    [[263, 249, 390, 373, 374, 380, 381, 382, 362], [33, 7, 163, 144, 145, 153, 154, 155, 133]];
/// How far above the slit skin still follows the upper lid, and below it the lower one, metres.
const ABOVE: f32 = 0.015;
const BELOW: f32 = 0.009;

/// Two modes, left and right; zero for a head whose lids carry no landmarks.
pub fn closing(head: &HeadModel, landmarks: &[LandmarkAnchor]) -> Basis {
    let mut data = Vec::with_capacity(2 * head.vertices.len() * 3);
    for eye in 0..2 {
        let row = |indices: &[u32; 9]| -> Option<Vec<[f32; 3]>> {
            let place = |index: &u32| {
                let anchor = landmarks.iter().find(|anchor| anchor.index == *index)?;
                Some(head.landmark_position(anchor, &head.vertices))
            };
            indices.iter().map(place).collect()
        };
        let centre = head.joints[[joint::EYE_LEFT, joint::EYE_RIGHT][eye]];
        let slit = row(&UPPER[eye]).zip(row(&LOWER[eye])).map(|(upper, lower)| Slit { upper, lower, centre });
        for (vertex, weights) in head.vertices.iter().zip(&head.weights) {
            let ball = weights[joint::EYE_LEFT].max(weights[joint::EYE_RIGHT]) > 0.5;
            let shift = slit.as_ref().filter(|_| !ball).map_or([0.0; 3], |slit| slit.shift(*vertex));
            data.extend(shift);
        }
    }
    Basis { count: 2, data }
}

struct Slit {
    upper: Vec<[f32; 3]>,
    lower: Vec<[f32; 3]>,
    centre: [f32; 3],
}

/// Height of a chain of points at `x`; `None` beside it.
fn height(chain: &[[f32; 3]], x: f32) -> Option<f32> {
    chain.windows(2).find_map(|pair| {
        let [a, b] = [pair[0], pair[1]];
        let share = (x - a[0]) / (b[0] - a[0]);
        (0.0..=1.0).contains(&share).then(|| a[1] + share * (b[1] - a[1]))
    })
}

impl Slit {
    /// How far closing moves a skin point.
    fn shift(&self, [x, y, z]: [f32; 3]) -> [f32; 3] {
        const STILL: [f32; 3] = [0.0; 3];
        let (Some(upper), Some(lower)) = (height(&self.upper, x), height(&self.lower, x)) else { return STILL };
        let open = upper - lower;
        if z < self.centre[2] || open < 1e-5 {
            return STILL;
        }
        let meeting = lower + 0.1 * open;
        let drop = if y > (upper + lower) / 2.0 {
            let fade = (1.0 - (y - upper).max(0.0) / ABOVE).max(0.0);
            (meeting - upper) * fade * fade * (3.0 - 2.0 * fade)
        } else {
            (meeting - lower) * (1.0 - (lower - y).max(0.0) / BELOW).max(0.0)
        };
        // Keep the distance from the eyeball's centre, so that the lid goes around the eye and not through it.
        let [dy, dz] = [y - self.centre[1], z - self.centre[2]];
        let square = dy * dy + dz * dz;
        let turned = y + drop - self.centre[1];
        [0.0, drop, (square - turned * turned).max(0.25 * dz * dz).sqrt() - dz]
    }
}
