//! Local maxima of a sampled signal, as SciPy's `find_peaks` with no condition finds them.

/// Indices of all strict local maxima; of a flat top the middle sample (rounded down); the end samples never count.
pub fn local_maxima(signal: &[f64]) -> Vec<usize> {
    let mut peaks = Vec::new();
    let mut index = 1;
    while index + 1 < signal.len() {
        if signal[index - 1] < signal[index] {
            let mut after = index + 1;
            while after + 1 < signal.len() && signal[after] == signal[index] {
                after += 1;
            }
            if signal[after] < signal[index] {
                peaks.push((index + after - 1) / 2);
                index = after;
            }
        }
        index += 1;
    }
    peaks
}

/// Position of the vertex of the parabola through a sample and its neighbours, in samples; the index itself at the ends
/// or where the three do not form a maximum.
pub(crate) fn refined(signal: &[f64], index: usize) -> f64 {
    if index == 0 || index + 1 >= signal.len() {
        return index as f64;
    }
    let (left, centre, right) = (signal[index - 1], signal[index], signal[index + 1]);
    let curvature = left - 2.0 * centre + right;
    if curvature < 0.0 { index as f64 + (0.5 * (left - right) / curvature).clamp(-0.5, 0.5) } else { index as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plateaus_give_their_middle_and_ends_nothing() {
        assert_eq!(local_maxima(&[0.0, 1.0, 0.0, 2.0, 2.0, 2.0, 2.0, 1.0, 3.0]), [1, 4]);
        assert!(local_maxima(&[0.0, 1.0, 1.0]).is_empty());
        assert!(local_maxima(&[1.0, 1.0, 0.0]).is_empty());
        assert_eq!(local_maxima(&[0.0, 1.0, 1.0, 2.0, 0.0]), [3]);
        assert!(local_maxima(&[]).is_empty());
        assert_eq!(refined(&[0.0, 1.0, 0.5], 1), 1.0 + 0.5 * 0.5 / 1.5);
    }
}
