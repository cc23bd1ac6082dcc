//! From detections to the rectangle that is cut out: largest face, enlargement, clamping, and boxes over time.
//!
//! All arithmetic is the toolbox's: integers, truncated toward zero at each step, the corner clamped at 0 while the size is
//! not, so that a clamped box reaches further right and down than a centred one would.

use std::ops::Range;

/// How much larger than a Haar detection the toolbox's crop is.
pub const HAAR_ENLARGEMENT: f64 = 1.5;

/// A rectangle of a frame, pixels; it may reach beyond the frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FaceBox {
    /// Left edge.
    pub x: i32,
    /// Top edge.
    pub y: i32,
    /// Width.
    pub width: i32,
    /// Height.
    pub height: i32,
}

impl FaceBox {
    /// The widest of several detections, the first of equals; `None` of none.
    pub fn widest(found: &[Self]) -> Option<Self> {
        found.iter().copied().reduce(|best, other| if other.width > best.width { other } else { best })
    }

    /// What the toolbox takes where no face is seen: `[0, 0, height, width]` read as x, y, width, height. The two are
    /// swapped there; enlarged by 1.5 and clamped it still covers a 4:3 frame.
    pub fn whole_frame(width: usize, height: usize) -> Self {
        Self { x: 0, y: 0, width: clamped(height as f64), height: clamped(width as f64) }
    }

    /// The box of a detection by its edges, pixels, rounded; `None` when an edge is not finite or it is empty.
    pub fn from_edges([left, top, right, bottom]: [f32; 4]) -> Option<Self> {
        let sound = [left, top, right, bottom].iter().all(|edge| edge.is_finite()) && right - left >= 1.0;
        let of = |value: f32| clamped(f64::from(value.round()));
        (sound && bottom - top >= 1.0).then(|| Self {
            x: of(left),
            y: of(top),
            width: of(right - left),
            height: of(bottom - top),
        })
    }

    /// The square of the longer side about the centre (the toolbox on YOLO5Face detections).
    pub fn squared(self) -> Self {
        let side = self.width.max(self.height);
        let (x, y) = (self.x.saturating_add(self.width / 2), self.y.saturating_add(self.height / 2));
        Self { x: x.saturating_sub(side / 2), y: y.saturating_sub(side / 2), width: side, height: side }
    }

    /// Enlarged by a factor about its centre as far as the corner's clamping at 0 lets it.
    pub fn enlarged(self, factor: f64) -> Self {
        let corner = |at: i32, size: i32| {
            let moved = f64::from(at) - (factor - 1.0) / 2.0 * f64::from(size);
            clamped(moved.max(0.0))
        };
        let size = |size: i32| clamped(factor * f64::from(size));
        Self {
            x: corner(self.x, self.width),
            y: corner(self.y, self.height),
            width: size(self.width),
            height: size(self.height),
        }
    }

    /// Rows and columns of a frame that lie in the box; empty where it lies outside.
    pub fn crop(self, width: usize, height: usize) -> (Range<usize>, Range<usize>) {
        let along = |from: i32, size: i32, most: usize| {
            let end = (i64::from(from) + i64::from(size)).clamp(0, most as i64) as usize;
            (from.max(0) as usize).min(end)..end
        };
        (along(self.y, self.height, height), along(self.x, self.width, width))
    }
}

/// Truncated toward zero and within `i32`; NaN becomes 0.
fn clamped(value: f64) -> i32 {
    value as i32
}

/// A box that follows a face from detections in some of the frames: straight lines between them, the nearest one where
/// there is none, smoothed so that the jitter of a detector does not become a pulse.
#[derive(Clone, Debug, Default)]
pub struct FollowedBox {
    /// Edges (left, top, right, bottom) as seen last, smoothed.
    last: Option<[f32; 4]>,
}

/// How far a box moves toward a new detection; the rest it keeps.
const FOLLOWING: f32 = 0.5;
/// A face that moved by more than this share of its width is another one, or a cut: the box jumps.
const JUMP: f32 = 0.4;

impl FollowedBox {
    /// Takes the edges of the next detection, if there is one, and tells the edges to use from here on; `None` before the
    /// first.
    pub fn follow(&mut self, seen: Option<[f32; 4]>) -> Option<[f32; 4]> {
        let sound = seen.filter(|edges| FaceBox::from_edges(*edges).is_some());
        self.last = match (self.last, sound) {
            (Some(last), Some(seen)) => {
                let reach = JUMP * (last[2] - last[0]);
                let jumped = (0..4).any(|edge| (seen[edge] - last[edge]).abs() > reach);
                let step = |edge: usize| last[edge] + FOLLOWING * (seen[edge] - last[edge]);
                Some(if jumped { seen } else { std::array::from_fn(step) })
            }
            (last, seen) => seen.or(last),
        };
        self.last
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn odd_boxes_have_an_answer() {
        assert_eq!(FaceBox::from_edges([0.0, f32::NAN, 3.0, 3.0]), None);
        assert_eq!(FaceBox::from_edges([5.0, 5.0, 5.2, 9.0]), None);
        assert_eq!(FaceBox::widest(&[]), None);
        let giant = FaceBox { x: i32::MAX, y: -7, width: i32::MAX, height: i32::MIN };
        assert_eq!(giant.enlarged(1.5).crop(4, 4), (0..0, 4..4));
        let (rows, columns) = giant.squared().crop(4, 4);
        assert!(rows.len() <= 4 && columns.len() <= 4);
        assert_eq!(FaceBox::whole_frame(640, 480).enlarged(1.5).crop(640, 480), (0..480, 0..640));
    }

    #[test]
    fn a_followed_box_smooths_jitter_jumps_at_cuts_and_bridges_gaps() {
        let mut following = FollowedBox::default();
        assert_eq!(following.follow(None), None);
        assert_eq!(following.follow(Some([10.0, 10.0, 50.0, 60.0])), Some([10.0, 10.0, 50.0, 60.0]));
        assert_eq!(following.follow(Some([14.0, 10.0, 54.0, 60.0])), Some([12.0, 10.0, 52.0, 60.0]));
        assert_eq!(following.follow(None), Some([12.0, 10.0, 52.0, 60.0]));
        assert_eq!(following.follow(Some([90.0, 10.0, 130.0, 60.0])), Some([90.0, 10.0, 130.0, 60.0]));
        assert_eq!(following.follow(Some([f32::NAN; 4])), Some([90.0, 10.0, 130.0, 60.0]));
    }
}
