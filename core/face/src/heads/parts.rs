//! What the vertices of a head without labels are part of, from skinning weights and landmarks.

use crate::HeadModel;
use crate::model::{LandmarkAnchor, Region, joint};

/// Outlines in the face mesh: the lips, and both brows.
const LIPS: [u32; 20] = [61, 185, 40, 39, 37, 0, 267, 269, 270, 409, 291, 375, 321, 405, 314, 17, 84, 181, 91, 146];
const BROWS: [[u32; 10]; 2] =
    [[70, 63, 105, 66, 107, 55, 65, 52, 53, 46], [300, 293, 334, 296, 336, 285, 295, 282, 283, 276]];
const FOREHEAD: u32 = 10;
const CHIN: u32 = 152;
const CORNER: u32 = 61;

/// Regions of all vertices.
pub fn regions(head: &HeadModel, landmarks: &[LandmarkAnchor]) -> Vec<Region> {
    let place = |index: u32| {
        let anchor = landmarks.iter().find(|anchor| anchor.index == index)?;
        Some(head.landmark_position(anchor, &head.vertices))
    };
    let outline = |indices: &[u32]| -> Vec<[f32; 2]> {
        indices.iter().filter_map(|index| place(*index)).map(|[x, y, _]| [x, y]).collect()
    };
    let lips = outline(&LIPS);
    let brows = BROWS.map(|brow| outline(&brow));
    let (forehead, chin, corner) = (place(FOREHEAD), place(CHIN), place(CORNER));
    let eyes = head.joints[joint::EYE_LEFT];
    let region = |(vertex, row): (&[f32; 3], &[f32; 5])| {
        let [x, y, z] = *vertex;
        let front = z > corner.map_or(eyes[2] - 0.03, |corner| corner[2] - 0.01);
        if row[joint::EYE_LEFT] > 0.9 {
            Region::EyeLeft
        } else if row[joint::EYE_RIGHT] > 0.9 {
            Region::EyeRight
        } else if front && inside(&lips, [x, y]) {
            Region::Lips
        } else if front && brows.iter().any(|brow| inside(brow, [x, y])) {
            Region::Brow
        } else if row[joint::ROOT] > 0.5 || chin.is_some_and(|chin| y < chin[1] - 0.005 && z < chin[2] - 0.02) {
            Region::Neck
        } else if forehead
            .is_some_and(|top| y > top[1] + 0.006 + 1.25 * (z - top[2]) && (z < eyes[2] - 0.05 || y > top[1]))
        {
            Region::Scalp
        } else {
            Region::Skin
        }
    };
    head.vertices.iter().zip(&head.weights).map(region).collect()
}

/// Whether a point lies in a polygon.
fn inside(polygon: &[[f32; 2]], [x, y]: [f32; 2]) -> bool {
    let mut odd = false;
    for (a, b) in polygon.iter().zip(polygon.iter().cycle().skip(1)) {
        if (a[1] > y) != (b[1] > y) && x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]) {
            odd = !odd;
        }
    }
    odd
}
