//! Convolution over stacks of planes without unrolling them: each tap of a window is an offset into the input, and a
//! register tile of output channels × neighbouring pixels gathers `weight · input[offset + pixel]` over all taps.
//!
//! A plane is walked as one long row, margins included, in strips that stay in the second-level cache; the taps are cut
//! into chunks so that a tile's inputs stay in the first-level cache while all output channels pass over them. A caller
//! gets each finished strip while it is warm (activation, pooling). Sums run in the order of the taps, whatever the thread.

mod paired;

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::{__m128, __m256, __m512, _mm256_loadu_ps, _mm256_storeu_ps};

use crate::lanes::Lanes;
use crate::map::check;
use crate::{ShapeError, Volume, dispatch};

pub use paired::{PairScratch, PairedConvolution};

/// Output channels of a register tile.
const ROWS: usize = 4;
/// Lane groups of a register tile: 4 × 3 sums, 3 inputs and a weight fill 16 registers.
const GROUPS: usize = 3;
/// Most lanes of any instruction set.
const MOST_LANES: usize = 16;
/// Taps per pass over the output channels.
const CHUNK: usize = 288;
/// Pixels of a strip, about.
const STRIP_PX: usize = 480;

/// A convolution's weights in the order the kernel reads them.
#[derive(Clone, Debug)]
pub struct Convolution {
    outputs: usize,
    inputs: usize,
    kernel: [usize; 3],
    /// `block × (kt, input, ky, kx) × ROWS`.
    packed: Vec<[f32; ROWS]>,
    /// One an output channel, rounded up to whole blocks.
    bias: Vec<f32>,
}

/// Some rows of a finished frame.
#[derive(Debug)]
pub struct Strip<'a> {
    /// The first row.
    pub first_row: usize,
    /// Rows.
    pub rows: usize,
    /// Columns.
    pub width: usize,
    pitch: usize,
    stride: usize,
    values: &'a mut [f32],
    /// The odd rows, where they are kept apart; `values` then holds the even ones.
    odd: Option<&'a mut [f32]>,
}

impl Strip<'_> {
    fn range(&self, channel: usize, row: usize) -> std::ops::Range<usize> {
        let start = channel * self.stride + row * self.pitch;
        start..start + self.width
    }

    /// The pixels of a row of the strip.
    pub fn row(&mut self, channel: usize, row: usize) -> &mut [f32] {
        let apart = self.odd.is_some();
        let range = self.range(channel, if apart { row / 2 } else { row });
        match &mut self.odd {
            Some(odd) if row % 2 == 1 => &mut odd[range],
            _ => &mut self.values[range],
        }
    }

    /// An even row and the one below it.
    pub fn two_rows(&self, channel: usize, row: usize) -> (&[f32], &[f32]) {
        match &self.odd {
            Some(odd) => {
                let range = self.range(channel, row / 2);
                (&self.values[range.clone()], &odd[range])
            }
            None => (&self.values[self.range(channel, row)], &self.values[self.range(channel, row + 1)]),
        }
    }

    /// Applies a function to all pixels (and to what lies between the rows).
    pub fn each(&mut self, function: impl Fn(&mut [f32])) {
        function(self.values);
        if let Some(odd) = &mut self.odd {
            function(odd);
        }
    }
}

/// Where a strip lies.
#[derive(Clone, Copy)]
struct Part {
    first_row: usize,
    rows: usize,
    width: usize,
    pitch: usize,
    stride: usize,
}

/// Cuts a frame into strips.
fn parts([height, width]: [usize; 2], pitch: usize) -> impl Iterator<Item = Part> {
    let most = (STRIP_PX / pitch).max(2).next_multiple_of(2);
    (0..height).step_by(most).map(move |first_row| {
        let rows = most.min(height - first_row);
        let stride = ((rows - 1) * pitch + width).next_multiple_of(GROUPS * MOST_LANES);
        Part { first_row, rows, width, pitch, stride }
    })
}

impl Part {
    fn len(&self) -> usize {
        (self.rows - 1) * self.pitch + self.width
    }

    fn strip<'s>(&self, outputs: usize, sums: &'s mut [f32]) -> Strip<'s> {
        let Self { first_row, rows, width, pitch, stride } = *self;
        Strip { first_row, rows, width, pitch, stride, values: &mut sums[..outputs * stride], odd: None }
    }
}

/// Where a frame's window looks.
pub struct Windows<F> {
    /// Pixels of the first window above and left of the plane; at most the input's margin.
    pub before: [usize; 2],
    /// Rows and columns of the output.
    pub output: [usize; 2],
    /// The frame that input channel `c` (first argument) is taken from at temporal tap `k` (second); `None` is zero.
    pub source: F,
}

impl Convolution {
    /// Packs weights `outputs × inputs × kt × ky × kx`; `bias` has one value an output, or none.
    ///
    /// # Errors
    /// When a length contradicts the shape.
    pub fn new(
        weights: &[f32],
        bias: &[f32],
        [outputs, inputs]: [usize; 2],
        kernel: [usize; 3],
    ) -> Result<Self, ShapeError> {
        let [kt, ky, kx] = kernel;
        let (area, taps) = (ky * kx, kt * ky * kx * inputs);
        check("the filter", outputs * taps, weights.len())?;
        if !bias.is_empty() {
            check("the bias", outputs, bias.len())?;
        }
        let blocks = outputs.div_ceil(ROWS);
        let mut packed = vec![[0.0; ROWS]; blocks * taps];
        for out in 0..outputs {
            for t in 0..kt {
                for input in 0..inputs {
                    for tap in 0..area {
                        let k = (t * inputs + input) * area + tap;
                        let from = ((out * inputs + input) * kt + t) * area + tap;
                        packed[(out / ROWS) * taps + k][out % ROWS] = weights[from];
                    }
                }
            }
        }
        let mut padded = bias.to_vec();
        padded.resize(blocks * ROWS, 0.0);
        Ok(Self { outputs, inputs, kernel, packed, bias: padded })
    }

    /// Taps: frames, rows, columns.
    pub fn kernel(&self) -> [usize; 3] {
        self.kernel
    }

    /// Output channels.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// One output frame, strip by strip from the top; a strip has an even number of rows unless it is the last.
    ///
    /// # Errors
    /// When the input's channels, margin or size do not allow it.
    pub fn frame<F: Fn(usize, usize) -> Option<usize>>(
        &self,
        input: &Volume,
        windows: &Windows<F>,
        scratch: &mut Scratch,
        mut sink: impl FnMut(&mut Strip<'_>),
    ) -> Result<(), ShapeError> {
        self.check(input, windows)?;
        scratch.locate(self, input, windows);
        for part in parts(windows.output, input.pitch()) {
            sink(&mut part.strip(self.outputs, self.sum(input, &part, scratch)));
        }
        Ok(())
    }

    /// The sums of one strip of the frame that `scratch` has located.
    fn sum<'s>(&self, input: &Volume, part: &Part, scratch: &'s mut Scratch) -> &'s mut [f32] {
        scratch.sums.resize(self.bias.len() * part.stride, 0.0);
        let first = part.first_row * part.pitch;
        let job = Job { input: input.raw(), first, stride: part.stride, len: part.len(), chunks: &scratch.chunks };
        strip(self, &job, &scratch.offsets, &mut scratch.sums);
        &mut scratch.sums
    }

    fn check<F>(&self, input: &Volume, windows: &Windows<F>) -> Result<(), ShapeError> {
        let extent = input.extent();
        check("the input's channels", self.inputs, extent.channels)?;
        for (axis, size) in [extent.height, extent.width].into_iter().enumerate() {
            let before = windows.before[axis];
            if before > input.margin() {
                return check("the input's margin", before, input.margin());
            }
            // The last window may leave the plane by the margin at most.
            let reach = windows.output[axis] + self.kernel[axis + 1];
            let most = size + before + input.margin() + 1;
            if windows.output[axis] == 0 || reach > most {
                return check("the output's side", most.saturating_sub(self.kernel[axis + 1]), windows.output[axis]);
            }
        }
        Ok(())
    }
}

/// Buffers reused from frame to frame.
#[derive(Debug, Default)]
pub struct Scratch {
    /// Input offset of each tap that is not zero.
    offsets: Vec<usize>,
    /// Runs of taps: the first one's weights, its place in `offsets`, and how many.
    chunks: Vec<Chunk>,
    sums: Vec<f32>,
}

#[derive(Clone, Copy, Debug)]
struct Chunk {
    weight: usize,
    offset: usize,
    count: usize,
}

impl Scratch {
    fn locate<F: Fn(usize, usize) -> Option<usize>>(
        &mut self,
        filter: &Convolution,
        input: &Volume,
        windows: &Windows<F>,
    ) {
        let [kt, ky, kx] = filter.kernel;
        let pitch = input.pitch();
        self.offsets.clear();
        self.chunks.clear();
        for t in 0..kt {
            for channel in 0..filter.inputs {
                let Some(frame) = (windows.source)(channel, t).filter(|frame| *frame < input.extent().frames) else {
                    continue;
                };
                let weight = (t * filter.inputs + channel) * ky * kx;
                match self.chunks.last_mut() {
                    Some(chunk) if chunk.weight + chunk.count == weight && chunk.count + ky * kx <= CHUNK => {
                        chunk.count += ky * kx;
                    }
                    _ => self.chunks.push(Chunk { weight, offset: self.offsets.len(), count: ky * kx }),
                }
                let origin = input.origin(frame, channel) - windows.before[0] * pitch - windows.before[1];
                self.offsets.extend((0..ky * kx).map(|tap| origin + tap / kx * pitch + tap % kx));
            }
        }
    }
}

struct Job<'a> {
    input: &'a [f32],
    first: usize,
    stride: usize,
    len: usize,
    chunks: &'a [Chunk],
}

dispatch!(
    fn strip(filter: &Convolution, job: &Job<'_>, offsets: &[usize], sums: &mut [f32]) = strip_kernel
);

#[inline(always)]
fn strip_kernel<const FMA: bool, const L: usize>(
    filter: &Convolution,
    job: &Job<'_>,
    offsets: &[usize],
    sums: &mut [f32],
) {
    let furthest = offsets.iter().max().map_or(0, |offset| offset + job.first + job.stride);
    assert!(furthest <= job.input.len(), "a window reaches beyond the volume");
    assert!(sums.len() >= filter.bias.len() * job.stride && job.stride.is_multiple_of(GROUPS * MOST_LANES));
    let blocks = filter.bias.len() / ROWS;
    let taps = filter.packed.len() / blocks.max(1);
    for (channel, bias) in filter.bias.iter().enumerate() {
        sums[channel * job.stride..(channel + 1) * job.stride].fill(*bias);
    }
    for at in (0..job.len).step_by(GROUPS * L) {
        for chunk in job.chunks {
            let offsets = &offsets[chunk.offset..chunk.offset + chunk.count];
            for block in 0..blocks {
                let weights = &filter.packed[block * taps + chunk.weight..][..chunk.count];
                // SAFETY: this kernel runs at the level whose registers have L lanes; the assertions above bound what a
                // whole strip reads and writes, and `at` plus a tile is at most a strip, whose length is a multiple.
                unsafe {
                    let sums = sums.as_mut_ptr().add(block * ROWS * job.stride + at);
                    let input = job.input.as_ptr().add(job.first + at);
                    #[cfg(target_arch = "x86_64")]
                    match L {
                        16 => tile::<__m512>(input, offsets, weights, sums, job.stride),
                        8 => tile_avx2(input, offsets, weights, sums, job.stride),
                        _ => tile::<__m128>(input, offsets, weights, sums, job.stride),
                    }
                    #[cfg(not(target_arch = "x86_64"))]
                    tile::<[f32; 4]>(input, offsets, weights, sums, job.stride);
                }
            }
        }
    }
}

/// `sums[r, p] += Σ_k weights[k, r] · input[offsets[k] + p]` for [`ROWS`] channels and [`GROUPS`] registers of pixels.
///
/// # Safety
/// The processor has `V`'s instructions; `input` is readable at every offset for the tile's pixels; `sums` holds the
/// tile's pixels of each of its rows.
#[inline(always)]
unsafe fn tile<V: Lanes>(input: *const f32, offsets: &[usize], weights: &[[f32; ROWS]], sums: *mut f32, stride: usize) {
    // SAFETY: as the caller says.
    unsafe {
        let mut acc = [[V::splat(0.0); GROUPS]; ROWS];
        for r in 0..ROWS {
            for g in 0..GROUPS {
                acc[r][g] = V::load(sums.add(r * stride + g * V::LANES));
            }
        }
        for (offset, weights) in offsets.iter().zip(weights) {
            let pixels = input.add(*offset);
            let x: [V; GROUPS] = std::array::from_fn(|g| V::load(pixels.add(g * V::LANES)));
            for r in 0..ROWS {
                let weight = V::splat(weights[r]);
                for g in 0..GROUPS {
                    acc[r][g] = x[g].mul_add(weight, acc[r][g]);
                }
            }
        }
        for r in 0..ROWS {
            for g in 0..GROUPS {
                acc[r][g].store(sums.add(r * stride + g * V::LANES));
            }
        }
    }
}

/// [`tile`] for AVX2, whose 16 registers it fills to the last. Compilers load a second weight early and then keep one sum
/// in memory, whose round trip halves the speed; so the order of instructions is written down here.
///
/// # Safety
/// As for [`tile`].
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
unsafe fn tile_avx2(input: *const f32, offsets: &[usize], weights: &[[f32; ROWS]], sums: *mut f32, stride: usize) {
    // SAFETY: as the caller says; the assembly reads 24 pixels and 4 weights and writes registers only.
    unsafe {
        let at = |r: usize, g: usize| sums.add(r * stride + g * 8);
        let mut acc: [[__m256; 3]; 4] = std::array::from_fn(|r| std::array::from_fn(|g| _mm256_loadu_ps(at(r, g))));
        let [[a0, a1, a2], [b0, b1, b2], [c0, c1, c2], [d0, d1, d2]] = &mut acc;
        for (offset, weights) in offsets.iter().zip(weights) {
            std::arch::asm!(
                "vmovups {x0}, [{pixels}]",
                "vmovups {x1}, [{pixels} + 32]",
                "vmovups {x2}, [{pixels} + 64]",
                "vbroadcastss {w}, [{weights}]",
                "vfmadd231ps {a0}, {x0}, {w}", "vfmadd231ps {a1}, {x1}, {w}", "vfmadd231ps {a2}, {x2}, {w}",
                "vbroadcastss {w}, [{weights} + 4]",
                "vfmadd231ps {b0}, {x0}, {w}", "vfmadd231ps {b1}, {x1}, {w}", "vfmadd231ps {b2}, {x2}, {w}",
                "vbroadcastss {w}, [{weights} + 8]",
                "vfmadd231ps {c0}, {x0}, {w}", "vfmadd231ps {c1}, {x1}, {w}", "vfmadd231ps {c2}, {x2}, {w}",
                "vbroadcastss {w}, [{weights} + 12]",
                "vfmadd231ps {d0}, {x0}, {w}", "vfmadd231ps {d1}, {x1}, {w}", "vfmadd231ps {d2}, {x2}, {w}",
                pixels = in(reg) input.add(*offset), weights = in(reg) weights.as_ptr(),
                x0 = out(ymm_reg) _, x1 = out(ymm_reg) _, x2 = out(ymm_reg) _, w = out(ymm_reg) _,
                a0 = inout(ymm_reg) *a0, a1 = inout(ymm_reg) *a1, a2 = inout(ymm_reg) *a2,
                b0 = inout(ymm_reg) *b0, b1 = inout(ymm_reg) *b1, b2 = inout(ymm_reg) *b2,
                c0 = inout(ymm_reg) *c0, c1 = inout(ymm_reg) *c1, c2 = inout(ymm_reg) *c2,
                d0 = inout(ymm_reg) *d0, d1 = inout(ymm_reg) *d1, d2 = inout(ymm_reg) *d2,
                options(pure, readonly, nostack, preserves_flags),
            );
        }
        for (r, row) in acc.into_iter().enumerate() {
            for (g, sum) in row.into_iter().enumerate() {
                _mm256_storeu_ps(at(r, g), sum);
            }
        }
    }
}

#[cfg(test)]
mod tests;
