//! Feature maps and sliding windows: the shapes every op shares.

use std::fmt;

/// A `height × width × channels` map, channels fastest.
#[derive(Clone, Copy, Debug)]
pub struct Map<'a> {
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Values per pixel.
    pub channels: usize,
    /// `height·width·channels` values.
    pub data: &'a [f32],
}

/// A map to write into.
#[derive(Debug)]
pub struct MapMut<'a> {
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Values per pixel.
    pub channels: usize,
    /// `height·width·channels` values.
    pub data: &'a mut [f32],
}

/// Lengths that contradict each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShapeError {
    /// The buffer.
    pub what: &'static str,
    /// Values it should hold.
    pub expected: usize,
    /// Values it holds.
    pub found: usize,
}

impl fmt::Display for ShapeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} holds {} values where {} were expected", self.what, self.found, self.expected)
    }
}

impl std::error::Error for ShapeError {}

/// Errs unless a buffer has the length its shape says.
pub(crate) fn check(what: &'static str, expected: usize, found: usize) -> Result<(), ShapeError> {
    if expected == found { Ok(()) } else { Err(ShapeError { what, expected, found }) }
}

impl Map<'_> {
    pub(crate) fn check(&self) -> Result<(), ShapeError> {
        check("the input map", size(self.height, self.width, self.channels), self.data.len())
    }

    /// The channels of one pixel; the caller keeps `y < height`, `x < width`.
    #[inline(always)]
    pub(crate) fn pixel(&self, y: usize, x: usize) -> &[f32] {
        let start = (y * self.width + x) * self.channels;
        &self.data[start..start + self.channels]
    }
}

impl MapMut<'_> {
    pub(crate) fn check(&self) -> Result<(), ShapeError> {
        check("the output map", size(self.height, self.width, self.channels), self.data.len())
    }
}

fn size(height: usize, width: usize, channels: usize) -> usize {
    height.saturating_mul(width).saturating_mul(channels)
}

/// A window sliding over a map; pairs are (vertical, horizontal).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// Taps.
    pub kernel: [usize; 2],
    /// Step between outputs, ≥ 1.
    pub stride: [usize; 2],
    /// Step between taps, ≥ 1.
    pub dilation: [usize; 2],
    /// Pixels of the first window above and left of the map.
    pub before: [usize; 2],
}

impl Window {
    /// An unpadded window.
    pub fn valid(kernel: [usize; 2], stride: [usize; 2], dilation: [usize; 2]) -> Self {
        Self { kernel, stride, dilation, before: [0, 0] }
    }

    /// A window padded so that the output has `ceil(input / stride)` pixels, the smaller half of the padding first.
    pub fn same(kernel: [usize; 2], stride: [usize; 2], dilation: [usize; 2], input: [usize; 2]) -> Self {
        let before = [0, 1].map(|axis| {
            let out = input[axis].div_ceil(stride[axis].max(1));
            let reach =
                out.saturating_sub(1).saturating_mul(stride[axis]).saturating_add(extent(kernel[axis], dilation[axis]));
            reach.saturating_sub(input[axis]) / 2
        });
        Self { kernel, stride, dilation, before }
    }

    /// Output size of an unpadded window; zero where it does not fit.
    pub fn valid_output(&self, input: [usize; 2]) -> [usize; 2] {
        [0, 1].map(|axis| {
            let extent = extent(self.kernel[axis], self.dilation[axis]);
            if extent == 0 || input[axis] < extent { 0 } else { (input[axis] - extent) / self.stride[axis].max(1) + 1 }
        })
    }

    /// Taps of output `out` that fall inside `0..len` along an axis, as (first tap, one past the last, first position).
    #[inline(always)]
    pub(crate) fn taps(&self, axis: usize, out: usize, len: usize) -> (usize, usize, usize) {
        let (start, dilation) = (out * self.stride[axis], self.dilation[axis].max(1));
        let before = self.before[axis];
        let first = before.saturating_sub(start).div_ceil(dilation);
        let last = (len + before).saturating_sub(start).div_ceil(dilation).min(self.kernel[axis]);
        (first, last.max(first), (start + first * dilation).saturating_sub(before))
    }
}

fn extent(kernel: usize, dilation: usize) -> usize {
    if kernel == 0 { 0 } else { (kernel - 1).saturating_mul(dilation).saturating_add(1) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn taps_are_those_inside_the_map() {
        for (kernel, stride, dilation, len) in [(3, 1, 1, 7), (3, 2, 1, 8), (5, 2, 2, 9), (2, 3, 1, 4), (5, 1, 1, 2)] {
            let window = Window::same([kernel; 2], [stride; 2], [dilation; 2], [len; 2]);
            for out in 0..len.div_ceil(stride) {
                let position = |tap: usize| (out * stride + tap * dilation) as isize - window.before[0] as isize;
                let inside: Vec<usize> =
                    (0..kernel).filter(|&tap| (0..len as isize).contains(&position(tap))).collect();
                let (first, last, start) = window.taps(0, out, len);
                assert_eq!((first..last).collect::<Vec<_>>(), inside, "{kernel} {stride} {dilation} {len} {out}");
                assert!(inside.is_empty() || position(first) == start as isize);
            }
        }
    }
}
