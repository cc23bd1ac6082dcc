//! Convolutions over three frames, or three rows, with a third of the multiplications saved (Winograd's F(2, 3)).
//!
//! Two neighbouring output frames (rows) share their four input frames d₀..d₃. With v = (d₀ − d₂, d₁ + d₂, d₂ − d₁, d₁ − d₃) and
//! u = (g₀, (g₀ + g₁ + g₂)/2, (g₀ − g₁ + g₂)/2, g₂), the products m = u·v give y₀ = m₀ + m₁ + m₂ and y₁ = m₁ − m₂ − m₃:
//! four plane convolutions in place of six. Sums and differences of whole planes or rows need no shuffling of lanes.

use super::{Convolution, Part, Scratch, Strip, Windows, parts};
use crate::map::check;
use crate::{Extent, ShapeError, Volume};

/// A convolution of three frames (or rows), for outputs two by two.
#[derive(Clone, Debug)]
pub struct PairedConvolution {
    quarters: [Convolution; 4],
}

/// Buffers reused from pair to pair.
#[derive(Debug, Default)]
pub struct PairScratch {
    quarters: [Scratch; 4],
    transformed: Option<Volume>,
}

impl PairedConvolution {
    /// From weights `outputs × inputs × 3 × ky × kx` for [`Self::pair`], or `outputs × inputs × 3 × kx` and `ky` = 1 for
    /// [`Self::frame`]; `bias` has one value an output, or none.
    ///
    /// # Errors
    /// When a length contradicts the shape.
    pub fn new(
        weights: &[f32],
        bias: &[f32],
        [outputs, inputs]: [usize; 2],
        [ky, kx]: [usize; 2],
    ) -> Result<Self, ShapeError> {
        let area = ky * kx;
        check("the filter", outputs * inputs * 3 * area, weights.len())?;
        let quarter = |mix: [f64; 3], bias: &[f32]| {
            let mixed: Vec<f32> = (0..outputs * inputs * area)
                .map(|i| {
                    let (plane, tap) = (i / area, i % area);
                    (0..3).map(|t| mix[t] * f64::from(weights[(plane * 3 + t) * area + tap])).sum::<f64>() as f32
                })
                .collect();
            Convolution::new(&mixed, bias, [outputs, inputs], [1, ky, kx])
        };
        // m₁ is in both results, so the bias goes there.
        let quarters = [
            quarter([1.0, 0.0, 0.0], &[])?,
            quarter([0.5, 0.5, 0.5], bias)?,
            quarter([0.5, -0.5, 0.5], &[])?,
            quarter([0.0, 0.0, 1.0], &[])?,
        ];
        Ok(Self { quarters })
    }

    /// Output channels.
    pub fn outputs(&self) -> usize {
        self.quarters[0].outputs()
    }

    /// Rows and columns of the window.
    pub fn kernel(&self) -> [usize; 2] {
        let [_, ky, kx] = self.quarters[0].kernel();
        [ky, kx]
    }

    /// Two output frames whose windows start at input frames `first` and `first + 1` (frames outside are zero), strip by
    /// strip; `sink` gets 0 or 1 and the strip. `before` and `output` are those of [`Windows`].
    ///
    /// # Errors
    /// When the input's channels, margin or size do not allow it.
    pub fn pair(
        &self,
        input: &Volume,
        first: isize,
        [before, output]: [[usize; 2]; 2],
        scratch: &mut PairScratch,
        mut sink: impl FnMut(usize, &mut Strip<'_>),
    ) -> Result<(), ShapeError> {
        let extent = Extent { frames: 4, ..input.extent() };
        let stale = scratch.transformed.take().filter(|v| v.extent() == extent && v.margin() == input.margin());
        let mut transformed = stale.unwrap_or_else(|| Volume::zeros(extent, input.margin()));
        transform(input, first, &mut transformed);
        self.locate(&transformed, [before, output], &mut scratch.quarters)?;
        for part in parts(output, input.pitch()) {
            let (even, odd) = self.sums(&transformed, &part, &mut scratch.quarters);
            sink(0, &mut part.strip(self.outputs(), even));
            sink(1, &mut part.strip(self.outputs(), odd));
        }
        scratch.transformed = Some(transformed);
        Ok(())
    }

    /// One output frame of windows of three rows and one frame, strip by strip from the top; a strip has an even number of
    /// rows unless it is the last.
    ///
    /// # Errors
    /// When the input's channels, margin or size do not allow it.
    pub fn frame<F: Fn(usize, usize) -> Option<usize>>(
        &self,
        input: &Volume,
        windows: &Windows<F>,
        scratch: &mut PairScratch,
        mut sink: impl FnMut(&mut Strip<'_>),
    ) -> Result<(), ShapeError> {
        let ([above, left], [height, width]) = (windows.before, windows.output);
        let output = [height.div_ceil(2), width];
        let extent = Extent { frames: 4, height: output[0], ..input.extent() };
        let stale = scratch.transformed.take().filter(|v| v.extent() == extent && v.margin() == input.margin());
        let mut transformed = stale.unwrap_or_else(|| Volume::zeros(extent, input.margin()));
        transform_rows(input, above, &windows.source, &mut transformed);
        self.locate(&transformed, [[0, left], output], &mut scratch.quarters)?;
        for part in parts(output, transformed.pitch()) {
            let (even, odd) = self.sums(&transformed, &part, &mut scratch.quarters);
            let mut strip = part.strip(self.outputs(), even);
            strip.first_row *= 2;
            strip.rows = (2 * part.rows).min(height - strip.first_row);
            strip.odd = Some(odd);
            sink(&mut strip);
        }
        scratch.transformed = Some(transformed);
        Ok(())
    }

    fn locate(
        &self,
        transformed: &Volume,
        [before, output]: [[usize; 2]; 2],
        scratch: &mut [Scratch; 4],
    ) -> Result<(), ShapeError> {
        for (index, (quarter, scratch)) in self.quarters.iter().zip(scratch).enumerate() {
            let windows = Windows { before, output, source: |_, _| Some(index) };
            quarter.check(transformed, &windows)?;
            scratch.locate(quarter, transformed, &windows);
        }
        Ok(())
    }

    /// The even and the odd results of a strip.
    fn sums<'s>(
        &self,
        transformed: &Volume,
        part: &Part,
        [s0, s1, s2, s3]: &'s mut [Scratch; 4],
    ) -> (&'s mut [f32], &'s mut [f32]) {
        let [q0, q1, q2, q3] = &self.quarters;
        let (m0, m1) = (q0.sum(transformed, part, s0), q1.sum(transformed, part, s1));
        let (m2, m3) = (q2.sum(transformed, part, s2), q3.sum(transformed, part, s3));
        for ((y0, y1), (m2, m3)) in m0.iter_mut().zip(&mut *m1).zip(m2.iter().zip(&*m3)) {
            (*y0, *y1) = (*y0 + *y1 + *m2, *y1 - *m2 - *m3);
        }
        (m0, m1)
    }
}

/// Which of d₀..d₃ each v takes, and the sign of the second.
const MIXES: [(usize, usize, f32); 4] = [(0, 2, -1.0), (1, 2, 1.0), (2, 1, -1.0), (1, 3, -1.0)];

/// `out = left + sign · right`; what is missing is zero.
fn mix(out: &mut [f32], left: Option<&[f32]>, right: Option<&[f32]>, sign: f32) {
    match (left, right) {
        (Some(left), Some(right)) => {
            out.iter_mut().zip(left.iter().zip(right)).for_each(|(out, (a, b))| *out = a + sign * b);
        }
        (Some(left), None) => out.copy_from_slice(left),
        (None, Some(right)) => out.iter_mut().zip(right).for_each(|(out, b)| *out = sign * b),
        (None, None) => out.fill(0.0),
    }
}

/// The mixes of every channel's rows `2j − above` and the three below, as row j of four frames.
fn transform_rows(input: &Volume, above: usize, source: &impl Fn(usize, usize) -> Option<usize>, out: &mut Volume) {
    let Extent { frames, channels, height, .. } = input.extent();
    for c in 0..channels {
        let frame = source(c, 0).filter(|frame| *frame < frames);
        let row = |y: usize| Some(input.row(frame?, c, y.checked_sub(above).filter(|y| *y < height)?));
        for (index, (left, right, sign)) in MIXES.into_iter().enumerate() {
            for j in 0..out.extent().height {
                mix(out.row_mut(index, c, j), row(2 * j + left), row(2 * j + right), sign);
            }
        }
    }
}

/// The four sums and differences of the frames `first..first + 4`, margins included.
fn transform(input: &Volume, first: isize, out: &mut Volume) {
    let frame = |k: isize| usize::try_from(first + k).ok().and_then(|t| input.raw_frame(t));
    let frames = [0, 1, 2, 3].map(frame);
    for (index, (left, right, sign)) in MIXES.into_iter().enumerate() {
        mix(out.raw_frame_mut(index), frames[left], frames[right], sign);
    }
}
