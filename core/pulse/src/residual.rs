//! The residual network f(θ, beat, p) of equation 2: ten harmonics of the phase (20), an 8-d embedding of the beat and
//! an 8-d encoding of the position, 36 → width, two residual tanh blocks, one scalar.
//!
//! h₀ = W·[e_φ, e_b, e_s] + b;  h₁ = h₀ + tanh(W₁h₀ + b₁);  h₂ = h₁ + tanh(W₂h₁ + b₂);  f = w·h₂ + b_o. The position
//! encoder is 3 → 32 → tanh → 8. The paper does not say how many linear maps a block has; one each is used here, which
//! makes all but one product separable into a part per frame and a part per Gaussian (`kernel.rs`).

mod kernel;
pub mod matrix;
mod tables;

pub use kernel::{Activations, Gradient};
pub use tables::{Frames, Positions};

use crate::error::PulseError;
use crate::numeric::Random;
use matrix::Real;

/// Harmonics of the phase embedding (paper: 10).
pub const HARMONICS: usize = 10;
/// Length of the beat embedding (paper: 8).
pub const BEAT_FEATURES: usize = 8;
/// Length of the position encoding (paper: 8).
pub const POSITION_FEATURES: usize = 8;
/// Hidden width of the position encoder; the paper says two layers only.
pub const POSITION_HIDDEN: usize = 32;
/// What every Gaussian of a frame shares: phase and beat.
pub const FRAME_FEATURES: usize = 2 * HARMONICS + BEAT_FEATURES;

/// Sizes that vary: the number of beats and the trunk's width.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Shape {
    /// Rows of the beat embedding, ≥ 1.
    pub beats: usize,
    /// Width of the trunk (paper: 128), in 1..=1024.
    pub width: usize,
}

/// The network: one flat list of weights, laid out by [`Shape::layout`].
#[derive(Clone, Debug, PartialEq)]
pub struct Residual<T = f32> {
    /// The sizes.
    pub shape: Shape,
    /// All weights.
    pub weights: Vec<T>,
}

/// Where each weight lies in the flat list; matrices are outputs × inputs, row-major.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Layout {
    /// beats × 8.
    pub beat: std::ops::Range<usize>,
    /// 32 × 3 and 32.
    pub position1: [std::ops::Range<usize>; 2],
    /// 8 × 32 and 8.
    pub position2: [std::ops::Range<usize>; 2],
    /// width × 28, the part of the 36 → width map that a frame shares.
    pub input_frame: std::ops::Range<usize>,
    /// width × 8, the part that belongs to a Gaussian.
    pub input_position: std::ops::Range<usize>,
    /// width.
    pub input_bias: std::ops::Range<usize>,
    /// width × width and width, twice.
    pub block: [[std::ops::Range<usize>; 2]; 2],
    /// width.
    pub output: std::ops::Range<usize>,
    /// 1.
    pub output_bias: std::ops::Range<usize>,
    /// Number of weights.
    pub len: usize,
}

impl Shape {
    /// Checks the sizes.
    ///
    /// # Errors
    /// When a size is outside its range.
    pub fn checked(self) -> Result<Self, PulseError> {
        if !(1..=1024).contains(&self.width) {
            return Err(PulseError::Parameter { name: "width", value: self.width as f64, range: "1 to 1024" });
        }
        if self.beats == 0 {
            return Err(PulseError::Parameter { name: "beats", value: 0.0, range: "1 or more" });
        }
        Ok(self)
    }

    /// Places every weight.
    pub fn layout(&self) -> Layout {
        let mut at = 0;
        let mut take = |count: usize| {
            at += count;
            at - count..at
        };
        let w = self.width;
        let beat = take(self.beats * BEAT_FEATURES);
        let position1 = [take(POSITION_HIDDEN * 3), take(POSITION_HIDDEN)];
        let position2 = [take(POSITION_FEATURES * POSITION_HIDDEN), take(POSITION_FEATURES)];
        let (input_frame, input_position) = (take(w * FRAME_FEATURES), take(w * POSITION_FEATURES));
        let input_bias = take(w);
        let block = [[take(w * w), take(w)], [take(w * w), take(w)]];
        let (output, output_bias) = (take(w), take(1));
        let len = output_bias.end;
        Layout { beat, position1, position2, input_frame, input_position, input_bias, block, output, output_bias, len }
    }
}

impl<T: Real> Residual<T> {
    /// Seeded initial weights: even in ±1/√(inputs) as PyTorch's linear layers, normal beat embedding, and an output
    /// layer of zeros, so that training starts from the fundamental alone.
    ///
    /// # Errors
    /// When a size is outside its range.
    pub fn new(shape: Shape, seed: u64) -> Result<Self, PulseError> {
        let layout = shape.checked()?.layout();
        let mut random = Random::new(seed);
        let mut weights = vec![T::default(); layout.len];
        for weight in &mut weights[layout.beat.clone()] {
            *weight = T::from_f64(random.normal());
        }
        let inputs = FRAME_FEATURES + POSITION_FEATURES;
        let w = shape.width;
        let [p1, p2] = [layout.position1.clone(), layout.position2.clone()];
        let [b1, b2] = layout.block.clone();
        for (ranges, inputs) in [
            (p1.to_vec(), 3),
            (p2.to_vec(), POSITION_HIDDEN),
            (vec![layout.input_frame, layout.input_position, layout.input_bias], inputs),
            (b1.to_vec(), w),
            (b2.to_vec(), w),
        ] {
            let bound = 1.0 / (inputs as f64).sqrt();
            for weight in ranges.into_iter().flat_map(|range| range.start..range.end) {
                weights[weight] = T::from_f64(bound * (2.0 * random.unit() - 1.0));
            }
        }
        Ok(Self { shape, weights })
    }

    /// The same weights in another precision.
    pub fn cast<U: Real>(&self) -> Residual<U> {
        Residual { shape: self.shape, weights: self.weights.iter().map(|w| U::from_f64(w.to_f64())).collect() }
    }

    /// The plain f64 text of the network for one frame and one Gaussian: what the kernels are judged by.
    pub fn reference(&self, theta: f64, beat: usize, position: [f32; 3]) -> f64 {
        let layout = self.shape.layout();
        let at = |range: &std::ops::Range<usize>| -> Vec<f64> {
            self.weights[range.clone()].iter().map(|w| w.to_f64()).collect()
        };
        let linear = |[matrix, bias]: &[std::ops::Range<usize>; 2], x: &[f64]| -> Vec<f64> {
            let (matrix, mut y) = (at(matrix), at(bias));
            for (y, row) in y.iter_mut().zip(matrix.chunks_exact(x.len())) {
                *y += row.iter().zip(x).map(|(w, x)| w * x).sum::<f64>();
            }
            y
        };
        let tanh = |x: Vec<f64>| -> Vec<f64> { x.into_iter().map(f64::tanh).collect() };
        let mut frame = phase_features(theta).to_vec();
        frame.extend(&at(&layout.beat)[beat * BEAT_FEATURES..(beat + 1) * BEAT_FEATURES]);
        let hidden = tanh(linear(&layout.position1, &position.map(f64::from)));
        let place = linear(&layout.position2, &hidden);
        let (by_frame, by_place) = (at(&layout.input_frame), at(&layout.input_position));
        let mut h = at(&layout.input_bias);
        for (k, h) in h.iter_mut().enumerate() {
            *h += (0..FRAME_FEATURES).map(|j| by_frame[k * FRAME_FEATURES + j] * frame[j]).sum::<f64>();
            *h += (0..POSITION_FEATURES).map(|j| by_place[k * POSITION_FEATURES + j] * place[j]).sum::<f64>();
        }
        for block in &layout.block {
            let step = tanh(linear(block, &h));
            h.iter_mut().zip(step).for_each(|(h, step)| *h += step);
        }
        let output = at(&layout.output);
        at(&layout.output_bias)[0] + output.iter().zip(&h).map(|(w, h)| w * h).sum::<f64>()
    }
}

/// [sin kθ, cos kθ] for k = 1..10 (paper, e_φ).
pub fn phase_features(theta: f64) -> [f64; 2 * HARMONICS] {
    std::array::from_fn(|j| {
        let angle = (j / 2 + 1) as f64 * theta;
        if j % 2 == 0 { angle.sin() } else { angle.cos() }
    })
}
