//! No visible flash: offsets are bounded in 8-bit levels, smoothly.
//!
//! Up to seven tenths of the bound nothing changes; beyond, the rest is folded in by a hyperbolic tangent, so that value
//! and slope stay continuous. Cutting off instead would put corners into the waveform, whose harmonics a band-pass then
//! rings on. Where the bound acted is counted, frame by frame.

/// Share of the bound below which nothing changes.
pub const KNEE: f64 = 0.7;

/// A bound on magnitudes, in linear albedo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Limit {
    knee: f32,
    rest: f32,
}

/// Where a bound acted.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Limited {
    /// Offsets changed, over all frames and Gaussians.
    pub offsets: u64,
    /// Frames with a changed offset.
    pub frames: u64,
    /// First such frame.
    pub first_frame: Option<u64>,
    /// Last such frame.
    pub last_frame: Option<u64>,
}

impl Limit {
    pub fn new(most: f64) -> Self {
        Self { knee: (KNEE * most) as f32, rest: ((1.0 - KNEE) * most) as f32 }
    }

    /// The bounded value, and whether it was changed.
    #[inline]
    pub fn apply(self, value: f32) -> (f32, bool) {
        let over = value.abs() - self.knee;
        if over <= 0.0 {
            return (value, false);
        }
        // A bound of zero leaves nothing.
        let folded = if self.rest > 0.0 { self.rest * (over / self.rest).tanh() } else { 0.0 };
        ((self.knee + folded).copysign(value), true)
    }
}

impl Limited {
    /// From the number of changed offsets in each frame.
    pub(crate) fn from_counts(counts: &[u64]) -> Self {
        let acted = |count: &u64| *count > 0;
        Self {
            offsets: counts.iter().sum(),
            frames: counts.iter().filter(|count| acted(count)).count() as u64,
            first_frame: counts.iter().position(acted).map(|frame| frame as u64),
            last_frame: counts.iter().rposition(acted).map(|frame| frame as u64),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bound_holds_and_bends_without_a_corner() {
        let limit = Limit::new(0.01);
        let at = |x: f32| limit.apply(x).0;
        let (mut before, mut slope) = (at(-0.05), 0.0f32);
        for k in 1..=10_000 {
            let value = at(-0.05 + 1e-5 * k as f32);
            let now = (value - before) / 1e-5;
            assert!(value.abs() <= 0.01 && (-1e-3..=1.002).contains(&now), "{k}: {value} {now}");
            assert!(k == 1 || (now - slope).abs() < 0.02, "a corner at {k}: {slope} {now}");
            (before, slope) = (value, now);
        }
        assert_eq!(limit.apply(0.007 - 1e-6), (0.007 - 1e-6, false));
        assert!(limit.apply(f32::MAX).0 <= 0.01 && limit.apply(0.008).1);
        assert_eq!(Limit::new(0.0).apply(0.3).0, 0.0);
    }

    #[test]
    fn a_spike_is_folded_with_less_ringing_than_a_cut() {
        use heartian_signal::{Band, bandpass};
        let swell = |t: f64| 1.0 + 2.0 * (-((t - 300.0) / 20.0).powi(2)).exp();
        let wave: Vec<f64> = (0..600).map(|t| (f64::from(t) * 0.25).sin() * swell(f64::from(t))).collect();
        let limit = Limit::new(2.0);
        let soft: Vec<f64> = wave.iter().map(|&v| f64::from(limit.apply(v as f32).0)).collect();
        let hard: Vec<f64> = wave.iter().map(|&v| v.clamp(-2.0, 2.0)).collect();
        // What the limited signal holds above the harmonics of the pulse.
        let high = Band { low_hertz: 8.0, high_hertz: 14.5 };
        let power = |v: &[f64]| bandpass(v, 30.0, high, 2).map_or(f64::NAN, |v| v.iter().map(|v| v * v).sum::<f64>());
        println!("power above 8 Hz: folded {:.4}, cut {:.4}", power(&soft), power(&hard));
        assert!(power(&soft) < 0.8 * power(&hard));
    }

    #[test]
    fn where_it_acted_is_told() {
        let told = Limited::from_counts(&[0, 0, 3, 0, 1, 0]);
        assert_eq!(told, Limited { offsets: 4, frames: 2, first_frame: Some(2), last_frame: Some(4) });
        assert_eq!(Limited::from_counts(&[0; 4]), Limited::default());
    }
}
