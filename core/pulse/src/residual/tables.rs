//! What the network computes once a frame and once a Gaussian, before the two meet (`kernel.rs`), with the derivatives.

use super::matrix::{Matrix, Real, add, add_row, dot, multiply};
use super::{BEAT_FEATURES, FRAME_FEATURES, HARMONICS, POSITION_FEATURES, POSITION_HIDDEN, Residual, phase_features};

/// What depends on the frame alone, T rows each.
pub struct Frames<T> {
    pub(super) beat: Vec<usize>,
    pub(super) features: Vec<T>,
    pub(super) z: Vec<T>,
    pub(super) z1: Vec<T>,
    pub(super) z2: Vec<T>,
    pub(super) output: Vec<T>,
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
    pub(super) points: Vec<T>,
    pub(super) hidden: Vec<T>,
    pub(super) features: Vec<T>,
    pub(super) s: Vec<T>,
    pub(super) s1: Vec<T>,
    pub(super) s2: Vec<T>,
    pub(super) output: Vec<T>,
}

impl<T: Real> Residual<T> {
    /// The weights of one part of the layout.
    pub(super) fn part(&self, range: &std::ops::Range<usize>) -> &[T] {
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
        let through = |block: &[std::ops::Range<usize>; 2]| {
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
        let through = |block: &std::ops::Range<usize>| {
            let mut out = vec![T::default(); count * w];
            multiply(&mut out, Matrix::new(&s, w), Matrix::new(self.part(block), w).transpose(), false);
            out
        };
        let (s1, s2) = (through(&layout.block[0][0]), through(&layout.block[1][0]));
        let output = s.chunks_exact(w).map(|row| dot(row, self.part(&layout.output))).collect();
        Positions { points, hidden, features, s, s1, s2, output }
    }

    /// Vector–Jacobian product of [`Self::frames`]: from ∂L/∂z to the input map and the beat embedding.
    pub(super) fn pull_frames(&self, frames: &Frames<T>, dz: &[T], gradient: &mut [T]) {
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

    /// Vector–Jacobian product of [`Self::positions`]: from ∂L/∂s to the input map and the position encoder.
    pub(super) fn pull_positions(&self, positions: &Positions<T>, ds: &[T], gradient: &mut [T]) {
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

/// `out += Σ rows`.
pub(super) fn sum_rows<T: Real>(out: &mut [T], rows: &[T]) {
    for row in rows.chunks_exact(out.len()) {
        add(out, row);
    }
}
