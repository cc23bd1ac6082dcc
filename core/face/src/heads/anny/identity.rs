//! From the package's morph targets to a basis of heads whose coefficients are independent and of unit variance.
//!
//! Targets come as opposites (`…-decr`, `…-incr`) and for two sides. A slider's direction is half the difference of its
//! opposites, both sides together and (rarer) one against the other; its standard deviation is a guess at how people
//! vary along it. The principal directions of that distribution, under a metric that counts the face most, are the modes.

use std::collections::BTreeMap;

use crate::eigen::{Eigen, symmetric_eigen};

/// Displacements of some vertices of the base mesh, decimetres.
pub type Shifts = BTreeMap<u32, [f64; 3]>;

/// Standard deviation of a slider with two ends, of a target without an opposite, and of one side against the other, in
/// units of the targets. A guess, set by eye on random heads (at 0.40 they were caricatures): no population of measured
/// faces is behind it, so a coefficient of 1 is one standard deviation of this guess, no more.
const SLIDER: f64 = 0.20;
const SINGLE: f64 = 0.12;
const LOPSIDED: f64 = 0.05;
/// Most modes kept, and the share of the variance they need to hold.
const MOST_MODES: usize = 48;
const SHARE: f64 = 0.995;
/// Words that say which end of a slider a target is: the negative, then the positive one.
const ENDS: [[&str; 2]; 7] = [
    ["decr", "incr"],
    ["down", "up"],
    ["in", "out"],
    ["backward", "forward"],
    ["concave", "convex"],
    ["compress", "uncompress"],
    ["triangle", "round"],
];

/// A sum of scaled displacements.
pub fn blend<'a>(parts: impl IntoIterator<Item = (f64, &'a Shifts)>) -> Shifts {
    let mut sum = Shifts::new();
    for (scale, shifts) in parts {
        for (vertex, shift) in shifts {
            let entry = sum.entry(*vertex).or_insert([0.0; 3]);
            (0..3).for_each(|axis| entry[axis] += scale * shift[axis]);
        }
    }
    sum
}

/// Directions of one standard deviation each, from targets by name (without folder and extension).
pub fn directions(targets: &BTreeMap<String, Shifts>) -> Vec<Shifts> {
    // Sliders: opposites joined, and a lone target with its own deviation.
    let mut sliders: BTreeMap<String, Shifts> = BTreeMap::new();
    for (name, shifts) in targets {
        let (stem, word) = name.rsplit_once('-').unwrap_or(("", name));
        let ends = ENDS.iter().find(|ends| ends.contains(&word));
        let other = ends.and_then(|ends| {
            let opposite = if ends[0] == word { ends[1] } else { ends[0] };
            Some((targets.get(&format!("{stem}-{opposite}"))?, ends[1] == word))
        });
        match other {
            Some((other, true)) => {
                sliders.insert(format!("{stem}-{word}"), blend([(0.5 * SLIDER, shifts), (-0.5 * SLIDER, other)]));
            }
            Some((_, false)) => {}
            None => {
                sliders.insert(name.clone(), blend([(SINGLE, shifts)]));
            }
        }
    }
    let mut found = Vec::new();
    for (name, left) in &sliders {
        match name.strip_prefix("l-").and_then(|rest| sliders.get(&format!("r-{rest}"))) {
            Some(right) => {
                found.push(blend([(1.0, left), (1.0, right)]));
                let lopsided = LOPSIDED / SLIDER;
                found.push(blend([(lopsided, left), (-lopsided, right)]));
            }
            None if name.starts_with("r-") && sliders.contains_key(&format!("l-{}", &name[2..])) => {}
            None => found.push(left.clone()),
        }
    }
    found
}

/// Principal modes of independent directions (rows of equal length, one standard deviation each) under a metric given by
/// a weight per value: each mode carries its own standard deviation.
pub fn principal(directions: &[Vec<f64>], metric: &[f64]) -> Vec<Vec<f64>> {
    let n = directions.len();
    let mut gram = vec![0.0; n * n];
    for i in 0..n {
        for j in i..n {
            let product: f64 =
                directions[i].iter().zip(&directions[j]).zip(metric).map(|((a, b), weight)| a * b * weight).sum();
            (gram[i * n + j], gram[j * n + i]) = (product, product);
        }
    }
    let Eigen { values, vectors } = symmetric_eigen(n, &gram);
    let whole: f64 = values.iter().sum();
    let mut held = 0.0;
    let mut modes = Vec::new();
    for (value, vector) in values.iter().zip(&vectors).take(MOST_MODES) {
        if !(*value > 1e-9 * whole) || held > SHARE * whole {
            break;
        }
        held += value;
        let mut mode = vec![0.0; metric.len()];
        for (weight, direction) in vector.iter().zip(directions) {
            mode.iter_mut().zip(direction).for_each(|(sum, value)| *sum += weight * value);
        }
        // The sign is free: let the largest value be positive.
        let largest = mode.iter().copied().fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
        mode.iter_mut().for_each(|value| *value *= largest.signum());
        modes.push(mode);
    }
    modes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modes_are_orthogonal_and_carry_the_variance() {
        let directions: Vec<Vec<f64>> =
            (0..6).map(|i| (0..30).map(|k| ((i * 7 + k * 3) as f64).sin() * (i + 1) as f64).collect()).collect();
        let metric: Vec<f64> = (0..30).map(|k| 0.5 + f64::from(k % 3)).collect();
        let modes = principal(&directions, &metric);
        let product = |a: &[f64], b: &[f64]| a.iter().zip(b).zip(&metric).map(|((a, b), w)| a * b * w).sum::<f64>();
        for (i, a) in modes.iter().enumerate() {
            for b in &modes[..i] {
                assert!(product(a, b).abs() < 1e-9 * product(a, a).max(product(b, b)));
            }
        }
        let want: f64 = directions.iter().map(|d| product(d, d)).sum();
        let got: f64 = modes.iter().map(|m| product(m, m)).sum();
        assert!(got > 0.994 * want && got < want * (1.0 + 1e-9), "{got} of {want}");
        assert!(modes.windows(2).all(|pair| product(&pair[0], &pair[0]) >= product(&pair[1], &pair[1])));
    }

    #[test]
    fn opposites_and_sides_become_sliders() {
        let shift = |x: f64| Shifts::from([(0, [x, 0.0, 0.0])]);
        let targets = BTreeMap::from(
            [
                ("head-oval", 1.0),
                ("nose-width-decr", -1.0),
                ("nose-width-incr", 3.0),
                ("l-ear-up", 1.0),
                ("l-ear-down", -1.0),
                ("r-ear-up", 2.0),
                ("r-ear-down", -2.0),
            ]
            .map(|(name, x)| (name.to_owned(), shift(x))),
        );
        let mut sizes: Vec<f64> = directions(&targets).iter().map(|d| d[&0][0]).collect();
        sizes.sort_by(f64::total_cmp);
        let want = [-LOPSIDED, SINGLE, 2.0 * SLIDER, 3.0 * SLIDER];
        assert!(sizes.iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-12), "{sizes:?}");
    }
}
