//! Where the eyes look, from the irises' centres, once the head is fitted.

use glam::{DVec2, DVec3};

use super::frame::{Lens, State};
use super::points::{cross_matrix, rotation};
use crate::model::{HeadModel, Region, joint};
use crate::observations::Observations;

/// Landmark index of the left and of the right iris's centre.
const IRIS: [u32; 2] = [473, 468];
/// Weight of the squared turn against squared pixels over the scale: the eyes rarely turn by more than a third of a radian.
const PRIOR: f64 = 9.0;

/// One person's eyeballs: centre and radius, left and right; `None` for a head without them.
pub fn eyeballs(head: &HeadModel) -> [Option<(DVec3, f64)>; 2] {
    [(Region::EyeLeft, joint::EYE_LEFT), (Region::EyeRight, joint::EYE_RIGHT)].map(|(region, eye)| {
        let centre = DVec3::from_array(head.joints[eye].map(f64::from));
        let radius = head
            .vertices
            .iter()
            .zip(&head.regions)
            .filter(|(_, own)| **own == region)
            .map(|(vertex, _)| DVec3::from_array(vertex.map(f64::from)).distance(centre))
            .fold(0.0, f64::max);
        (radius > 0.0).then_some((centre, radius))
    })
}

/// Turns of both eyes in a frame; zero where no iris was seen or the lid hides it.
pub fn turns(
    eyeballs: &[Option<(DVec3, f64)>; 2],
    (observations, frame): (&Observations, usize),
    (lens, scale_px): (Lens, f64),
    state: &State,
) -> [DVec3; 2] {
    std::array::from_fn(|eye| {
        let seen = observations.frame(frame).find(|landmark| landmark.index == IRIS[eye] && landmark.weight > 0.0);
        let (Some(seen), Some((centre, radius))) = (seen, eyeballs[eye]) else { return DVec3::ZERO };
        if state.eyelids[eye] > 0.6 {
            return DVec3::ZERO;
        }
        turn((centre, radius), seen.position_px.map(f64::from).into(), (lens, scale_px), state)
    })
}

/// Two unknowns (pitch, yaw), a few Gauss–Newton steps.
fn turn((centre, radius): (DVec3, f64), pixel: DVec2, (lens, scale_px): (Lens, f64), state: &State) -> DVec3 {
    let mut vector = DVec3::ZERO;
    for _ in 0..6 {
        let arm = rotation(vector) * DVec3::new(0.0, 0.0, radius);
        let y = state.rotation * (centre + arm) + state.translation;
        let inverse = -1.0 / y.z;
        let offset = DVec2::new(lens.focal * y.x * inverse, -lens.focal * y.y * inverse);
        let residual = (lens.centre + offset - pixel) / scale_px;
        // The iris turns about the eye's own axes; small turns, so the right Jacobian is left out.
        let by_turn = state.rotation * -cross_matrix(arm);
        let rows = [
            DVec3::new(lens.focal * inverse, 0.0, offset.x * inverse) / scale_px,
            DVec3::new(0.0, -lens.focal * inverse, offset.y * inverse) / scale_px,
        ];
        let j = [0, 1].map(|axis| [rows[0].dot(by_turn.col(axis)), rows[1].dot(by_turn.col(axis))]);
        let (a, b, d) = (
            j[0][0] * j[0][0] + j[0][1] * j[0][1] + PRIOR,
            j[0][0] * j[1][0] + j[0][1] * j[1][1],
            j[1][0] * j[1][0] + j[1][1] * j[1][1] + PRIOR,
        );
        let g = [0, 1].map(|axis| j[axis][0] * residual.x + j[axis][1] * residual.y + PRIOR * vector[axis]);
        let determinant = a * d - b * b;
        vector.x -= (d * g[0] - b * g[1]) / determinant;
        vector.y -= (a * g[1] - b * g[0]) / determinant;
        vector = vector.clamp(DVec3::new(-0.6, -0.8, 0.0), DVec3::new(0.6, 0.8, 0.0));
    }
    if vector.is_finite() { vector } else { DVec3::ZERO }
}
