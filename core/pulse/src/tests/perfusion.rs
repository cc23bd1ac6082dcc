//! Perfusion maps: what the skin's map asks for is in the modulation and in the picture that it makes, region by region.
#![expect(clippy::unwrap_used, reason = "tests")]

use heartian_signal::regional::arrivals;
use heartian_space::{AlbedoOperator, Perfusion};

use super::*;
use crate::{Prescription, ResidualOptions, fit_residual, mean_offsets, modulation_from_fundamental};

/// Upper half half again as strong as the mean and late by 30 ms against the lower.
fn mapped(count: usize) -> Skin {
    let mut skin = skin(count);
    let upper: Vec<f32> = skin.positions.iter().map(|p| f32::from(p[1] > 0.0)).collect();
    let share = upper.iter().sum::<f32>() / count as f32;
    let mean = 1.5 * share + 0.5 * (1.0 - share);
    skin.perfusion = Perfusion {
        strength: upper.iter().map(|u| (0.5 + u) / mean).collect(),
        delay_seconds: upper.iter().map(|u| 0.03 * (u - share)).collect(),
    };
    skin
}

/// Mean of the upper and of the lower half, frame by frame, through a picture of one cell each.
fn regions(skin: &Skin, modulation: &heartian_space::Modulation) -> Vec<f32> {
    let halves: [Vec<u32>; 2] = [true, false].map(|upper| {
        (0..skin.gaussians.len()).filter(|&k| (skin.positions[k][1] > 0.0) == upper).map(|k| k as u32).collect()
    });
    let frames = modulation.times_seconds.len();
    let mut operator = AlbedoOperator {
        column_count: skin.gaussians.len(),
        frames: (0..frames as u32).collect(),
        row_offsets: (0..=frames as u32).map(|f| 2 * f).collect(),
        entry_offsets: vec![0],
        ..AlbedoOperator::default()
    };
    for _ in 0..frames {
        for half in &halves {
            operator.columns.extend(half);
            operator.weights.extend(half.iter().map(|_| 0.8 / half.len() as f32));
            operator.entry_offsets.push(operator.columns.len() as u32);
            operator.base.push(0.2);
        }
    }
    let green = |frame: usize, row: usize| {
        let offsets = modulation.frame(frame);
        operator.base[row] + operator.row(row).map(|(column, weight)| weight * offsets[column]).sum::<f32>()
    };
    let value = |row: usize| green(row / 2, row) - 0.2;
    (0..2 * frames).map(value).collect()
}

#[test]
fn strength_and_delay_are_read_back_per_gaussian_and_per_region() {
    let prescription = Prescription { sdnn_seconds: 0.03, ..Prescription::default() };
    let reference = prescription.reference(&times(30.0, 30.0)).unwrap();
    let (pulse, _) = fit(&reference, &PhaseOptions { steps: 200, ..PhaseOptions::default() }).unwrap();
    let skin = mapped(300);
    let (modulation, limited) = modulation_from_fundamental(&pulse, &skin).unwrap();
    assert_eq!(limited.offsets, 0);
    let found = arrivals(&modulation.offsets, 300, 30.0, 72.0).unwrap();
    let mean_delay = found.iter().map(|a| a.delay_seconds).sum::<f64>() / 300.0;
    let (mut worst_strength, mut worst_delay) = (0.0f64, 0.0f64);
    for (k, found) in found.iter().enumerate() {
        let (strength, delay) = (f64::from(skin.perfusion.strength[k]), f64::from(skin.perfusion.delay_seconds[k]));
        worst_strength = worst_strength.max((found.strength / strength - 1.0).abs());
        worst_delay = worst_delay.max((found.delay_seconds - mean_delay - delay).abs());
    }
    println!("per Gaussian: strength to {:.2} %, delay to {:.2} ms", 100.0 * worst_strength, 1e3 * worst_delay);
    assert!(worst_strength < 0.03 && worst_delay < 1e-3);
    let residual = ResidualOptions { steps: 40, width: 32, ..ResidualOptions::default() };
    let (_, full) = fit_residual(&pulse, &skin, None, &residual, &mut onwards).unwrap();
    for (name, modulation, allowed) in [("fundamental", &modulation, 0.02), ("with residual", &full, 0.15)] {
        let found = arrivals(&regions(&skin, modulation), 2, 30.0, 72.0).unwrap();
        let (ratio, late) = (found[0].strength / found[1].strength, found[0].delay_seconds - found[1].delay_seconds);
        println!("{name}, picture: upper over lower {ratio:.3} of 3, later by {:.1} of 30 ms", 1e3 * late);
        assert!((ratio / 3.0 - 1.0).abs() < allowed && (late - 0.03).abs() < 0.005, "{name}: {ratio} {late}");
    }
}

#[test]
fn a_map_leaves_the_mean_signal_its_strength_and_rate() {
    let reference =
        Prescription { heart_rate_bpm: 84.0, ..Prescription::default() }.reference(&times(20.0, 30.0)).unwrap();
    let (pulse, _) = fit(&reference, &PhaseOptions { steps: 200, ..PhaseOptions::default() }).unwrap();
    let deviation = |values: &[f64]| {
        let centre = crate::numeric::mean(values);
        values.iter().map(|v| (v - centre).powi(2)).sum::<f64>().sqrt()
    };
    let even = mean_offsets(&modulation_from_fundamental(&pulse, &skin(300)).unwrap().0);
    let map = mean_offsets(&modulation_from_fundamental(&pulse, &mapped(300)).unwrap().0);
    println!("mean signal under a map: {:.4} of the even one's strength", deviation(&map) / deviation(&even));
    assert!((deviation(&map) / deviation(&even) - 1.0).abs() < 0.03);
    assert!((read_bpm(&map, 30.0) - 84.0).abs() < 0.1);
}
