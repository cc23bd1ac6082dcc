//! Where the landmarks of MediaPipe's face mesh sit on the built-in head.
//!
//! Landmarks on the edges of lids and lips are tied to the slits; the rings around them to points between those edges and
//! the features beyond; the rest are placed by hand in the frontal view. Millimetres. Indices come in pairs, the
//! subject's right (negative x) first, as the mesh is symmetric.

use super::features::MOUTH_COLUMN;
use super::parts::Mesh;
use super::sheet::Sheet;
use crate::model::LandmarkAnchor;

/// From the outer to the inner corner of the eye along the upper lid, right and left; and along the lower lid.
const LID_UPPER: [[u32; 2]; 9] =
    [[33, 263], [246, 466], [161, 388], [160, 387], [159, 386], [158, 385], [157, 384], [173, 398], [133, 362]];
const LID_LOWER: [[u32; 2]; 7] = [[7, 249], [163, 390], [144, 373], [145, 374], [153, 380], [154, 381], [155, 382]];
/// The ring around the lid edges, at a fixed distance from them.
const RING_UPPER: [[u32; 2]; 7] = [[247, 467], [30, 260], [29, 259], [27, 257], [28, 258], [56, 286], [190, 414]];
const RING_LOWER: [[u32; 2]; 7] = [[25, 255], [110, 339], [24, 254], [23, 253], [22, 252], [26, 256], [112, 341]];
/// The ring after that.
const RING2_LOWER: [[u32; 2]; 7] = [[31, 261], [228, 448], [229, 449], [230, 450], [231, 451], [232, 452], [233, 453]];
/// From the corner of the mouth to its middle: the lip lines, right and left.
const LIP_CORNER: [[u32; 2]; 3] = [[61, 291], [78, 308], [62, 292]];
/// Upper lip from its outline to its edge, four rows of four columns beside the middle, and the middle column.
const LIP_UPPER: [[[u32; 2]; 4]; 4] = [
    [[185, 409], [40, 270], [39, 269], [37, 267]],
    [[184, 408], [74, 304], [73, 303], [72, 302]],
    [[183, 407], [42, 272], [41, 271], [38, 268]],
    [[191, 415], [80, 310], [81, 311], [82, 312]],
];
const LIP_UPPER_MIDDLE: [u32; 4] = [0, 11, 12, 13];
/// Lower lip from its outline to its edge.
const LIP_LOWER: [[[u32; 2]; 4]; 4] = [
    [[146, 375], [91, 321], [181, 405], [84, 314]],
    [[77, 307], [90, 320], [180, 404], [85, 315]],
    [[96, 325], [89, 319], [179, 403], [86, 316]],
    [[95, 324], [88, 318], [178, 402], [87, 317]],
];
const LIP_LOWER_MIDDLE: [u32; 4] = [17, 16, 15, 14];
/// How far along the half mouth the four columns lie, from the middle.
const LIP_COLUMNS: [f64; 4] = [0.87, 0.70, 0.47, 0.22];

/// Landmarks of the middle line: index, height.
const MIDDLE: [(u32, f64); 20] = [
    (10, 72.5),
    (151, 54.0),
    (9, 37.0),
    (8, 28.5),
    (168, 21.0),
    (6, 13.0),
    (197, 5.5),
    (195, -1.5),
    (5, -8.5),
    (4, -17.0),
    (1, -23.0),
    (19, -27.0),
    (94, -31.0),
    (2, -34.5),
    (164, -40.0),
    (18, -73.0),
    (200, -81.0),
    (199, -91.0),
    (175, -99.0),
    (152, -105.0),
];

/// Paired landmarks: right, left, distance from the middle, height.
const PAIRS: [(u32, u32, f64, f64); 76] = [
    // Brows: upper row from temple to nose, then the lower row.
    (70, 300, 54.5, 31.5),
    (63, 293, 48.0, 36.0),
    (105, 334, 38.5, 39.5),
    (66, 296, 26.0, 39.5),
    (107, 336, 14.0, 37.0),
    (46, 276, 51.5, 27.5),
    (53, 283, 45.0, 31.5),
    (52, 282, 36.0, 34.0),
    (65, 295, 25.0, 33.0),
    (55, 285, 13.5, 31.5),
    // Eye corners of the outer ring.
    (130, 359, 48.0, 15.0),
    (243, 463, 13.6, 13.4),
    // Forehead.
    (109, 338, 15.5, 71.0),
    (67, 297, 30.5, 68.5),
    (108, 337, 13.5, 55.0),
    (69, 299, 26.0, 54.0),
    (104, 333, 43.0, 50.0),
    // Bridge and sides of the nose.
    (122, 351, 9.5, 13.0),
    (193, 417, 10.0, 23.0),
    (245, 465, 10.2, 12.0),
    (188, 412, 10.8, 7.0),
    (196, 419, 7.6, 6.0),
    (174, 399, 10.0, 1.0),
    (3, 248, 6.5, -1.0),
    (236, 456, 10.0, -5.0),
    (51, 281, 6.5, -9.0),
    (134, 363, 9.5, -13.0),
    (45, 275, 6.0, -17.5),
    (198, 420, 13.5, -11.0),
    (217, 437, 13.5, -3.0),
    (220, 440, 8.5, -22.0),
    // Wings, nostrils and base.
    (44, 274, 5.5, -24.5),
    (115, 344, 13.5, -22.0),
    (131, 360, 14.5, -16.5),
    (48, 278, 16.6, -24.5),
    (49, 279, 17.6, -20.5),
    (64, 294, 17.8, -28.5),
    (102, 331, 18.8, -25.0),
    (98, 327, 14.2, -32.0),
    (97, 326, 7.0, -34.0),
    (129, 358, 20.6, -24.5),
    (203, 423, 20.5, -31.5),
    (125, 354, 4.0, -28.0),
    (141, 370, 3.2, -32.0),
    // Around the mouth.
    (167, 393, 5.5, -42.0),
    (165, 391, 13.5, -42.5),
    (92, 322, 20.5, -44.5),
    (186, 410, 25.5, -50.0),
    (57, 287, 30.5, -57.5),
    (43, 273, 26.5, -63.0),
    (106, 335, 21.0, -68.5),
    (182, 406, 13.5, -71.5),
    (83, 313, 6.0, -72.5),
    (206, 426, 26.5, -40.0),
    (216, 436, 32.0, -44.5),
    (212, 432, 33.0, -56.0),
    // Cheeks.
    (50, 280, 47.0, -18.0),
    (101, 330, 33.5, -11.0),
    (36, 266, 28.0, -19.5),
    (205, 425, 38.0, -27.0),
    (187, 411, 50.0, -33.0),
    (117, 346, 51.0, -4.0),
    (118, 347, 42.0, -4.5),
    (119, 348, 33.0, -5.0),
    (120, 349, 25.0, -3.0),
    (207, 427, 42.0, -40.0),
    // Chin.
    (201, 421, 8.5, -81.0),
    (194, 418, 16.0, -78.0),
    (208, 428, 9.0, -91.5),
    (204, 424, 22.0, -75.0),
    (32, 262, 21.0, -85.5),
    (171, 396, 11.0, -98.0),
    (148, 377, 12.5, -104.0),
    (176, 400, 24.0, -101.0),
    (140, 369, 26.0, -94.0),
    (211, 431, 29.0, -79.5),
];

/// The face oval where it is the silhouette: right, left, angle around the head in degrees, height at the front.
const OVAL: [(u32, u32, f64, f64); 13] = [
    (103, 332, 41.0, 61.0),
    (54, 284, 48.0, 55.0),
    (21, 251, 61.0, 41.0),
    (162, 389, 64.0, 29.0),
    (127, 356, 72.0, 14.0),
    (234, 454, 76.0, -2.0),
    (93, 323, 77.0, -23.0),
    (132, 361, 76.0, -41.0),
    (58, 288, 71.0, -64.0),
    (172, 397, 62.0, -82.0),
    (136, 365, 55.0, -91.5),
    (150, 379, 47.0, -97.5),
    (149, 378, 37.0, -100.5),
];

/// All anchors, by increasing index.
pub fn anchors(sheet: &Sheet, mesh: &Mesh) -> Vec<LandmarkAnchor> {
    let mut placer = Placer { mesh, faces: sheet.triangles.len(), anchors: Vec::new() };
    placer.place_lids(sheet);
    placer.place_lips(sheet);
    for (index, y) in MIDDLE {
        placer.front(index, 0.0, y);
    }
    for (right, left, x, y) in PAIRS {
        placer.front(right, -x, y);
        placer.front(left, x, y);
    }
    for (right, left, degrees, height) in OVAL {
        let angle = degrees.to_radians();
        let level = super::profile::level_of_front_height(height);
        let target = super::profile::surface(level, angle);
        placer.nearest(right, [-target[0], target[1], target[2]]);
        placer.nearest(left, target);
    }
    placer.anchors.sort_by_key(|anchor| anchor.index);
    placer.anchors
}

struct Placer<'a> {
    mesh: &'a Mesh,
    /// The first so many triangles are the skin.
    faces: usize,
    anchors: Vec<LandmarkAnchor>,
}

impl Placer<'_> {
    fn millimetres(&self, vertex: u32) -> [f64; 3] {
        self.mesh.positions[vertex as usize].map(|metres| metres * 1e3)
    }

    /// At a vertex.
    fn vertex(&mut self, index: u32, vertex: u32) {
        let found = self.mesh.triangles.iter().take(self.faces).position(|triangle| triangle.contains(&vertex));
        let Some(triangle) = found else { return };
        let barycentric = self.mesh.triangles[triangle].map(|corner| f32::from(corner == vertex));
        self.anchors.push(LandmarkAnchor { index, triangle: triangle as u32, barycentric });
    }

    /// Where a line along z through (`x`, `y`) meets the skin in front.
    fn front(&mut self, index: u32, x: f64, y: f64) {
        let mut best: Option<(f64, LandmarkAnchor)> = None;
        for (number, triangle) in self.mesh.triangles.iter().take(self.faces).enumerate() {
            let [a, b, c] = triangle.map(|vertex| self.millimetres(vertex));
            let area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
            if area.abs() < 1e-9 {
                continue;
            }
            let v = ((x - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (y - a[1])) / area;
            let w = ((b[0] - a[0]) * (y - a[1]) - (x - a[0]) * (b[1] - a[1])) / area;
            let u = 1.0 - v - w;
            if u.min(v).min(w) < -1e-6 {
                continue;
            }
            let depth = u * a[2] + v * b[2] + w * c[2];
            if best.as_ref().is_none_or(|(nearest, _)| depth > *nearest) {
                let barycentric = [u, v, w].map(|share| share.clamp(0.0, 1.0) as f32);
                best = Some((depth, LandmarkAnchor { index, triangle: number as u32, barycentric }));
            }
        }
        self.anchors.extend(best.map(|(_, anchor)| anchor));
    }

    /// At the skin vertex nearest to a point.
    fn nearest(&mut self, index: u32, target: [f64; 3]) {
        let squared =
            |vertex: u32| -> f64 { self.millimetres(vertex).iter().zip(target).map(|(p, q)| (p - q).powi(2)).sum() };
        let skin = self.mesh.triangles.iter().take(self.faces).flatten().copied();
        if let Some(vertex) = skin.min_by(|a, b| squared(*a).total_cmp(&squared(*b))) {
            self.vertex(index, vertex);
        }
    }

    fn place_lids(&mut self, sheet: &Sheet) {
        for (eye, slit) in sheet.eyes.iter().enumerate() {
            // Columns are anchor-indexed from the outer corner; the left eye (0) has it at the largest x.
            let outward: Vec<[u32; 2]> = if eye == 0 { slit.iter().rev().copied().collect() } else { slit.clone() };
            let name = |pair: [u32; 2]| pair[1 - eye];
            for (pair, vertices) in LID_UPPER.iter().zip(&outward) {
                self.vertex(name(*pair), vertices[0]);
            }
            for k in 0..7 {
                let Some([upper, lower]) = outward.get(k + 1).copied() else { return };
                self.vertex(name(LID_LOWER[k]), lower);
                let ([ux, uy, _], [lx, ly, _]) = (self.millimetres(upper), self.millimetres(lower));
                let bulge = (std::f64::consts::PI * (k as f64 + 1.0) / 8.0).sin();
                // Toward the nose the ring runs inward of the lid's own columns.
                let inward = if k == 6 { 2.5 * ux.signum() } else { 0.0 };
                self.front(name(RING_UPPER[k]), ux - inward, uy + 1.8 + 1.4 * bulge);
                self.front(name(RING_LOWER[k]), lx, ly - 1.8 - 1.4 * bulge);
                let outward = 5.5 * (1.0 - k as f64 / 6.0) * lx.signum();
                self.front(name(RING2_LOWER[k]), lx + outward, ly - 4.0 - 3.2 * bulge);
            }
        }
    }

    fn place_lips(&mut self, sheet: &Sheet) {
        for pair in LIP_CORNER {
            for (slot, index) in pair.into_iter().enumerate() {
                let end = if slot == 0 { sheet.mouth.first() } else { sheet.mouth.last() };
                if let Some(vertices) = end {
                    self.vertex(index, vertices[0]);
                }
            }
        }
        let middle = sheet.mouth.len() / 2;
        for row in 0..4 {
            for (upper, indices) in [(true, LIP_UPPER_MIDDLE), (false, LIP_LOWER_MIDDLE)] {
                self.lip(sheet, indices[row], (middle as f64, row, upper));
            }
            for (k, share) in LIP_COLUMNS.into_iter().enumerate() {
                for (upper, table) in [(true, &LIP_UPPER), (false, &LIP_LOWER)] {
                    for (index, side) in table[row][k].into_iter().zip([-1.0, 1.0]) {
                        let along = sheet.mouth_index_of_column(share * MOUTH_COLUMN * side);
                        self.lip(sheet, index, (along, row, upper));
                    }
                }
            }
        }
    }

    /// A point of a lip: how far along the slit, row 0 (outline) to 3 (edge), and which lip.
    fn lip(&mut self, sheet: &Sheet, index: u32, (along, row, upper): (f64, usize, bool)) {
        let first = (along.floor() as usize).min(sheet.mouth.len() - 2);
        let share = along - first as f64;
        let edge = usize::from(!upper);
        let ends = [sheet.mouth[first][edge], sheet.mouth[first + 1][edge]];
        if row == 3 {
            self.between(index, ends, share);
            return;
        }
        let [a, b] = ends.map(|vertex| self.millimetres(vertex));
        let outline = [first, first + 1].map(|k| sheet.lip_outline(k, upper)).map(|vertex| self.millimetres(vertex));
        let mix = |p: [f64; 3], q: [f64; 3], axis: usize| p[axis] + share * (q[axis] - p[axis]);
        let towards_edge = [0.0, 0.36, 0.70][row];
        let [x, y] = [0, 1].map(|axis| {
            let (out, inner) = (mix(outline[0], outline[1], axis), mix(a, b, axis));
            out + towards_edge * (inner - out)
        });
        self.front(index, x, y);
    }

    /// On the edge between two vertices.
    fn between(&mut self, index: u32, [a, b]: [u32; 2], share: f64) {
        let edge = |triangle: &[u32; 3]| triangle.contains(&a) && triangle.contains(&b);
        let Some(triangle) = self.mesh.triangles.iter().take(self.faces).position(edge) else { return };
        let barycentric = self.mesh.triangles[triangle].map(|corner| match corner {
            corner if corner == a => (1.0 - share) as f32,
            corner if corner == b => share as f32,
            _ => 0.0,
        });
        self.anchors.push(LandmarkAnchor { index, triangle: triangle as u32, barycentric });
    }
}
