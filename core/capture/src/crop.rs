//! The square a real recording is cut to, around the head with hair, chin and neck: fixed over the clip, or going with it.

mod following;

use heartian_space::Rgb8Image;
use serde::{Deserialize, Serialize};

/// Landmarks of one face: x, y in pixels; z unused here.
pub(crate) type Points = [[f32; 3]];

/// A square of the source frame; it may reach beyond the frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CropSquare {
    /// Left edge, source pixels.
    pub left_px: f32,
    /// Top edge, source pixels.
    pub top_px: f32,
    /// Side, source pixels.
    pub side_px: f32,
}

/// How the square lies over a clip.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum CropMotion {
    /// One square that holds the head in nearly all frames.
    #[default]
    Fixed,
    /// A square of one size that goes with the head, steadily.
    Following,
}

impl CropMotion {
    /// The square of every frame; `None` without any finite landmark. One entry a frame, `None` where no face is seen.
    pub(crate) fn squares(self, faces: &[Option<&Points>], times_seconds: &[f64]) -> Option<Vec<CropSquare>> {
        match self {
            Self::Fixed => {
                let square = CropSquare::around(faces.iter().copied().flatten())?;
                Some(vec![square; faces.len()])
            }
            Self::Following => following::squares(faces, times_seconds),
        }
    }
}

/// The head with hair and neck reaches this far beyond the landmarks' box, in multiples of the box's longer side.
const ABOVE: f32 = 0.55;
const BELOW: f32 = 0.40;
const BESIDE: f32 = 0.36;

impl CropSquare {
    /// The smallest square that holds the head in nearly all frames; `None` without any finite landmark.
    pub fn around<'a>(faces: impl Iterator<Item = &'a Points>) -> Option<Self> {
        let mut edges: [Vec<f32>; 4] = Default::default();
        for head in faces.filter_map(head_box) {
            edges.iter_mut().zip(head).for_each(|(list, edge)| list.push(edge));
        }
        // A landmark gone astray in a frame must not blow up the square.
        let [lefts, tops, rights, bottoms] = &mut edges;
        let (left, right) = (quantile(lefts, 0.02)?, quantile(rights, 0.98)?);
        let (top, bottom) = (quantile(tops, 0.02)?, quantile(bottoms, 0.98)?);
        let side_px = (right - left).max(bottom - top);
        let (x, y) = ((left + right) / 2.0, (top + bottom) / 2.0);
        Some(Self { left_px: x - side_px / 2.0, top_px: y - side_px / 2.0, side_px })
    }

    /// A source position in the pixels of the crop resized to `size`.
    pub fn crop_from_source(&self, [x, y]: [f32; 2], size: usize) -> [f32; 2] {
        let scale = size as f32 / self.side_px;
        [(x - self.left_px) * scale, (y - self.top_px) * scale]
    }
}

/// Left, top, right, bottom of the head with hair and neck; `None` without area.
fn head_box(points: &Points) -> Option<[f32; 4]> {
    let [left, top, right, bottom] = bounds(points);
    let side = (right - left).max(bottom - top);
    let head = [left - BESIDE * side, top - ABOVE * side, right + BESIDE * side, bottom + BELOW * side];
    (side.is_finite() && side > 0.0).then_some(head)
}

/// The value that the share `q` of a list does not exceed; sorts it.
fn quantile(list: &mut [f32], q: f32) -> Option<f32> {
    list.sort_by(f32::total_cmp);
    list.get(((list.len().saturating_sub(1)) as f32 * q).round() as usize).copied()
}

/// Left, top, right, bottom.
fn bounds(points: &Points) -> [f32; 4] {
    let empty = [f32::INFINITY, f32::INFINITY, f32::NEG_INFINITY, f32::NEG_INFINITY];
    points.iter().fold(empty, |b, [x, y, _]| [b[0].min(*x), b[1].min(*y), b[2].max(*x), b[3].max(*y)])
}

/// The source pixels under one output pixel along an axis.
#[derive(Clone, Debug)]
struct Taps {
    first: usize,
    /// Weights of the pixels inside the frame; they sum to 1, or are empty where there are none.
    weights: Vec<f32>,
    /// The part of the filter that lies inside the frame, in [0, 1].
    inside: f32,
}

/// Cuts a square out of frames of one size and resizes it with an antialiased bilinear filter.
#[derive(Clone, Debug)]
pub struct Cropper {
    size: usize,
    columns: Vec<Taps>,
    rows: Vec<Taps>,
}

impl Cropper {
    /// A cropper from `width × height` frames to `size × size`.
    pub fn new(square: CropSquare, (width, height): (usize, usize), size: usize) -> Self {
        let axis =
            |start: f32, len: usize| (0..size).map(|i| taps(start, square.side_px / size as f32, i, len)).collect();
        Self { size, columns: axis(square.left_px, width), rows: axis(square.top_px, height) }
    }

    /// The crop; beyond the frame its border is repeated as far as the filter reaches, then black.
    pub fn crop(&self, image: &Rgb8Image) -> Rgb8Image {
        let size = self.size;
        let mut out = Rgb8Image::filled(size, size, [0; 3]);
        // Rows first: each source row in use is filtered along x once.
        let (from, to) = self
            .rows
            .iter()
            .filter(|taps| !taps.weights.is_empty())
            .fold((usize::MAX, 0), |(a, b), taps| (a.min(taps.first), b.max(taps.first + taps.weights.len())));
        let (from, to) = (from, to.min(image.height));
        if from >= to {
            return out;
        }
        let mut filtered = vec![0.0f32; (to - from) * size * 3];
        for (y, row) in (from..to).zip(filtered.chunks_exact_mut(size * 3)) {
            let source = &image.data[y * image.width * 3..][..image.width * 3];
            for (pixel, taps) in row.as_chunks_mut::<3>().0.iter_mut().zip(&self.columns) {
                for (weight, value) in taps.weights.iter().zip(source[taps.first * 3..].as_chunks::<3>().0) {
                    (0..3).for_each(|c| pixel[c] += weight * f32::from(value[c]));
                }
            }
        }
        let mut sum = vec![0.0f32; size * 3];
        for (row, taps) in out.data.chunks_exact_mut(size * 3).zip(&self.rows) {
            sum.fill(0.0);
            for (k, weight) in taps.weights.iter().enumerate() {
                let source = &filtered[(taps.first + k - from) * size * 3..][..size * 3];
                sum.iter_mut().zip(source).for_each(|(sum, value)| *sum += weight * value);
            }
            row.iter_mut().zip(&sum).for_each(|(out, sum)| *out = (sum + 0.5) as u8);
        }
        out
    }

    /// Which part of each output pixel lies inside the frame, `size × size` in [0, 1].
    pub fn coverage(&self) -> Vec<f32> {
        self.rows.iter().flat_map(|row| self.columns.iter().map(|column| row.inside * column.inside)).collect()
    }
}

/// A triangle of half-width `max(step, 1)` source pixels about the output pixel's centre.
fn taps(start: f32, step: f32, index: usize, len: usize) -> Taps {
    let (centre, reach) = (start + (index as f32 + 0.5) * step, step.max(1.0));
    let (low, high) = ((centre - reach).floor() as i64, (centre + reach).ceil() as i64);
    let weight = |i: i64| (1.0 - ((i as f32 + 0.5) - centre).abs() / reach).max(0.0);
    let total: f32 = (low..high).map(weight).sum();
    let (first, last) = (low.clamp(0, len as i64), high.clamp(0, len as i64));
    let weights: Vec<f32> = (first..last).map(weight).collect();
    let inside: f32 = weights.iter().sum();
    if inside <= 1e-6 || total <= 0.0 {
        return Taps { first: 0, weights: Vec::new(), inside: 0.0 };
    }
    Taps { first: first as usize, weights: weights.iter().map(|w| w / inside).collect(), inside: inside / total }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_identity_crop_is_the_image_and_a_shift_is_a_shift() {
        let mut image = Rgb8Image::filled(16, 16, [0; 3]);
        for i in 0..256 {
            image.set_pixel(i % 16, i / 16, [i as u8, (255 - i) as u8, (i * 7) as u8]);
        }
        let square = CropSquare { left_px: 0.0, top_px: 0.0, side_px: 16.0 };
        assert_eq!(Cropper::new(square, (16, 16), 16).crop(&image), image);
        let shifted = CropSquare { left_px: -3.0, top_px: 2.0, side_px: 16.0 };
        let cropper = Cropper::new(shifted, (16, 16), 16);
        let crop = cropper.crop(&image);
        assert_eq!(crop.pixel(5, 4), image.pixel(2, 6));
        assert_eq!(crop.pixel(1, 4), [0; 3]);
        assert_eq!((cropper.coverage()[4 * 16 + 5], cropper.coverage()[4 * 16 + 1]), (1.0, 0.0));
        assert_eq!(shifted.crop_from_source([2.5, 6.5], 16), [5.5, 4.5]);
    }

    #[test]
    fn shrinking_averages_and_keeps_a_flat_colour() {
        let mut image = Rgb8Image::filled(64, 64, [40, 80, 120]);
        let square = CropSquare { left_px: 0.0, top_px: 0.0, side_px: 64.0 };
        let flat = Cropper::new(square, (64, 64), 9).crop(&image);
        assert!(flat.data.as_chunks::<3>().0.iter().all(|pixel| *pixel == [40, 80, 120]));
        (0..64 * 64)
            .for_each(|i| image.set_pixel(i % 64, i / 64, if (i % 64 + i / 64) % 2 == 0 { [0; 3] } else { [200; 3] }));
        let grey = Cropper::new(square, (64, 64), 16).crop(&image);
        assert!(grey.data.iter().all(|value| value.abs_diff(100) <= 2), "a fine checkerboard must not alias");
    }

    #[test]
    fn the_square_ignores_one_stray_frame_and_refuses_nothing() {
        let face = |x: f32| vec![[x, 100.0, 0.0], [x + 50.0, 160.0, 0.0]];
        let mut faces: Vec<Vec<[f32; 3]>> = (0..200).map(|i| face(100.0 + 0.01 * i as f32)).collect();
        faces.push(face(9000.0));
        let square = CropSquare::around(faces.iter().map(Vec::as_slice)).expect("faces were given");
        assert!(square.side_px < 200.0 && square.side_px >= 60.0 * (1.0 + ABOVE + BELOW), "{square:?}");
        assert_eq!(CropSquare::around(std::iter::empty()), None);
        let nan = [[f32::NAN, 0.0, 0.0]];
        assert_eq!(CropSquare::around(std::iter::once(nan.as_slice())), None);
    }
}
