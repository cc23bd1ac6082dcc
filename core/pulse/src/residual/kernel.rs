//! The network over all frames × positions at once, forward and backward (they are neighbours on purpose).
//!
//! With z = W_f·[e_φ, e_b] + b per frame and s = W_s·e_s per Gaussian, h₀ = z + s. So W₁h₀, W₂h₀ and w·h₀ split into a
//! table per frame and a table per Gaussian, and only W₂·tanh(·) needs a product per (frame, Gaussian): 16k of the 37k
//! multiply-adds. The weight gradients of the separable parts are sums of per-frame and per-Gaussian sums for the same
//! reason. Work is cut into tasks of whole frames by sizes alone, and partial sums are added in task order, so results
//! do not depend on the number of threads.

use rayon::prelude::*;

use super::Residual;
use super::matrix::{Matrix, Real, add, add_scaled, dot, multiply};
use super::tables::{Frames, Positions, sum_rows};

/// Rows (frame, Gaussian) handled at once: their activations stay in the second-level cache.
const BLOCK_ROWS: usize = 256;
/// Most tasks a pass is cut into; bounds the memory of partial gradients.
const MOST_TASKS: usize = 32;

/// The two hidden activations of some rows.
struct Block<T> {
    inner: Vec<T>,
    outer: Vec<T>,
}

/// What a forward pass keeps for the backward pass.
pub struct Activations<T>(Block<T>);

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
    /// f for every frame and position, T×K.
    pub fn forward(&self, frames: &Frames<T>, positions: &Positions<T>) -> Vec<T> {
        let (count, w) = (positions.output.len(), self.shape.width);
        let mut out = vec![T::default(); frames.output.len() * count];
        let (per_task, per_block) = (frames_per_task(frames.output.len(), count), frames_per_block(count));
        out.par_chunks_mut((per_task * count).max(1)).enumerate().for_each(|(task, out)| {
            let mut scratch = Block { inner: Vec::new(), outer: Vec::new() };
            for (offset, out) in out.chunks_mut(per_block * count).enumerate() {
                scratch.inner.resize(out.len() * w, T::default());
                scratch.outer.resize(out.len() * w, T::default());
                let first = task * per_task + offset * per_block;
                self.block_forward(frames, positions, first, (&mut scratch.inner, &mut scratch.outer), out);
            }
        });
        out
    }

    /// As [`Self::forward`], keeping what [`Self::backward`] needs: 2·T·K·width numbers.
    pub fn forward_kept(&self, frames: &Frames<T>, positions: &Positions<T>) -> (Vec<T>, Activations<T>) {
        let (count, w) = (positions.output.len(), self.shape.width);
        let mut out = vec![T::default(); frames.output.len() * count];
        let mut kept =
            Activations(Block { inner: vec![T::default(); out.len() * w], outer: vec![T::default(); out.len() * w] });
        let (per_task, per_block) = (frames_per_task(frames.output.len(), count), frames_per_block(count));
        let rows = (per_task * count).max(1);
        let (inner, outer) = (kept.0.inner.par_chunks_mut(rows * w), kept.0.outer.par_chunks_mut(rows * w));
        out.par_chunks_mut(rows).zip(inner).zip(outer).enumerate().for_each(|(task, ((out, inner), outer))| {
            let rows = per_block * count;
            let blocks = out.chunks_mut(rows).zip(inner.chunks_mut(rows * w)).zip(outer.chunks_mut(rows * w));
            for (offset, ((out, inner), outer)) in blocks.enumerate() {
                let first = task * per_task + offset * per_block;
                self.block_forward(frames, positions, first, (inner, outer), out);
            }
        });
        (out, kept)
    }

    /// One block of whole frames from `first`: fills the activations tanh(W₁h₀ + b₁), tanh(W₂h₁ + b₂) and `out`.
    fn block_forward(
        &self,
        frames: &Frames<T>,
        positions: &Positions<T>,
        first: usize,
        (inner, outer): (&mut [T], &mut [T]),
        out: &mut [T],
    ) {
        let (layout, w, count) = (self.shape.layout(), self.shape.width, positions.output.len());
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

    /// The gradient with respect to all weights given ∂L/∂f, T×K, and what the forward pass kept.
    pub fn backward(
        &self,
        frames: &Frames<T>,
        positions: &Positions<T>,
        kept: &Activations<T>,
        pulled: &[T],
    ) -> Gradient<T> {
        let (count, w) = (positions.output.len(), self.shape.width);
        let rows = (frames_per_task(frames.output.len(), count) * count).max(1);
        let kept = kept.0.inner.par_chunks(rows * w).zip(kept.0.outer.par_chunks(rows * w));
        let partials: Vec<Partial<T>> = pulled
            .par_chunks(rows)
            .zip(kept)
            .map(|(pulled, (inner, outer))| self.task_backward(count, (inner, outer), pulled))
            .collect();
        self.gather(frames, positions, pulled, &partials)
    }

    fn task_backward(&self, count: usize, (inner, outer): (&[T], &[T]), pulled: &[T]) -> Partial<T> {
        let (layout, w) = (self.shape.layout(), self.shape.width);
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
        let weights = self.part(&layout.output);
        let rows = frames_per_block(count) * count;
        let (mut through2, mut through1) = (Vec::new(), Vec::new());
        let blocks = pulled.chunks(rows).zip(inner.chunks(rows * w)).zip(outer.chunks(rows * w));
        for (block, ((pulled, inner), outer)) in blocks.enumerate() {
            let start = block * frames_per_block(count);
            through2.resize(outer.len(), T::default());
            through1.resize(outer.len(), T::default());
            for (row, &g) in pulled.iter().enumerate() {
                let at = row * w..(row + 1) * w;
                let (inner, outer) = (&inner[at.clone()], &outer[at.clone()]);
                let (through2, through1) = (&mut through2[at.clone()], &mut through1[at]);
                for k in 0..w {
                    partial.output[k] += g * (inner[k] + outer[k]);
                    through1[k] = g * weights[k];
                    through2[k] = through1[k] * (T::ONE - outer[k] * outer[k]);
                }
                add_to_tables((&mut partial.frame2, &mut partial.place2), start, (row, count), through2);
            }
            multiply(&mut partial.block2, Matrix::new(&through2, w).transpose(), Matrix::new(inner, w), true);
            multiply(&mut through1, Matrix::new(&through2, w), Matrix::new(self.part(&layout.block[1][0]), w), true);
            for (row, through1) in through1.chunks_exact_mut(w).enumerate() {
                for (value, inner) in through1.iter_mut().zip(&inner[row * w..]) {
                    *value = *value * (T::ONE - *inner * *inner);
                }
                add_to_tables((&mut partial.frame1, &mut partial.place1), start, (row, count), through1);
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
}

/// Adds one row's derivative to its frame's and its Gaussian's sums.
fn add_to_tables<T: Real>(
    (frames, places): (&mut [T], &mut [T]),
    start: usize,
    (row, count): (usize, usize),
    derivative: &[T],
) {
    let w = derivative.len();
    let (frame, place) = (start + row / count, row % count);
    add(&mut frames[frame * w..(frame + 1) * w], derivative);
    add(&mut places[place * w..(place + 1) * w], derivative);
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
        let (frames, positions) = (c.network.frames(&c.theta, &c.beat), c.network.positions(&c.points));
        let (out, kept) = c.network.forward_kept(&frames, &positions);
        assert_eq!(out, c.network.forward(&frames, &positions));
        let gradient = c.network.backward(&frames, &positions, &kept, &c.pulled);
        let h = 1e-5;
        for (k, exact) in gradient.iter().enumerate() {
            let (mut up, mut down) = (c.network.clone(), c.network.clone());
            up.weights[k] += h;
            down.weights[k] -= h;
            let slope = (loss(&up) - loss(&down)) / (2.0 * h);
            assert!((slope - exact).abs() < 1e-7 * slope.abs().max(1.0), "weight {k}: {slope} {}", exact);
        }
    }

    #[test]
    fn f32_gradient_follows_f64_and_threads_change_nothing() {
        let c = case(64, 300, 8);
        fn gradient<T: Real>(network: &Residual<T>, c: &Case) -> Vec<T> {
            let (frames, positions) = (network.frames(&c.theta, &c.beat), network.positions(&c.points));
            let pulled: Vec<T> = c.pulled.iter().map(|g| T::from_f64(*g)).collect();
            network.backward(&frames, &positions, &network.forward_kept(&frames, &positions).1, &pulled)
        }
        let (wide, narrow) = (gradient(&c.network, &c), c.network.cast::<f32>());
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| gradient(&narrow, &c))
        };
        let single = run(1);
        assert_eq!(single, run(3));
        let norm = wide.iter().map(|g| g * g).sum::<f64>().sqrt();
        let apart = wide.iter().zip(&single).map(|(a, b)| (a - f64::from(*b)).powi(2)).sum::<f64>().sqrt();
        assert!(apart < 1e-5 * norm, "{}", apart / norm);
    }
}
