//! Calibration of the confidence of a heart rate, on simulated mean colours: pulse, light, motion, speculars and noise of
//! widely varied strength, lengths of 8 to 120 s, four frame rates, and one recording in seven without any pulse.
//!
//! `cargo test --release -p heartian-signal --test certainty -- --ignored --nocapture` fits the weights again and prints
//! them; the ordinary test checks the weights in use on recordings of other seeds.

use heartian_signal::certainty::{Evidence, evidence, window_rates};
use heartian_signal::{Method, Preset};

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// SplitMix64: numbers in [0, 1).
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) as f64 / 18_446_744_073_709_551_616.0
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Evenly in the logarithm.
    fn decades(&mut self, low: f64, high: f64) -> f64 {
        10f64.powf(self.between(low, high))
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * self.unit().max(1e-300).ln()).sqrt() * (std::f64::consts::TAU * self.unit()).cos()
    }

    /// A wandering sine of about one, or a random walk through a leaky integrator; all along, or in bursts of some seconds
    /// that are the stronger the rarer.
    fn disturbance(&mut self, hertz: f64, rate: f64, count: usize) -> Vec<f64> {
        let (mut phase, mut walk) = (self.between(0.0, 6.3), 0.0);
        let (periodic, wander) = (self.unit() < 0.6, self.between(0.02, 0.4));
        let share = if self.unit() < 0.5 { 1.0 } else { self.between(0.05, 0.5) };
        let mut active = self.unit() < share;
        (0..count)
            .map(|_| {
                phase += std::f64::consts::TAU * hertz / rate * (1.0 + wander * self.normal());
                walk = walk * (1.0 - hertz / rate) + self.normal() * (2.0 * hertz / rate).sqrt();
                if self.unit() < 1.0 / (4.0 * rate) {
                    active = self.unit() < share;
                }
                let height = if active { share.sqrt().recip() } else { 0.0 };
                height * if periodic { phase.sin() } else { walk }
            })
            .collect()
    }
}

/// Mean colours, frame rate, and the mean heart rate that is in them.
fn recording(random: &mut Random) -> (Vec<[f64; 3]>, f64, f64) {
    let rate = [15.0, 24.0, 30.0, 60.0][(4.0 * random.unit()) as usize];
    let count = (random.decades(0.903, 2.08) * rate) as usize;
    let base = random.between(50.0, 140.0);
    let strength = if random.unit() < 1.0 / 7.0 { 0.0 } else { random.decades(-3.8, -2.0) };
    let (variability, breath) = (random.between(0.01, 0.06), random.between(0.15, 0.35));
    let (mut phase, mut cycles, mut drift) = (random.unit(), 0.0, 0.0);
    let tone = random.between(0.3, 1.0);
    let skin = [180.0, 120.0, 95.0].map(|value| tone * value * random.between(0.9, 1.1));
    let light = random.disturbance(random_hertz(0.05, 0.6, random.0), rate, count);
    let motion = random.disturbance(random_hertz(0.3, 3.0, random.0 ^ 7), rate, count);
    let gloss = random.disturbance(random_hertz(0.3, 3.0, random.0 ^ 99), rate, count);
    let amounts = [random.decades(-3.0, -1.3), random.decades(-3.7, -1.7), random.decades(-4.3, -2.5)];
    let noise = random.decades(-4.3, -2.6);
    let colors = (0..count)
        .map(|k| {
            let time = k as f64 / rate;
            drift = 0.995 * drift + 0.1 * variability * random.normal() / rate.sqrt();
            let hertz = base / 60.0 * (1.0 + drift + variability * (std::f64::consts::TAU * breath * time).sin());
            phase += hertz / rate;
            cycles += hertz / rate;
            let turn = std::f64::consts::TAU * phase;
            let beat = strength * (turn.cos() + 0.35 * (2.0 * turn + 1.0).cos());
            let shade = 1.0 + amounts[0] * light[k] + amounts[1] * motion[k];
            std::array::from_fn(|c| {
                let pulse = 1.0 + [0.35, 1.0, 0.55][c] * beat;
                skin[c] * shade * pulse + tone * 255.0 * amounts[2] * gloss[k] + skin[c] * noise * random.normal()
            })
        })
        .collect();
    (colors, rate, 60.0 * cycles * rate / count as f64)
}

fn random_hertz(low: f64, high: f64, seed: u64) -> f64 {
    Random(seed.wrapping_mul(31)).between(low, high)
}

/// The evidence for POS's rate, and whether that is within 5 bpm of the truth.
fn case(seed: u64) -> Outcome<(Evidence, bool)> {
    let mut random = Random(seed.wrapping_mul(0x2545_f491_4f6c_dd1d));
    let (colors, rate, truth) = recording(&mut random);
    let protocol = Preset::ToolboxFine.protocol();
    let wave = |method: Method| method.trace_smoothed(&colors, rate, protocol.detrend);
    let others = Method::ALL.into_iter().filter(|method| *method != Method::Pos);
    let others: Vec<f64> =
        others.filter_map(|method| Some(protocol.estimate(&wave(method).ok()?, rate).ok()?.bpm)).collect();
    let pos = wave(Method::Pos)?;
    let found = protocol.estimate(&pos, rate)?;
    let evidence = evidence(&found, &window_rates(&pos, rate, &protocol), &others)?;
    Ok((evidence, (found.bpm - truth).abs() <= 5.0))
}

/// For each tenth of confidence: cases, mean confidence, share that is right.
fn reliability(cases: &[(f64, bool)]) -> Vec<(usize, f64, f64)> {
    let bin = |k: usize| {
        let inside: Vec<&(f64, bool)> = cases.iter().filter(|(p, _)| ((10.0 * p) as usize).min(9) == k).collect();
        let n = inside.len();
        let mean = inside.iter().map(|(p, _)| p).sum::<f64>() / n as f64;
        (n, mean, inside.iter().filter(|(_, right)| *right).count() as f64 / n as f64)
    };
    (0..10).map(bin).collect()
}

#[test]
fn confidence_is_the_share_that_is_right() -> Outcome<()> {
    let cases: Vec<(f64, bool)> = (0..300)
        .map(|seed| case(1_000_000 + seed).map(|(evidence, right)| (evidence.confidence(), right)))
        .collect::<Outcome<_>>()?;
    let right = cases.iter().filter(|(_, right)| *right).count() as f64 / cases.len() as f64;
    println!("{} recordings, {:.0} % right within 5 bpm", cases.len(), 100.0 * right);
    let mut gap = 0.0;
    for (n, said, was) in reliability(&cases).into_iter().filter(|(n, ..)| *n > 0) {
        println!("said {said:.2}, was {was:.2} ({n} recordings)");
        gap += n as f64 / cases.len() as f64 * (said - was).abs();
    }
    let brier =
        cases.iter().map(|(p, right)| (p - f64::from(u8::from(*right))).powi(2)).sum::<f64>() / cases.len() as f64;
    println!("mean gap {gap:.3}, Brier score {brier:.3} (always the mean: {:.3})", right * (1.0 - right));
    assert!(gap < 0.07, "mean gap between said and true confidence: {gap:.3}");
    assert!(brier < 0.6 * right * (1.0 - right), "confidence tells little: {brier:.3}");
    Ok(())
}

/// Newton's method on the logistic likelihood.
#[test]
#[ignore = "fits the weights again"]
fn fit() -> Outcome<()> {
    let cases: Vec<([f64; 4], bool)> =
        (0..1500).map(|seed| case(seed).map(|(evidence, right)| (evidence.signs(), right))).collect::<Outcome<_>>()?;
    let mut weights = [0.0; 4];
    for _ in 0..25 {
        let mut system = [[0.0; 5]; 4];
        (0..4).for_each(|i| system[i][i] = 1e-6);
        for (signs, right) in &cases {
            let sum: f64 = signs.iter().zip(weights).map(|(sign, weight)| sign * weight).sum();
            let p = 1.0 / (1.0 + (-sum).exp());
            for i in 0..4 {
                (0..4).for_each(|j| system[i][j] += p * (1.0 - p) * signs[i] * signs[j]);
                system[i][4] += (f64::from(u8::from(*right)) - p) * signs[i];
            }
        }
        for k in 0..4 {
            for i in (0..4).filter(|i| *i != k) {
                let factor = system[i][k] / system[k][k];
                (k..5).for_each(|j| system[i][j] -= factor * system[k][j]);
            }
        }
        (0..4).for_each(|k| weights[k] += system[k][4] / system[k][k]);
    }
    let right = cases.iter().filter(|(_, right)| *right).count() as f64 / cases.len() as f64;
    println!("{} recordings, {:.0} % right; weights {weights:.3?}", cases.len(), 100.0 * right);
    Ok(())
}
