//! Paired differences with their bootstrap interval: what an ablation changes, and how sure that is.

/// Resamples drawn.
const RESAMPLES: usize = 2000;

/// A mean over pairs and the 95 % percentile interval of its bootstrap (seeded: equal differences, equal interval).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Paired {
    /// Mean.
    pub mean: f64,
    /// 2.5 % of the resampled means lie below.
    pub low: f64,
    /// 2.5 % lie above.
    pub high: f64,
    /// Pairs.
    pub count: usize,
}

impl Paired {
    /// Of differences, one a pair; those that are not finite are left out. `None` without any.
    pub fn of(differences: &[f64]) -> Option<Self> {
        let values: Vec<f64> = differences.iter().copied().filter(|value| value.is_finite()).collect();
        let count = values.len();
        if count == 0 {
            return None;
        }
        let mean = values.iter().sum::<f64>() / count as f64;
        let mut state = 0x9E37_79B9_7F4A_7C15u64;
        let mut below = || {
            // An xorshift is even enough to pick a few out of at most thousands.
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state % count as u64) as usize
        };
        let mut means: Vec<f64> =
            (0..RESAMPLES).map(|_| (0..count).map(|_| values[below()]).sum::<f64>() / count as f64).collect();
        means.sort_by(f64::total_cmp);
        let at = |share: f64| means[(share * (RESAMPLES - 1) as f64).round() as usize];
        Some(Self { mean, low: at(0.025), high: at(0.975), count })
    }

    /// `+0.0123 [+0.0045, +0.0210]`, `decimals` of them.
    pub fn show(&self, decimals: usize) -> String {
        format!("{:+.decimals$} [{:+.decimals$}, {:+.decimals$}]", self.mean, self.low, self.high)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interval_holds_the_mean_and_narrows_with_more_pairs() {
        let values = |count: u32| (0..count).map(|k| 1.0 + f64::from(k * 37 % 11) / 10.0).collect::<Vec<_>>();
        let (few, many) = (Paired::of(&values(11)), Paired::of(&values(440)));
        let (Some(few), Some(many)) = (few, many) else { panic!("there are pairs") };
        assert!((few.mean - 1.5).abs() < 1e-9 && few.low < 1.5 && few.high > 1.5, "{few:?}");
        assert!(many.high - many.low < 0.3 * (few.high - few.low), "{many:?}");
        assert_eq!(Paired::of(&[f64::NAN]), None);
        let one = Paired::of(&[2.0, f64::INFINITY]).map(|one| (one.mean, one.low, one.high, one.count));
        assert_eq!(one, Some((2.0, 2.0, 2.0, 1)));
    }
}
