//! A camera sensor: shot and read noise in linear light, then the sRGB transfer and 8-bit quantisation.
//!
//! Light is a fraction of the full well, 1 = white. There is no compression and no denoising.

use heartian_space::color;

use super::random::Random;

/// Electrons at white of a small sensor at moderate gain; shot noise at white is 1/√12000 ≈ 0.9 %.
const FULL_WELL_ELECTRONS: f32 = 12_000.0;
/// Read noise, electrons.
const READ_ELECTRONS: f32 = 6.0;
const BUCKETS: usize = 4096;

/// Turns linear light into noisy 8-bit codes.
pub(crate) struct Sensor {
    /// Linear light above which the code is at least `index + 1`, 255 of them.
    thresholds: [f32; 255],
    /// The code at the lower end of each bucket of linear light.
    first_code: [u8; BUCKETS],
}

impl Sensor {
    pub(crate) fn new() -> Self {
        let thresholds = std::array::from_fn(|code| color::linear_from_srgb((code as f32 + 0.5) / 255.0));
        let code_at = |light: f32| thresholds.partition_point(|threshold| *threshold <= light) as u8;
        let first_code = std::array::from_fn(|bucket| code_at(bucket as f32 / BUCKETS as f32));
        Self { thresholds, first_code }
    }

    /// One channel of one pixel; `counter` numbers the sample within the frame.
    pub(crate) fn expose(&self, light: f32, frame: Random, counter: u64) -> u8 {
        let variance = (light.max(0.0) * FULL_WELL_ELECTRONS + READ_ELECTRONS * READ_ELECTRONS)
            / (FULL_WELL_ELECTRONS * FULL_WELL_ELECTRONS);
        self.quantise(light + variance.sqrt() * frame.fast_normal(counter))
    }

    /// The code of linear light: the sRGB transfer, rounded and clamped, by table.
    pub(crate) fn quantise(&self, light: f32) -> u8 {
        let light = light.clamp(0.0, 1.0);
        let mut code = self.first_code[((light * BUCKETS as f32) as usize).min(BUCKETS - 1)];
        while code < 255 && light >= self.thresholds[usize::from(code)] {
            code += 1;
        }
        code
    }
}

#[cfg(test)]
mod tests {
    use super::super::random::Stream;
    use super::*;

    #[test]
    fn the_table_is_the_transfer_function() {
        let sensor = Sensor::new();
        for step in 0..=100_000 {
            let light = step as f32 / 100_000.0;
            let exact = color::srgb_from_linear(light) * 255.0;
            assert!((exact - f32::from(sensor.quantise(light))).abs() <= 0.501, "{light}");
        }
        assert_eq!([sensor.quantise(-1.0), sensor.quantise(2.0)], [0, 255]);
    }

    #[test]
    fn noise_follows_the_light() {
        let (sensor, random) = (Sensor::new(), Random::new(3, Stream::Sensor));
        for light in [0.05f32, 0.4] {
            let codes: Vec<f32> = (0..40_000)
                .map(|counter| color::linear_from_srgb(f32::from(sensor.expose(light, random, counter)) / 255.0))
                .collect();
            let mean = codes.iter().sum::<f32>() / codes.len() as f32;
            let spread = (codes.iter().map(|c| (c - mean).powi(2)).sum::<f32>() / codes.len() as f32).sqrt();
            let step = color::linear_from_srgb(color::srgb_from_linear(light) + 1.0 / 255.0) - light;
            let expected =
                (light / FULL_WELL_ELECTRONS + (READ_ELECTRONS / FULL_WELL_ELECTRONS).powi(2) + step * step / 12.0)
                    .sqrt();
            assert!(
                (mean - light).abs() < 0.002 && (spread / expected - 1.0).abs() < 0.1,
                "{mean} {spread} {expected}"
            );
        }
    }
}
