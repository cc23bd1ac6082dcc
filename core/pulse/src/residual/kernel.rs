//! The network over all frames × positions at once, forward and backward (they are neighbours on purpose).
//!
//! With z = W_f·[e_φ, e_b] + b per frame and s = W_s·e_s per Gaussian, h₀ = z + s. So W₁h₀, W₂h₀ and w·h₀ split into a
//! table per frame and a table per Gaussian, and only W₂·tanh(·) needs a product per (frame, Gaussian): 16k of the 68k
//! multiply-adds. The weight gradients of the separable parts are sums of per-frame and per-Gaussian sums for the same
//! reason. Work is cut into tasks of whole frames by sizes alone, and partial sums are added in task order, so results
//! do not depend on the number of threads.

use std::ops::Range;

use rayon::prelude::*;

use super::matrix::{Matrix, Real, add, add_row, add_scaled, dot, multiply};
use super::{BEAT_FEATURES, FRAME_FEATURES, HARMONICS, POSITION_FEATURES, POSITION_HIDDEN, Residual, phase_features};

/// Rows (frame, Gaussian) handled at once: their activations stay in the second-level cache.
const BLOCK_ROWS: usize = 256;
/// Most tasks a pass is cut into; bounds the memory of partial gradients.
const MOST_TASKS: usize = 32;

/// What depends on the frame alone, T rows each.
pub struct Frames<T> {
    beat: Vec<usize>,
    features: Vec<T>,
    z: Vec<T>,
    z1: Vec<T>,
    z2: Vec<T>,
    output: Vec<T>,
}

impl<T: Real> Frames<T> {
    /// The tables of some frames only, in the order asked for.
    pub(crate) fn picked(&self, frames: &[usize], width: usize) -> Self {
        let rows = |table: &[T], columns: usize| -> Vec<T> {
            frames.iter().flat_map(|&t| table[t * columns..(t + 1) * columns].iter().copied()).collect()
        };
        Self {
            beat: frames.iter().map(|&t| self.beat[t]).collect(),
            features: rows(&self.features, FRAME_FEATURES),
            z: rows(&self.z, width),
            z1: rows(&self.z1, width),
            z2: rows(&self.z2, width),
            output: rows(&self.output, 1),
        }
    }
}

/// What depends on the Gaussian alone, K rows each.
pub struct Positions<T> {
    points: Vec<T>,
    hidden: Vec<T>,
    features: Vec<T>,
    s: Vec<T>,
    s1: Vec<T>,
    s2: Vec<T>,
    output: Vec<T>,
}

/// The gradient with respect to all weights, in their layout.
pub type Gradient<T> = Vec<T>;

/// Partial sums of one task.
struct Partial<T> {
    block2: Vec<T>,
    output: Vec<T>,
    /// Per frame of the task: ∂L/∂(W₁h₀), ∂L/∂(W₂h₀).
    frame1: Vec<T>,
    frame2: Vec<T>,
    /// Per Gaussian.
    place1: Vec<T>,
    place2: Vec<T>,
}

impl<T: Real> Residual<T> {
    fn part(&self, range: &Range<usize>) -> &[T] {
        &self.weights[range.clone()]
    }

    /// Tables of the frames: phase θ (radians) and beat index a frame; beats beyond the embedding share its last row.
    pub fn frames(&self, theta: &[f64], beat: &[u32]) -> Frames<T> {
        let (layout, w, count) = (self.shape.layout(), self.shape.width, theta.len());
        let beat: Vec<usize> = beat.iter().map(|&b| (b as usize).min(self.shape.beats - 1)).collect();
        let mut features = vec![T::default(); count * FRAME_FEATURES];
        for ((row, &theta), &beat) in features.chunks_exact_mut(FRAME_FEATURES).zip(theta).zip(&beat) {
            for (feature, value) in row.iter_mut().zip(phase_features(theta)) {
                *feature = T::from_f64(value);
            }
            let at = layout.beat.start + beat * BEAT_FEATURES;
            row[2 * HARMONICS..].copy_from_slice(&self.weights[at..at + BEAT_FEATURES]);
        }
        let mut z = vec![T::default(); count * w];
        let input = Matrix::new(self.part(&layout.input_frame), FRAME_FEATURES);
        multiply(&mut z, Matrix::new(&features, FRAME_FEATURES), input.transpose(), false);
        add_row(&mut z, self.part(&layout.input_bias));
        let through = |block: &[Range<usize>; 2]| {
            let mut out = vec![T::default(); count * w];
            multiply(&mut out, Matrix::new(&z, w), Matrix::new(self.part(&block[0]), w).transpose(), false);
            add_row(&mut out, self.part(&block[1]));
            out
        };
        let (z1, z2) = (through(&layout.block[0]), through(&layout.block[1]));
        let bias = self.weights[layout.output_bias.start];
        let output = z.chunks_exact(w).map(|row| dot(row, self.part(&layout.output)) + bias).collect();
        Frames { beat, features, z, z1, z2, output }
    }

    /// Tables of the positions, normalised to [−1, 1]³.
    pub fn positions(&self, points: &[[f32; 3]]) -> Positions<T> {
        let (layout, w, count) = (self.shape.layout(), self.shape.width, points.len());
        let points: Vec<T> = points.as_flattened().iter().map(|&p| T::from_f64(f64::from(p))).collect();
        let mut hidden = vec![T::default(); count * POSITION_HIDDEN];
        let first = Matrix::new(self.part(&layout.position1[0]), 3);
        multiply(&mut hidden, Matrix::new(&points, 3), first.transpose(), false);
        add_row(&mut hidden, self.part(&layout.position1[1]));
        T::tanh(&mut hidden);
        let mut features = vec![T::default(); count * POSITION_FEATURES];
        let second = Matrix::new(self.part(&layout.position2[0]), POSITION_HIDDEN);
        multiply(&mut features, Matrix::new(&hidden, POSITION_HIDDEN), second.transpose(), false);
        add_row(&mut features, self.part(&layout.position2[1]));
        let mut s = vec![T::default(); count * w];
        let input = Matrix::new(self.part(&layout.input_position), POSITION_FEATURES);
        multiply(&mut s, Matrix::new(&features, POSITION_FEATURES), input.transpose(), false);
        let through = |block: &Range<usize>| {
            let mut out = vec![T::default(); count * w];
            multiply(&mut out, Matrix::new(&s, w), Matrix::new(self.part(block), w).transpose(), false);
            out
        };
        let (s1, s2) = (through(&layout.block[0][0]), through(&layout.block[1][0]));
        let output = s.chunks_exact(w).map(|row| dot(row, self.part(&layout.output))).collect();
        Positions { points, hidden, features, s, s1, s2, output }
    }

    /// f for every frame and position, T×K.
    pub fn forward(&self, frames: &Frames<T>, positions: &Positions<T>) -> Vec<T> {
        let count = positions.output.len();
        let mut out = vec![T::default(); frames.output.len() * count];
        let per_task = frames_per_task(frames.output.len(), count);
        out.par_chunks_mut((per_task * count).max(1)).enumerate().for_each(|(task, out)| {
            let mut scratch = Scratch::new(self.shape.width);
            for (offset, out) in out.chunks_mut(frames_per_block(count) * count).enumerate() {
                let first = task * per_task + offset * frames_per_block(count);
                self.block_forward(frames, positions, first, &mut scratch, out);
            }
        });
        out
    }

    /// One block of whole frames from `first`: fills the activations and `out`.
    fn block_forward(
        &self,
        frames: &Frames<T>,
        positions: &Positions<T>,
        first: usize,
        scratch: &mut Scratch<T>,
        out: &mut [T],
    ) {
        let (layout, w, count) = (self.shape.layout(), self.shape.width, positions.output.len());
        let size = out.len() * w;
        let Scratch { inner, outer, .. } = scratch.resized(size);
        sum_tables(inner, &frames.z1[first * w..], &positions.s1, w, false);
        T::tanh(inner);
        multiply(outer, Matrix::new(inner, w), Matrix::new(self.part(&layout.block[1][0]), w).transpose(), false);
        sum_tables(outer, &frames.z2[first * w..], &positions.s2, w, true);
        T::tanh(outer);
        let weights = self.part(&layout.output);
        for (row, out) in out.iter_mut().enumerate() {
            let (frame, place) = (first + row / count, row % count);
            let at = row * w..(row + 1) * w;
            let hidden = dot(&inner[at.clone()], weights) + dot(&outer[at], weights);
            *out = frames.output[frame] + positions.output[place] + hidden;
        }
    }

    /// The gradient with respect to all weights given ∂L/∂f, T×K. Activations are computed again block by block:
    /// cheaper than storing them.
    pub fn backward(&self, frames: &Frames<T>, positions: &Positions<T>, pulled: &[T]) -> Gradient<T> {
        let count = positions.output.len();
        let per_task = frames_per_task(frames.output.len(), count);
        let partials: Vec<Partial<T>> = pulled
            .par_chunks((per_task * count).max(1))
            .enumerate()
            .map(|(task, pulled)| self.task_backward(frames, positions, task * per_task, pulled))
            .collect();
        self.gather(frames, positions, pulled, &partials)
    }

    fn task_backward(&self, frames: &Frames<T>, positions: &Positions<T>, first: usize, pulled: &[T]) -> Partial<T> {
        let (layout, w, count) = (self.shape.layout(), self.shape.width, positions.output.len());
        let zeros = |n: usize| vec![T::default(); n];
        let task_frames = pulled.len() / count;
        let mut partial = Partial {
            block2: zeros(w * w),
            output: zeros(w),
            frame1: zeros(task_frames * w),
            frame2: zeros(task_frames * w),
            place1: zeros(count * w),
            place2: zeros(count * w),
        };
        let (weights, mut scratch, mut out) = (self.part(&layout.output), Scratch::new(w), Vec::new());
        for (block, pulled) in pulled.chunks(frames_per_block(count) * count).enumerate() {
            let start = block * frames_per_block(count);
            out.resize(pulled.len(), T::default());
            self.block_forward(frames, positions, first + start, &mut scratch, &mut out);
            let Scratch { inner, outer, back } = scratch.resized(pulled.len() * w);
            for (row, &g) in pulled.iter().enumerate() {
                let at = row * w..(row + 1) * w;
                let (inner, outer, back) = (&inner[at.clone()], &mut outer[at.clone()], &mut back[at]);
                for k in 0..w {
                    partial.output[k] += g * (inner[k] + outer[k]);
                    back[k] = g * weights[k];
                    outer[k] = back[k] * (T::ONE - outer[k] * outer[k]);
                }
                let frame = (start + row / count) * w;
                add(&mut partial.frame2[frame..frame + w], outer);
                add(&mut partial.place2[row % count * w..(row % count + 1) * w], outer);
            }
            multiply(&mut partial.block2, Matrix::new(outer, w).transpose(), Matrix::new(inner, w), true);
            multiply(back, Matrix::new(outer, w), Matrix::new(self.part(&layout.block[1][0]), w), true);
            for row in 0..pulled.len() {
                let at = row * w..(row + 1) * w;
                let (inner, back) = (&inner[at.clone()], &mut back[at]);
                for k in 0..w {
                    back[k] = back[k] * (T::ONE - inner[k] * inner[k]);
                }
                let frame = (start + row / count) * w;
                add(&mut partial.frame1[frame..frame + w], back);
                add(&mut partial.place1[row % count * w..(row % count + 1) * w], back);
            }
        }
        partial
    }

    /// Adds the partial sums in task order and pulls them through the separable layers.
    fn gather(
        &self,
        frames: &Frames<T>,
        positions: &Positions<T>,
        pulled: &[T],
        partials: &[Partial<T>],
    ) -> Gradient<T> {
        let (layout, w, count) = (self.shape.layout(), self.shape.width, positions.output.len());
        let mut gradient = vec![T::default(); layout.len];
        let (mut frame1, mut frame2) = (Vec::new(), Vec::new());
        let (mut place1, mut place2) = (vec![T::default(); count * w], vec![T::default(); count * w]);
        for partial in partials {
            frame1.extend_from_slice(&partial.frame1);
            frame2.extend_from_slice(&partial.frame2);
            add(&mut place1, &partial.place1);
            add(&mut place2, &partial.place2);
            add(&mut gradient[layout.block[1][0].clone()], &partial.block2);
            add(&mut gradient[layout.output.clone()], &partial.output);
        }
        let mut to_frame = vec![T::default(); frames.output.len()];
        let mut to_place = vec![T::default(); count];
        for (row, to_frame) in pulled.chunks_exact(count).zip(&mut to_frame) {
            for (g, to_place) in row.iter().zip(&mut to_place) {
                *to_frame += *g;
                *to_place += *g;
            }
            gradient[layout.output_bias.start] += *to_frame;
        }
        let sides = [(&frames.z, &to_frame, [&frame1, &frame2]), (&positions.s, &to_place, [&place1, &place2])];
        let [dz, ds] = sides.map(|(table, to_output, through)| self.pull(table, to_output, through, &mut gradient));
        for (block, sums) in layout.block.iter().zip([&frame1, &frame2]) {
            sum_rows(&mut gradient[block[1].clone()], sums);
        }
        self.pull_frames(frames, &dz, &mut gradient);
        self.pull_positions(positions, &ds, &mut gradient);
        gradient
    }

    /// Gradient of one side's h₀ table, adding the side's share of W₁, W₂ and w.
    fn pull(&self, table: &[T], to_output: &[T], through: [&Vec<T>; 2], gradient: &mut [T]) -> Vec<T> {
        let (layout, w) = (self.shape.layout(), self.shape.width);
        let mut pulled = vec![T::default(); table.len()];
        for ((pulled, row), &g) in pulled.chunks_exact_mut(w).zip(table.chunks_exact(w)).zip(to_output) {
            add_scaled(pulled, g, self.part(&layout.output));
            add_scaled(&mut gradient[layout.output.clone()], g, row);
        }
        for (block, through) in layout.block.iter().zip(through) {
            multiply(&mut pulled, Matrix::new(through, w), Matrix::new(self.part(&block[0]), w), true);
            let weight = &mut gradient[block[0].clone()];
            multiply(weight, Matrix::new(through, w).transpose(), Matrix::new(table, w), true);
        }
        pulled
    }

    fn pull_frames(&self, frames: &Frames<T>, dz: &[T], gradient: &mut [T]) {
        let (layout, w) = (self.shape.layout(), self.shape.width);
        sum_rows(&mut gradient[layout.input_bias.clone()], dz);
        let features = Matrix::new(&frames.features, FRAME_FEATURES);
        multiply(&mut gradient[layout.input_frame.clone()], Matrix::new(dz, w).transpose(), features, true);
        let mut to_features = vec![T::default(); frames.features.len()];
        let input = Matrix::new(self.part(&layout.input_frame), FRAME_FEATURES);
        multiply(&mut to_features, Matrix::new(dz, w), input, false);
        for (row, beat) in to_features.chunks_exact(FRAME_FEATURES).zip(&frames.beat) {
            let at = layout.beat.start + beat * BEAT_FEATURES;
            add(&mut gradient[at..at + BEAT_FEATURES], &row[2 * HARMONICS..]);
        }
    }

    fn pull_positions(&self, positions: &Positions<T>, ds: &[T], gradient: &mut [T]) {
        let (layout, w) = (self.shape.layout(), self.shape.width);
        let features = Matrix::new(&positions.features, POSITION_FEATURES);
        multiply(&mut gradient[layout.input_position.clone()], Matrix::new(ds, w).transpose(), features, true);
        let mut to_features = vec![T::default(); positions.features.len()];
        let input = Matrix::new(self.part(&layout.input_position), POSITION_FEATURES);
        multiply(&mut to_features, Matrix::new(ds, w), input, false);
        sum_rows(&mut gradient[layout.position2[1].clone()], &to_features);
        let (pulled, hidden) =
            (Matrix::new(&to_features, POSITION_FEATURES), Matrix::new(&positions.hidden, POSITION_HIDDEN));
        multiply(&mut gradient[layout.position2[0].clone()], pulled.transpose(), hidden, true);
        let mut to_hidden = vec![T::default(); positions.hidden.len()];
        multiply(&mut to_hidden, pulled, Matrix::new(self.part(&layout.position2[0]), POSITION_HIDDEN), false);
        for (g, h) in to_hidden.iter_mut().zip(&positions.hidden) {
            *g = *g * (T::ONE - *h * *h);
        }
        sum_rows(&mut gradient[layout.position1[1].clone()], &to_hidden);
        let pulled = Matrix::new(&to_hidden, POSITION_HIDDEN).transpose();
        multiply(&mut gradient[layout.position1[0].clone()], pulled, Matrix::new(&positions.points, 3), true);
    }
}

/// Activations of one block, reused.
struct Scratch<T> {
    inner: Vec<T>,
    outer: Vec<T>,
    back: Vec<T>,
}

impl<T: Real> Scratch<T> {
    fn new(width: usize) -> Self {
        let zeros = || vec![T::default(); BLOCK_ROWS * width];
        Self { inner: zeros(), outer: zeros(), back: zeros() }
    }

    fn resized(&mut self, size: usize) -> &mut Self {
        for buffer in [&mut self.inner, &mut self.outer, &mut self.back] {
            buffer.resize(size, T::default());
        }
        self
    }
}

fn frames_per_block(count: usize) -> usize {
    (BLOCK_ROWS / count.max(1)).max(1)
}

/// Whole blocks a task, by sizes alone.
fn frames_per_task(frames: usize, count: usize) -> usize {
    let block = frames_per_block(count);
    frames.div_ceil(block).div_ceil(MOST_TASKS).max(1) * block
}

/// Row (frame, Gaussian) of `out` becomes, or gains, the sum of the frame's and the Gaussian's table rows.
fn sum_tables<T: Real>(out: &mut [T], frames: &[T], places: &[T], width: usize, accumulate: bool) {
    let rows = out.chunks_exact_mut(places.len());
    for (rows, frame) in rows.zip(frames.chunks_exact(width)) {
        for (row, place) in rows.chunks_exact_mut(width).zip(places.chunks_exact(width)) {
            for ((out, frame), place) in row.iter_mut().zip(frame).zip(place) {
                let sum = *frame + *place;
                *out = if accumulate { *out + sum } else { sum };
            }
        }
    }
}

/// `out += Σ rows`.
fn sum_rows<T: Real>(out: &mut [T], rows: &[T]) {
    for row in rows.chunks_exact(out.len()) {
        add(out, row);
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::numeric::Random;
    use crate::residual::Shape;

    struct Case {
        network: Residual<f64>,
        theta: Vec<f64>,
        beat: Vec<u32>,
        points: Vec<[f32; 3]>,
        pulled: Vec<f64>,
    }

    fn case(width: usize, frames: usize, count: usize) -> Case {
        let mut random = Random::new(21);
        let shape = Shape { beats: 3, width };
        let mut network = Residual::<f64>::new(shape, 4).unwrap();
        let output = shape.layout().output;
        network.weights[output].iter_mut().for_each(|w| *w = 0.3 * random.normal());
        Case {
            network,
            theta: (0..frames).map(|_| 3.0 * random.normal()).collect(),
            beat: (0..frames).map(|t| (3 * t / frames) as u32).collect(),
            points: (0..count).map(|_| std::array::from_fn(|_| random.normal() as f32)).collect(),
            pulled: (0..frames * count).map(|_| random.normal()).collect(),
        }
    }

    #[test]
    fn kernel_agrees_with_the_plain_text_in_both_precisions() {
        let c = case(128, 70, 9);
        let wide = c.network.forward(&c.network.frames(&c.theta, &c.beat), &c.network.positions(&c.points));
        let narrow = c.network.cast::<f32>();
        let single = narrow.forward(&narrow.frames(&c.theta, &c.beat), &narrow.positions(&c.points));
        for t in 0..70 {
            for i in 0..9 {
                let plain = c.network.reference(c.theta[t], c.beat[t] as usize, c.points[i]);
                assert!((wide[t * 9 + i] - plain).abs() < 1e-11);
                assert!((f64::from(single[t * 9 + i]) - plain).abs() < 2e-5, "{} {plain}", single[t * 9 + i]);
            }
        }
    }

    #[test]
    fn gradient_matches_finite_differences_of_the_plain_text() {
        let c = case(12, 11, 5);
        let loss = |network: &Residual<f64>| {
            let mut sum = 0.0;
            for t in 0..11 {
                for i in 0..5 {
                    sum += c.pulled[t * 5 + i] * network.reference(c.theta[t], c.beat[t] as usize, c.points[i]);
                }
            }
            sum
        };
        let frames = c.network.frames(&c.theta, &c.beat);
        let gradient = c.network.backward(&frames, &c.network.positions(&c.points), &c.pulled);
        let h = 1e-5;
        for k in 0..gradient.len() {
            let (mut up, mut down) = (c.network.clone(), c.network.clone());
            up.weights[k] += h;
            down.weights[k] -= h;
            let slope = (loss(&up) - loss(&down)) / (2.0 * h);
            assert!((slope - gradient[k]).abs() < 1e-7 * slope.abs().max(1.0), "weight {k}: {slope} {}", gradient[k]);
        }
    }

    #[test]
    fn f32_gradient_follows_f64_and_threads_change_nothing() {
        let c = case(64, 300, 8);
        let frames = c.network.frames(&c.theta, &c.beat);
        let wide = c.network.backward(&frames, &c.network.positions(&c.points), &c.pulled);
        let narrow = c.network.cast::<f32>();
        let pulled: Vec<f32> = c.pulled.iter().map(|g| *g as f32).collect();
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| narrow.backward(&narrow.frames(&c.theta, &c.beat), &narrow.positions(&c.points), &pulled))
        };
        let single = run(1);
        assert_eq!(single, run(3));
        let norm = wide.iter().map(|g| g * g).sum::<f64>().sqrt();
        let apart = wide.iter().zip(&single).map(|(a, b)| (a - f64::from(*b)).powi(2)).sum::<f64>().sqrt();
        assert!(apart < 1e-5 * norm, "{}", apart / norm);
    }
}
