//! The short-range face detector: 128×128 letterbox, 896 fixed anchors, weighted non-maximum suppression.

use heartian_space::Rgb8Image;

use super::sampling::{Border, Patch, sample};
use super::{Net, NetError};

const SIDE: usize = 128;
/// (cells along a side, anchors a cell); anchors are row-major and cell-major, of size 1.
const GRIDS: [(usize, usize); 2] = [(16, 2), (8, 6)];
const LEAST_SCORE: f32 = 0.5;
const OVERLAP: f32 = 0.3;

/// A face found in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detection {
    /// Left, top, right, bottom; pixels.
    pub box_px: [f32; 4],
    /// The subject's right eye (image left), left eye, nose tip, mouth, right ear, left ear; pixels.
    pub keypoints_px: [[f32; 2]; 6],
    /// Confidence in [0.5, 1].
    pub score: f32,
}

/// The detector network.
#[derive(Debug)]
pub struct Detector {
    net: Net,
    anchors: Vec<[f32; 2]>,
}

impl Detector {
    /// Reads the network.
    ///
    /// # Errors
    /// When the file is damaged or is another model.
    pub fn parse(bytes: &[u8]) -> Result<Self, NetError> {
        let net = Net::parse(bytes)?;
        if net.input_shape()? != [1, SIDE, SIDE, 3] {
            let reason = format!("its input is {:?}, not [1, 128, 128, 3]", net.input_shape()?);
            return Err(NetError::WrongModel { expected: "short-range face detector", reason });
        }
        let anchors = GRIDS.iter().flat_map(|&(cells, count)| {
            let centre = move |i: usize| (i as f32 + 0.5) / cells as f32;
            (0..cells * cells * count).map(move |i| [centre(i / count % cells), centre(i / count / cells)])
        });
        Ok(Self { net, anchors: anchors.collect() })
    }

    /// Edges (left, top, right, bottom; pixels) of the best face, if there is one.
    ///
    /// # Errors
    /// As [`detect`](Self::detect).
    pub fn best_box(&self, image: &Rgb8Image) -> Result<Option<[f32; 4]>, NetError> {
        Ok(self.detect(image)?.first().map(|face| face.box_px))
    }

    /// Faces, best first; empty when there is none.
    ///
    /// # Errors
    /// When the network is not the short-range detector.
    pub fn detect(&self, image: &Rgb8Image) -> Result<Vec<Detection>, NetError> {
        let side = image.width.max(image.height) as f32;
        let origin = [(image.width as f32 - side) / 2.0, (image.height as f32 - side) / 2.0];
        let step = side / SIDE as f32;
        let patch = Patch { origin, right: [step, 0.0], down: [0.0, step], size: [SIDE, SIDE], border: Border::Black };
        let outputs = self.net.run(sample(image, &patch, 2.0 / 255.0, -1.0))?;
        let of_size = |per_anchor: usize| {
            let wanted = self.anchors.len() * per_anchor;
            outputs.iter().find(|output| output.data.len() == wanted).ok_or_else(|| NetError::WrongModel {
                expected: "short-range face detector",
                reason: format!("no output has {wanted} values"),
            })
        };
        let (boxes, scores) = (of_size(16)?, of_size(1)?);
        let mut found = Vec::new();
        for ((raw, score), anchor) in boxes.data.as_chunks::<16>().0.iter().zip(&scores.data).zip(&self.anchors) {
            let score = 1.0 / (1.0 + (-score.clamp(-100.0, 100.0)).exp());
            if score >= LEAST_SCORE {
                found.push(decode(raw, *anchor, score, |point| [0, 1].map(|axis| origin[axis] + point[axis] * side)));
            }
        }
        Ok(suppress(found))
    }
}

/// From the network's numbers (1/128 of the square, relative to the anchor) to pixels.
fn decode(raw: &[f32; 16], anchor: [f32; 2], score: f32, to_px: impl Fn([f32; 2]) -> [f32; 2]) -> Detection {
    let value = |i: usize| raw[i] / SIDE as f32;
    let point = |i: usize| [value(i) + anchor[0], value(i + 1) + anchor[1]];
    let (centre, half) = (point(0), [value(2) / 2.0, value(3) / 2.0]);
    let low = to_px([centre[0] - half[0], centre[1] - half[1]]);
    let high = to_px([centre[0] + half[0], centre[1] + half[1]]);
    let keypoints_px = std::array::from_fn(|k| to_px(point(4 + 2 * k)));
    Detection { box_px: [low[0], low[1], high[0], high[1]], keypoints_px, score }
}

/// Weighted suppression: each group of overlapping boxes becomes its score-weighted mean.
fn suppress(mut found: Vec<Detection>) -> Vec<Detection> {
    found.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut kept = Vec::new();
    while let Some(&best) = found.first() {
        let (group, rest): (Vec<_>, Vec<_>) = found.into_iter().partition(|other| overlap(&best, other) > OVERLAP);
        // A degenerate best box does not overlap even itself; it stands alone.
        found = if group.is_empty() { rest[1..].to_vec() } else { rest };
        let total: f32 = group.iter().map(|one| one.score).sum();
        let mean = |get: &dyn Fn(&Detection) -> f32| group.iter().map(|one| one.score * get(one)).sum::<f32>() / total;
        if !group.is_empty() {
            kept.push(Detection {
                box_px: std::array::from_fn(|i| mean(&|one| one.box_px[i])),
                keypoints_px: std::array::from_fn(|k| [0, 1].map(|axis| mean(&|one| one.keypoints_px[k][axis]))),
                score: best.score,
            });
        }
    }
    kept
}

/// Intersection over union; 0 for empty or non-finite boxes.
fn overlap(a: &Detection, b: &Detection) -> f32 {
    let area = |b: &[f32; 4]| (b[2] - b[0]).max(0.0) * (b[3] - b[1]).max(0.0);
    let (p, q) = (a.box_px, b.box_px);
    let shared = area(&[p[0].max(q[0]), p[1].max(q[1]), p[2].min(q[2]), p[3].min(q[3])]);
    let union = area(&p) + area(&q) - shared;
    if union > 0.0 { shared / union } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f32, score: f32) -> Detection {
        Detection { box_px: [x, 0.0, x + 10.0, 10.0], keypoints_px: [[x, 1.0]; 6], score }
    }

    #[test]
    fn overlapping_faces_merge_by_weight_and_others_stay() {
        let kept = suppress(vec![at(1.0, 0.6), at(0.0, 0.9), at(50.0, 0.7)]);
        assert_eq!(kept.len(), 2);
        assert!((kept[0].box_px[0] - 0.4).abs() < 1e-6 && (kept[0].keypoints_px[3][0] - 0.4).abs() < 1e-6);
        assert_eq!(kept[1].box_px[0], 50.0);
    }

    #[test]
    fn degenerate_boxes_do_not_hang() {
        assert!(suppress(vec![at(f32::NAN, 0.9), at(f32::NAN, 0.8)]).is_empty());
    }
}
