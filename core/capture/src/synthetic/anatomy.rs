//! Where things are on a head, found from its landmarks, so that any model with MediaPipe anchors can be painted.
//!
//! Rest positions of the head with its identity baked in, head space, metres.

use glam::Vec3;
use heartian_face::HeadModel;

/// Upper and lower edge of an eyebrow from its outer to its inner end, MediaPipe indices: the subject's right, left.
const BROWS: [[[u32; 5]; 2]; 2] =
    [[[70, 63, 105, 66, 107], [46, 53, 52, 65, 55]], [[300, 293, 334, 296, 336], [276, 283, 282, 295, 285]]];
/// Edge of an upper lid from corner to corner: right, left.
const UPPER_LIDS: [[u32; 9]; 2] =
    [[33, 246, 161, 160, 159, 158, 157, 173, 133], [263, 466, 388, 387, 386, 385, 384, 398, 362]];

/// A place with a soft extent.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    pub(crate) centre: Vec3,
    pub(crate) radius: f32,
}

impl Place {
    /// 1 at the centre, falling as a Gaussian of this radius.
    pub(crate) fn weight(&self, point: Vec3) -> f32 {
        (-0.5 * point.distance_squared(self.centre) / (self.radius * self.radius)).exp()
    }
}

/// A line along the face with its half thickness at each knot.
#[derive(Clone, Debug)]
pub(crate) struct Stroke {
    knots: Vec<(Vec3, f32)>,
    low: Vec3,
    high: Vec3,
}

/// A point relative to a stroke.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OnStroke {
    /// Distance from the line over the half thickness there: below 1 is inside.
    pub(crate) across: f32,
    /// From 0 at the first knot to 1 at the last.
    pub(crate) along: f32,
}

impl Stroke {
    fn new(knots: Vec<(Vec3, f32)>) -> Self {
        let widest = knots.iter().map(|knot| knot.1).fold(0.0, f32::max);
        let low = knots.iter().map(|knot| knot.0).fold(Vec3::MAX, Vec3::min) - 2.0 * widest;
        let high = knots.iter().map(|knot| knot.0).fold(Vec3::MIN, Vec3::max) + 2.0 * widest;
        Self { knots, low, high }
    }

    /// Where a point lies; `None` when it is further than twice the thickness.
    pub(crate) fn locate(&self, point: Vec3) -> Option<OnStroke> {
        if point.cmplt(self.low).any() || point.cmpgt(self.high).any() {
            return None;
        }
        let segments = (self.knots.len() - 1) as f32;
        let mut nearest: Option<OnStroke> = None;
        for (number, pair) in self.knots.windows(2).enumerate() {
            let ((from, half_from), (to, half_to)) = (pair[0], pair[1]);
            let direction = to - from;
            let t = ((point - from).dot(direction) / direction.length_squared().max(1e-12)).clamp(0.0, 1.0);
            let half = half_from + t * (half_to - half_from);
            let across = point.distance(from + t * direction) / half.max(1e-6);
            if nearest.is_none_or(|best| across < best.across) {
                nearest = Some(OnStroke { across, along: (number as f32 + t) / segments });
            }
        }
        nearest.filter(|place| place.across < 2.0)
    }
}

/// The landmarks' landscape of one head. What a model does not anchor is left out.
#[derive(Clone, Debug, Default)]
pub(crate) struct Anatomy {
    /// Right and left brow, from the outer to the inner end.
    pub(crate) brows: Vec<Stroke>,
    /// Right and left upper lash line.
    pub(crate) lashes: Vec<Stroke>,
    /// Right and left.
    pub(crate) cheeks: Vec<Place>,
    pub(crate) forehead: Vec<Place>,
    pub(crate) nose_tip: Vec<Place>,
    pub(crate) chin: Vec<Place>,
    /// Right and left, around the eye.
    pub(crate) orbits: Vec<Place>,
    /// Right and left nostril opening.
    pub(crate) nostrils: Vec<Place>,
}

impl Anatomy {
    /// Reads the landmarks of a head whose identity is baked in.
    pub(crate) fn new(head: &HeadModel) -> Self {
        let landmark = |index: u32| {
            let anchor = head.landmarks.iter().find(|anchor| anchor.index == index)?;
            Some(Vec3::from_array(head.landmark_position(anchor, &head.vertices)))
        };
        let mean = |indices: &[u32]| {
            let points: Option<Vec<Vec3>> = indices.iter().map(|index| landmark(*index)).collect();
            points.map(|points| points.iter().sum::<Vec3>() / points.len() as f32)
        };
        let place = |indices: &[u32], radius: f32| mean(indices).map(|centre| Place { centre, radius });
        let brow = |edges: &[[u32; 5]; 2]| -> Option<Stroke> {
            let knots: Option<Vec<_>> = (0..5)
                .map(|knot| {
                    let (upper, lower) = (landmark(edges[0][knot])?, landmark(edges[1][knot])?);
                    let taper = [0.55, 0.85, 1.0, 1.0, 0.9][knot];
                    Some(((upper + lower) / 2.0, (upper.distance(lower) * 0.5).clamp(0.0030, 0.0052) * taper))
                })
                .collect();
            knots.map(Stroke::new)
        };
        let lash = |edge: &[u32; 9]| -> Option<Stroke> {
            let knots: Option<Vec<_>> = edge.iter().map(|index| Some((landmark(*index)?, 0.0011))).collect();
            knots.map(Stroke::new)
        };
        Self {
            brows: BROWS.iter().filter_map(brow).collect(),
            lashes: UPPER_LIDS.iter().filter_map(lash).collect(),
            cheeks: [[50, 205], [280, 425]].iter().filter_map(|i| place(i, 0.020)).collect(),
            forehead: place(&[151, 9], 0.030).into_iter().collect(),
            nose_tip: place(&[4], 0.010).into_iter().collect(),
            chin: place(&[199], 0.014).into_iter().collect(),
            orbits: [[33, 133], [263, 362]].iter().filter_map(|i| place(i, 0.017)).collect(),
            nostrils: [[97, 98], [326, 327]].iter().filter_map(|i| place(i, 0.0024)).collect(),
        }
    }
}

/// Sum of the weights of places at a point, at most 1.
pub(crate) fn weight_at(places: &[Place], point: Vec3) -> f32 {
    places.iter().map(|place| place.weight(point)).sum::<f32>().min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stroke_measures_across_and_along() {
        let stroke = Stroke::new(vec![(Vec3::ZERO, 0.1), (Vec3::X, 0.1), (Vec3::X * 2.0, 0.05)]);
        let at = |x: f32, y: f32| stroke.locate(Vec3::new(x, y, 0.0)).map(|place| (place.across, place.along));
        assert_eq!(at(0.5, 0.05), Some((0.5, 0.25)));
        assert_eq!(at(2.0, 0.05), Some((1.0, 1.0)));
        assert_eq!(at(1.0, 0.25), None);
        assert!(weight_at(&[Place { centre: Vec3::ZERO, radius: 1.0 }; 3], Vec3::ZERO) == 1.0);
    }
}
