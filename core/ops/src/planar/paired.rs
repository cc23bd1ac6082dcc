//! Convolutions over three frames with a third of the multiplications saved (Winograd's F(2, 3), along time).
//!
//! Two neighbouring output frames share their four input frames d₀..d₃. With v = (d₀ − d₂, d₁ + d₂, d₂ − d₁, d₁ − d₃) and
//! u = (g₀, (g₀ + g₁ + g₂)/2, (g₀ − g₁ + g₂)/2, g₂), the products m = u·v give y₀ = m₀ + m₁ + m₂ and y₁ = m₁ − m₂ − m₃:
//! four plane convolutions in place of six. Sums and differences of whole planes need no shuffling of lanes.

use super::{Convolution, Scratch, Strip, Windows, parts};
use crate::map::check;
use crate::{Extent, ShapeError, Volume};

/// A convolution of three frames, for output frames two by two.
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
    /// From weights `outputs × inputs × 3 × ky × kx`; `bias` has one value an output, or none.
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
        for (index, (quarter, scratch)) in self.quarters.iter().zip(&mut scratch.quarters).enumerate() {
            let windows = Windows { before, output, source: |_, _| Some(index) };
            quarter.check(&transformed, &windows)?;
            scratch.locate(quarter, &transformed, &windows);
        }
        for part in parts(output, input.pitch()) {
            let [s0, s1, s2, s3] = &mut scratch.quarters;
            let [q0, q1, q2, q3] = &self.quarters;
            let (m0, m1) = (q0.sum(&transformed, &part, s0), q1.sum(&transformed, &part, s1));
            let (m2, m3) = (q2.sum(&transformed, &part, s2), q3.sum(&transformed, &part, s3));
            for ((y0, y1), (m2, m3)) in m0.iter_mut().zip(&mut *m1).zip(m2.iter().zip(&*m3)) {
                (*y0, *y1) = (*y0 + *y1 + *m2, *y1 - *m2 - *m3);
            }
            sink(0, &mut part.strip(self.outputs(), m0));
            sink(1, &mut part.strip(self.outputs(), m1));
        }
        scratch.transformed = Some(transformed);
        Ok(())
    }
}

/// The four sums and differences of the frames `first..first + 4`, margins included.
fn transform(input: &Volume, first: isize, out: &mut Volume) {
    let frame = |k: isize| usize::try_from(first + k).ok().and_then(|t| input.raw_frame(t));
    let frames = [0, 1, 2, 3].map(frame);
    for (index, (left, right, sign)) in
        [(0, 2, -1.0), (1, 2, 1.0), (2, 1, -1.0), (1, 3, -1.0f32)].into_iter().enumerate()
    {
        let out = out.raw_frame_mut(index);
        match (frames[left], frames[right]) {
            (Some(left), Some(right)) => {
                out.iter_mut().zip(left.iter().zip(right)).for_each(|(out, (a, b))| *out = a + sign * b);
            }
            (Some(left), None) => out.copy_from_slice(left),
            (None, Some(right)) => out.iter_mut().zip(right).for_each(|(out, b)| *out = sign * b),
            (None, None) => out.fill(0.0),
        }
    }
}
