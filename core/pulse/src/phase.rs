//! Cardiac phase over a clip: cumulative (paper, equation 3), direct on the unit circle (the paper's alternative), or held
//! by anchors (`phase/anchored.rs`), which does not drift and goes on beyond the fitted frames.
//!
//! One value a frame, radians in [−π, π], 0 at the systolic peak. Everything f64: the accumulated phase of 10⁶ frames
//! keeps an error below 1e-8 rad, tested.

mod anchored;
mod forecast;

pub use anchored::Anchors;

use crate::numeric::{sigmoid, softplus, softplus_inverse, wrap};

/// How θ(t) is parameterised.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Parameterization {
    /// φ(t) = φ₀ + Σ softplus(raw_k), θ = atan2(sin φ, cos φ): time never runs backwards.
    #[default]
    Cumulative,
    /// One free point (x, y) of the unit circle a frame.
    Direct,
    /// A bounded correction at each beat of the reference, linear in time between: errors do not add up, and phase is
    /// defined at any time.
    Anchored,
}

/// The learnable phase of a clip of T ≥ 1 frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Phase {
    /// The parameterisation, which says what `raw` holds.
    pub parameterization: Parameterization,
    /// φ₀, radians; unused by `Direct`.
    pub initial: f64,
    /// `Cumulative`: T raw increments, softplus of which is δ_k. `Direct`: T pairs (x, y), interleaved. `Anchored`: one
    /// raw correction an anchor.
    pub raw: Vec<f64>,
    /// Of `Anchored`; empty otherwise.
    pub anchors: Anchors,
}

/// What is known of the heart beyond the fitted frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Known<'a> {
    /// Nothing.
    Nothing,
    /// When its beats fall (systolic peaks, seconds, increasing): a prescription, or a PPG.
    Beats(&'a [f64]),
    /// The pulse that the video shows, one value a later frame: its phase (radians, aligned to the fitted one) and how
    /// far to believe it, in [0, 1].
    Video {
        /// Radians in [−π, π].
        theta: &'a [f64],
        /// In [0, 1].
        confidence: &'a [f64],
    },
}

/// A phase beyond the fitted frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Continued {
    /// θ, radians in [−π, π].
    pub theta: Vec<f64>,
    /// How far it is expected to be off, radians: the variability of the beats since the last one known. 0 between known
    /// beats; NaN where the parameterisation cannot tell.
    pub spread_radians: Vec<f64>,
}

/// Gradient with respect to the fields of [`Phase`].
#[derive(Clone, Debug, PartialEq)]
pub struct PhaseGradient {
    /// ∂L/∂φ₀.
    pub initial: f64,
    /// ∂L/∂raw, the layout of [`Phase::raw`].
    pub raw: Vec<f64>,
}

/// Least increment at initialisation, radians a frame: 0.6 beats a minute at 30 frames/s. Softplus cannot reach 0.
const LEAST_INCREMENT: f64 = 2e-3;

impl Phase {
    /// As [`Self::following_at`] with a frame a second.
    pub fn following(parameterization: Parameterization, unwrapped: &[f64]) -> Self {
        let frames: Vec<f64> = (0..unwrapped.len()).map(|t| t as f64).collect();
        Self::following_at(parameterization, &frames, unwrapped)
    }

    /// A phase that follows `unwrapped` (radians, one a frame) at increasing frame times as closely as its
    /// parameterisation can; increments are floored at 2e-3 rad a frame, since the cumulative form only moves forward.
    pub fn following_at(parameterization: Parameterization, frame_seconds: &[f64], unwrapped: &[f64]) -> Self {
        match parameterization {
            Parameterization::Direct => {
                let raw = unwrapped.iter().flat_map(|angle| [angle.cos(), angle.sin()]).collect();
                Self { parameterization, initial: 0.0, raw, anchors: Anchors::default() }
            }
            Parameterization::Anchored => {
                let anchors = Anchors::through(frame_seconds, unwrapped);
                Self { parameterization, initial: 0.0, raw: vec![0.0; anchors.seconds.len()], anchors }
            }
            Parameterization::Cumulative => {
                let first = unwrapped.first().copied().unwrap_or(0.0);
                let second = unwrapped.get(1).copied().unwrap_or(first + 0.2);
                let before = first - (second - first).max(LEAST_INCREMENT);
                let (mut reached, mut raw) = (before, Vec::with_capacity(unwrapped.len()));
                for &target in unwrapped {
                    let increment = (target - reached).max(LEAST_INCREMENT);
                    raw.push(softplus_inverse(increment));
                    reached += increment;
                }
                Self { parameterization, initial: before, raw, anchors: Anchors::default() }
            }
        }
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        match self.parameterization {
            Parameterization::Cumulative => self.raw.len(),
            Parameterization::Direct => self.raw.len() / 2,
            Parameterization::Anchored => self.anchors.frame_seconds.len(),
        }
    }

    /// Whether there is no frame.
    pub fn is_empty(&self) -> bool {
        self.raw.is_empty()
    }

    /// θ(t), radians in [−π, π], one a frame (paper, equation 3).
    pub fn theta(&self) -> Vec<f64> {
        match self.parameterization {
            Parameterization::Cumulative => {
                let mut phi = self.initial;
                let step = |raw: &f64| {
                    // Wrapping as it goes keeps the sum small: its rounding never grows with the clip.
                    phi = wrap(phi + softplus(*raw));
                    phi
                };
                self.raw.iter().map(step).collect()
            }
            Parameterization::Direct => self.raw.as_chunks::<2>().0.iter().map(|[x, y]| y.atan2(*x)).collect(),
            Parameterization::Anchored => self.anchors.theta(&self.raw),
        }
    }

    /// θ at increasing times after the fitted frames. `Cumulative` goes on at its mean increment and `Direct` stays at its
    /// last point, whatever is known: they hold nothing but frames. `Anchored` takes what is known and forecasts the rest.
    pub fn continued(&self, frame_seconds: &[f64], later_seconds: &[f64], known: &Known<'_>) -> Continued {
        let (theta, count) = (self.theta(), frame_seconds.len());
        let last = theta.last().copied().unwrap_or(0.0);
        let end = frame_seconds.last().copied().unwrap_or(0.0);
        let untold = |theta: Vec<f64>| Continued { spread_radians: vec![f64::NAN; theta.len()], theta };
        match self.parameterization {
            Parameterization::Direct => untold(vec![last; later_seconds.len()]),
            Parameterization::Cumulative => {
                let gained: f64 = self.raw.iter().skip(1).map(|&raw| softplus(raw)).sum();
                let span = if count > 1 { end - frame_seconds[0] } else { 1.0 };
                untold(later_seconds.iter().map(|&t| wrap(last + gained / span * (t - end))).collect())
            }
            Parameterization::Anchored => {
                let (mut anchors, mut raw) = (self.anchors.clone(), self.raw.clone());
                match known {
                    Known::Nothing => 0,
                    Known::Beats(seconds) => anchors.extend_by_beats(&mut raw, seconds),
                    Known::Video { theta, confidence } => {
                        anchors.extend_by_video(&mut raw, later_seconds, theta, confidence)
                    }
                };
                anchors.continued(&raw, later_seconds)
            }
        }
    }

    /// Vector–Jacobian product: from ∂L/∂θ (one a frame) to the parameters.
    pub fn theta_vjp(&self, theta_gradient: &[f64]) -> PhaseGradient {
        match self.parameterization {
            Parameterization::Cumulative => {
                let mut raw = vec![0.0; self.raw.len()];
                let mut later = 0.0;
                for (k, gradient) in theta_gradient.iter().enumerate().rev() {
                    later += gradient;
                    raw[k] = later * sigmoid(self.raw[k]);
                }
                PhaseGradient { initial: later, raw }
            }
            Parameterization::Direct => {
                let points = self.raw.as_chunks::<2>().0.iter();
                let pull = |([x, y], gradient): (&[f64; 2], &f64)| {
                    let scale = gradient / (x * x + y * y).max(1e-12);
                    [-y * scale, x * scale]
                };
                PhaseGradient { initial: 0.0, raw: points.zip(theta_gradient).flat_map(pull).collect() }
            }
            Parameterization::Anchored => {
                PhaseGradient { initial: 0.0, raw: self.anchors.theta_vjp(&self.raw, theta_gradient) }
            }
        }
    }

    /// Returns the points of the direct form to the unit circle; the cumulative form needs nothing.
    pub fn project(&mut self) {
        if self.parameterization == Parameterization::Direct {
            for point in self.raw.as_chunks_mut::<2>().0 {
                let radius = point[0].hypot(point[1]);
                *point = if radius > 1e-9 { [point[0] / radius, point[1] / radius] } else { [1.0, 0.0] };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numeric::Random;
    use std::f64::consts::PI;

    const ALL: [Parameterization; 3] =
        [Parameterization::Cumulative, Parameterization::Direct, Parameterization::Anchored];

    fn check_gradient(phase: &Phase) {
        let mut random = Random::new(7);
        let weights: Vec<f64> = (0..phase.len()).map(|_| random.normal()).collect();
        let loss = |phase: &Phase| phase.theta().iter().zip(&weights).map(|(t, w)| w * t.sin()).sum::<f64>();
        let theta = phase.theta();
        let pulled: Vec<f64> = theta.iter().zip(&weights).map(|(t, w)| w * t.cos()).collect();
        let gradient = phase.theta_vjp(&pulled);
        let h = 1e-6;
        for k in 0..phase.raw.len() {
            let (mut up, mut down) = (phase.clone(), phase.clone());
            up.raw[k] += h;
            down.raw[k] -= h;
            let slope = (loss(&up) - loss(&down)) / (2.0 * h);
            assert!((slope - gradient.raw[k]).abs() < 1e-7 * slope.abs().max(1.0), "{k}: {slope} {}", gradient.raw[k]);
        }
        let (mut up, mut down) = (phase.clone(), phase.clone());
        up.initial += h;
        down.initial -= h;
        let slope = (loss(&up) - loss(&down)) / (2.0 * h);
        assert!((slope - gradient.initial).abs() < 1e-7 * slope.abs().max(1.0));
    }

    #[test]
    fn gradients_match_finite_differences() {
        let unwrapped: Vec<f64> = (0..40).map(|t| -PI + 0.21 * t as f64).collect();
        for parameterization in ALL {
            let mut phase = Phase::following(parameterization, &unwrapped);
            check_gradient(&phase);
            phase.raw.iter_mut().enumerate().for_each(|(k, raw)| *raw += 0.3 * (k as f64).sin());
            check_gradient(&phase);
        }
    }

    #[test]
    fn follows_what_it_is_given_across_the_cut() {
        let unwrapped: Vec<f64> = (0..500).map(|t| PI - 0.5 + 0.2 * t as f64).collect();
        for parameterization in ALL {
            let theta = Phase::following(parameterization, &unwrapped).theta();
            for (found, wanted) in theta.iter().zip(&unwrapped) {
                assert!(wrap(found - wanted).abs() < 1e-9 && found.abs() <= PI + 1e-12);
            }
        }
    }

    #[test]
    fn a_million_frames_do_not_drift() {
        let increment = 0.209_439_510_239_319_56;
        let phase = Phase {
            parameterization: Parameterization::Cumulative,
            initial: -increment,
            raw: vec![softplus_inverse(increment); 1_000_000],
            anchors: Anchors::default(),
        };
        let theta = phase.theta();
        let worst = (0..theta.len()).map(|t| wrap(theta[t] - increment * t as f64).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-8, "{worst}");
        let single: f32 = (0..1_000_000).fold(0.0f32, |sum, _| sum + increment as f32);
        let drift = (f64::from(single) - increment * 1e6).abs();
        println!("drift over 1e6 frames: f64 {worst:.1e} rad, f32 {drift:.1e} rad");
        assert!(drift > 1.0, "the f32 sum is expected to fail");
    }

    #[test]
    fn anchors_hold_a_million_frames_and_go_on_beyond_them() {
        let unwrapped: Vec<f64> = (0..1_000_000).map(|t| 0.209_439_510_239_319_56 * f64::from(t) - 1.0).collect();
        let times: Vec<f64> = (0..1_000_000).map(|t| f64::from(t) / 30.0).collect();
        let mut phase = Phase::following_at(Parameterization::Anchored, &times[..990_000], &unwrapped[..990_000]);
        // One anchor pulled away as far as it goes moves its two beats and nothing else.
        phase.raw[5] = 40.0;
        let theta = phase.theta();
        let off = |t: usize| wrap(theta[t] - unwrapped[t]).abs();
        assert!((0..990_000).filter(|&t| off(t) > 1e-8).count() <= 60);
        assert!((0..990_000).all(|t| off(t) <= PI / 4.0 + 1e-9));
        let later = phase.continued(&times[..990_000], &times[990_000..], &Known::Nothing).theta;
        let worst = (0..10_000).map(|k| wrap(later[k] - unwrapped[990_000 + k]).abs()).fold(0.0, f64::max);
        println!("5.6 min beyond a steady rate: {worst:.1e} rad");
        assert!(worst < 1e-6);
    }

    #[test]
    fn a_phase_that_stands_still_or_has_one_frame_is_defined() {
        for unwrapped in [vec![0.3], vec![0.3; 5], vec![0.3, 0.2, 0.1]] {
            for parameterization in ALL {
                let phase = Phase::following(parameterization, &unwrapped);
                assert_eq!(phase.theta().len(), unwrapped.len());
                assert!(phase.theta().iter().all(|theta| theta.is_finite()));
                assert!(phase.theta_vjp(&vec![1.0; unwrapped.len()]).raw.iter().all(|g| g.is_finite()));
            }
        }
    }
}
