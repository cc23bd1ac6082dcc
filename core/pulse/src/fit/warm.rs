//! The waveform before the first step: two Gaussians fitted to the average beat, from several starts.
//!
//! The fit of two Gaussians has local minima (a recording whose peaks sit on a broad base, a late or an early shoulder),
//! and the paper's small rates do not leave them. On the average beat, 64 numbers, trying several starts costs
//! milliseconds at any length of clip.

use std::f64::consts::{PI, TAU};

use crate::adam::Adam;
use crate::losses::{normalise, normalise_vjp};
use crate::numeric::wrap;
use crate::reference::Reference;
use crate::waveform::{PenaltyWeights, Waveform};

/// Phases of the average beat.
const BINS: usize = 64;
/// Steps from each start, and their rate, which falls to a twentieth.
const STEPS: usize = 500;
const RATE: f64 = 3e-2;

/// Amplitudes, centres and widths to start from.
const STARTS: [[[f64; 2]; 3]; 6] = [
    [[0.9, 0.4], [0.0, 1.6], [0.6, 1.0]],
    [[0.9, 0.6], [0.0, 2.6], [0.6, 1.8]],
    [[0.9, 0.8], [-0.3, 0.5], [0.4, 1.4]],
    [[0.9, 0.5], [-1.0, 0.3], [0.6, 0.8]],
    [[0.9, 0.6], [-2.4, 0.0], [0.6, 1.2]],
    [[0.9, 0.8], [-0.2, 1.0], [1.0, 1.2]],
];

/// The best waveform for the reference at its own phase; `values` is the detrended, normalised reference.
pub(super) fn warm_waveform(reference: &Reference, values: &[f64], penalties: &PenaltyWeights) -> Waveform {
    let template = normalise(&average_beat(reference, values)).values;
    let fits = STARTS
        .iter()
        .map(|[amplitude, center, width]| descend(Waveform::new(*amplitude, *center, *width), &template, penalties));
    let best = fits.fold((f64::INFINITY, Waveform::default()), |best, fit| if fit.0 < best.0 { fit } else { best });
    best.1
}

/// Mean value at each phase, weighted by confidence; empty bins take the mean of their filled neighbours' line.
fn average_beat(reference: &Reference, values: &[f64]) -> Vec<f64> {
    let (mut sums, mut weights) = (vec![0.0; BINS], vec![0.0; BINS]);
    for ((phase, value), confidence) in reference.phase.iter().zip(values).zip(&reference.confidence) {
        // Each frame is shared between the two nearest bins.
        let at = (wrap(*phase) + PI) / TAU * BINS as f64;
        let (below, rest) = (at.floor(), at - at.floor());
        for (bin, share) in [(below as usize % BINS, 1.0 - rest), ((below as usize + 1) % BINS, rest)] {
            sums[bin] += confidence * share * value;
            weights[bin] += confidence * share;
        }
    }
    let filled: Vec<usize> = (0..BINS).filter(|&bin| weights[bin] > 1e-9).collect();
    let mean = |bin: usize| sums[bin] / weights[bin];
    let fill = |bin: usize| {
        let after = filled.iter().copied().find(|&k| k >= bin).or(filled.first().map(|k| k + BINS));
        let before = filled.iter().copied().rev().find(|&k| k <= bin).map(|k| k as f64);
        match (before.or(filled.last().map(|&k| k as f64 - BINS as f64)), after) {
            (Some(before), Some(after)) if after as f64 > before => {
                let rest = (bin as f64 - before) / (after as f64 - before);
                let left = mean(before.rem_euclid(BINS as f64) as usize);
                left + rest * (mean(after % BINS) - left)
            }
            _ => mean(bin),
        }
    };
    if filled.is_empty() { vec![0.0; BINS] } else { (0..BINS).map(fill).collect() }
}

/// The loss and the waveform it was reached with.
fn descend(start: Waveform, template: &[f64], penalties: &PenaltyWeights) -> (f64, Waveform) {
    let theta: Vec<f64> = (0..BINS).map(|bin| TAU * bin as f64 / BINS as f64 - PI).collect();
    let (mut parameters, mut adam) = (start.to_array(), Adam::new(6));
    let (mut best, mut scratch) = ((f64::INFINITY, start), vec![0.0; BINS]);
    for step in 0..STEPS {
        let waveform = Waveform::from_array(parameters);
        let (values, waves) = waveform.evaluate_kept(&theta);
        let shape = normalise(&values);
        let errors = shape.values.iter().zip(template).map(|(shape, template)| shape - template);
        let pulled: Vec<f64> = errors.map(|error| 2.0 * error / BINS as f64).collect();
        let mse = pulled.iter().map(|g| (0.5 * g * BINS as f64).powi(2)).sum::<f64>() / BINS as f64;
        let mut gradient = waveform.evaluate_vjp(&waves, &normalise_vjp(&shape, &pulled), &mut scratch);
        let total = mse + waveform.penalty(penalties, &mut gradient);
        if total < best.0 {
            best = (total, waveform);
        }
        let rate = RATE * 0.05f64.powf(step as f64 / STEPS as f64);
        adam.step(&mut parameters, &gradient.to_array(), |_| rate);
    }
    best
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::reference::Prescription;

    #[test]
    fn waveforms_of_several_kinds_are_found_again() {
        let times: Vec<f64> = (0..600).map(|t| f64::from(t) / 30.0).collect();
        for truth in [
            Waveform::default(),
            Waveform::new([0.9, 0.5], [-1.0, 0.3], [0.5, 0.7]),
            Waveform::new([0.8, 0.6], [0.1, 2.5], [0.5, 1.7]),
        ] {
            let prescription = Prescription { heart_rate_bpm: 71.0, waveform: truth, ..Prescription::default() };
            let reference = prescription.reference(&times).unwrap();
            let values = normalise(&reference.waveform).values;
            let found = warm_waveform(&reference, &values, &PenaltyWeights::default());
            let theta: Vec<f64> = reference.phase.iter().map(|&phase| wrap(phase)).collect();
            let shape = normalise(&found.evaluate(&theta)).values;
            let correlation = shape.iter().zip(&values).map(|(a, b)| a * b).sum::<f64>() / values.len() as f64;
            assert!(correlation > 0.995, "{correlation} {found:?}");
        }
    }

    #[test]
    fn sparse_phases_are_filled() {
        let times: Vec<f64> = (0..40).map(|t| f64::from(t) / 7.0).collect();
        let reference = Prescription { heart_rate_bpm: 60.0, ..Prescription::default() }.reference(&times).unwrap();
        let beat = average_beat(&reference, &reference.waveform);
        assert!(beat.iter().all(|value| value.is_finite()) && beat.iter().any(|value| *value > 0.5));
    }
}
