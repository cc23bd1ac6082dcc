//! How strongly and when a pulse arrives in each of many traces, read against their mean: the perfusion of a face as its
//! own albedo shows it, whoever wrote it.

use rustfft::num_complex::Complex64;

use crate::error::{Result, SignalError};
use crate::filter::{Band, bandpass};
use crate::hilbert::analytic_signal;

/// Half-width of the band around the heart rate in which arrival is compared, hertz: holds its variability.
const HALF_BAND_HERTZ: f64 = 0.35;

/// Strength and delay of one trace relative to the mean of all.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrival {
    /// Amplitude over the mean's.
    pub strength: f64,
    /// Seconds after the mean; negative is earlier. Within half a beat.
    pub delay_seconds: f64,
}

/// Compares `count` traces, interleaved frame by frame (`T×count`), with their mean at its heart rate: the correlation with
/// the mean's analytic signal gives amplitude and phase at once, also while the rate varies.
///
/// # Errors
/// When the table is not `T×count`, too short to filter, or its mean carries nothing at that rate.
pub fn arrivals(table: &[f32], count: usize, rate_hertz: f64, bpm: f64) -> Result<Vec<Arrival>> {
    if count == 0 || table.is_empty() || !table.len().is_multiple_of(count) {
        return Err(SignalError::Length { what: "the table of traces", expected: count, found: table.len() });
    }
    let centre = bpm / 60.0;
    let band = Band { low_hertz: (centre - HALF_BAND_HERTZ).max(0.5 * centre), high_hertz: centre + HALF_BAND_HERTZ };
    let mean = |frame: &[f32]| frame.iter().map(|&v| f64::from(v)).sum::<f64>() / count as f64;
    let means: Vec<f64> = table.chunks_exact(count).map(mean).collect();
    let guide = analytic_signal(&bandpass(&means, rate_hertz, band, 1)?)?;
    let mut sums = vec![Complex64::default(); count];
    let mut whole = Complex64::default();
    for ((frame, guide), mean) in table.chunks_exact(count).zip(&guide).zip(&means) {
        let back = guide.conj();
        sums.iter_mut().zip(frame).for_each(|(sum, value)| *sum += back * f64::from(*value));
        whole += back * *mean;
    }
    if whole.norm() <= 1e-12 * means.iter().map(|v| v.abs()).fold(0.0, f64::max) * means.len() as f64 {
        return Err(SignalError::Flat("the mean of the traces at the heart rate"));
    }
    let relative = |sum: &Complex64| {
        let ratio = sum / whole;
        Arrival { strength: ratio.norm(), delay_seconds: -ratio.arg() / (std::f64::consts::TAU * centre) }
    };
    Ok(sums.iter().map(relative).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strengths_and_delays_are_read_back_from_a_varying_pulse() -> Result<()> {
        let given = [(1.5, -0.02), (1.0, 0.0), (0.5, 0.03), (1.0, 0.01)];
        let phase = |time: f64| std::f64::consts::TAU * 1.2 * time + 1.5 * (0.6 * time).sin();
        let table: Vec<f32> = (0..900)
            .flat_map(|k| {
                given.map(|(strength, delay)| {
                    let angle = phase(f64::from(k) / 30.0 - delay);
                    (strength * (angle.cos() + 0.4 * (2.0 * angle).cos())) as f32
                })
            })
            .collect();
        let found = arrivals(&table, 4, 30.0, 72.0)?;
        let mean_delay = given.iter().map(|(s, d)| s * d).sum::<f64>() / 4.0;
        for (found, (strength, delay)) in found.iter().zip(given) {
            assert!((found.strength - strength).abs() < 0.02, "{found:?}");
            assert!((found.delay_seconds - (delay - mean_delay)).abs() < 2e-3, "{found:?} {delay}");
        }
        assert!(arrivals(&table, 7, 30.0, 72.0).is_err() && arrivals(&[], 0, 30.0, 72.0).is_err());
        assert!(matches!(arrivals(&[0.0; 600], 2, 30.0, 72.0), Err(SignalError::Flat(_))));
        Ok(())
    }
}
