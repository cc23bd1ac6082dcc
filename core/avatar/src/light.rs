//! A first guess of the light: from the colours of skin that differ only in which way they face.
//!
//! Skin is taken to be of one albedo, so its linear colour over the surface is that albedo times irradiance, which nine
//! spherical-harmonic coefficients describe (Ramamoorthi and Hanrahan 2001). A ridge keeps the bands small where the
//! head's normals leave them open; two rounds of reweighting keep brows, nostrils and highlights out. What colour is
//! light's and what is skin's cannot be told apart from one picture: the guess is white on the mean skin.

use glam::Vec3;
use heartian_splat::{Environment, RADIANCE_COEFFICIENTS};

/// Spherical-harmonic functions of bands 0 to 2.
const N: usize = 9;
/// Irradiance over π per radiance, for each function.
const COSINE: [f64; N] = [1.0, 2.0 / 3.0, 2.0 / 3.0, 2.0 / 3.0, 0.25, 0.25, 0.25, 0.25, 0.25];
/// Ridge on bands 1 and 2, relative to the weight of all samples.
const RIDGE: [f64; N] = [0.0, 0.004, 0.004, 0.004, 0.02, 0.02, 0.02, 0.02, 0.02];
/// Irradiance over π on the mean skin: a little above 1, so that white stays below albedo 1.
const MEAN_IRRADIANCE: f64 = 1.15;
/// Least irradiance over π that a colour is divided by.
const LEAST_IRRADIANCE: f32 = 0.15;
/// Fewest samples worth a fit.
const FEWEST: usize = 50;

/// What one Gaussian says of the light.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LightSample {
    /// Unit normal in the world.
    pub normal: Vec3,
    /// Linear RGB.
    pub color: [f32; 3],
}

/// The first nine real harmonics at a direction, orthonormal, index `l² + l + m`.
fn harmonics(n: Vec3) -> [f64; N] {
    let [x, y, z] = n.to_array().map(f64::from);
    let (c0, c1) = (0.282_094_791_773_878, 0.488_602_511_902_92);
    let (c2, c20, c22) = (1.092_548_430_592_079, 0.315_391_565_252_52, 0.546_274_215_296_04);
    [c0, c1 * y, c1 * z, c1 * x, c2 * x * y, c2 * y * z, c20 * (3.0 * z * z - 1.0), c2 * x * z, c22 * (x * x - y * y)]
}

/// Irradiance over π of a light at a normal, bands 0 to 2, linear RGB, at least a small positive value.
pub(crate) fn irradiance(environment: &Environment, normal: Vec3) -> [f32; 3] {
    let mut sum = [0.0f64; 3];
    for ((y, a), radiance) in harmonics(normal).iter().zip(COSINE).zip(&environment.radiance) {
        sum.iter_mut().zip(radiance).for_each(|(s, r)| *s += y * a * f64::from(*r));
    }
    sum.map(|s| (s as f32).max(LEAST_IRRADIANCE))
}

/// Fits the light; uniform white when there are too few samples or they are black.
pub(crate) fn fit_light(samples: &[LightSample]) -> Environment {
    let mut environment = Environment::uniform([MEAN_IRRADIANCE as f32; 3]);
    if samples.len() < FEWEST {
        return environment;
    }
    for channel in 0..3 {
        if let Some(radiance) = fit_channel(samples, channel) {
            for (coefficient, value) in environment.radiance.iter_mut().zip(radiance) {
                coefficient[channel] = value as f32;
            }
        }
    }
    debug_assert_eq!(environment.radiance.len(), RADIANCE_COEFFICIENTS);
    environment
}

fn fit_channel(samples: &[LightSample], channel: usize) -> Option<[f64; N]> {
    let rows: Vec<[f64; N]> = samples
        .iter()
        .map(|sample| {
            let y = harmonics(sample.normal);
            std::array::from_fn(|k| y[k] * COSINE[k])
        })
        .collect();
    let colors: Vec<f64> = samples.iter().map(|sample| f64::from(sample.color[channel])).collect();
    let mean = colors.iter().sum::<f64>() / colors.len() as f64;
    if !(mean > 1e-4) {
        return None;
    }
    let mut weights = vec![1.0; rows.len()];
    let mut solved = [0.0; N];
    for _ in 0..3 {
        let total: f64 = weights.iter().sum();
        let (mut a, mut b) = ([[0.0; N]; N], [0.0; N]);
        for ((row, color), weight) in rows.iter().zip(&colors).zip(&weights) {
            for i in 0..N {
                b[i] += weight * row[i] * color / mean;
                for j in 0..N {
                    a[i][j] += weight * row[i] * row[j];
                }
            }
        }
        for i in 0..N {
            a[i][i] += RIDGE[i] * total;
        }
        solved = crate::linear::solve(a, b);
        // Tukey-like: residuals beyond a quarter of the mean count for little.
        for ((row, color), weight) in rows.iter().zip(&colors).zip(&mut weights) {
            let fitted: f64 = row.iter().zip(solved).map(|(r, s)| r * s).sum();
            let residual = (color / mean - fitted) / 0.25;
            *weight = 1.0 / (1.0 + residual * residual);
        }
    }
    let lit: f64 = rows
        .iter()
        .zip(&weights)
        .map(|(row, weight)| weight * row.iter().zip(solved).map(|(r, s)| r * s).sum::<f64>())
        .sum::<f64>()
        / weights.iter().sum::<f64>();
    (lit > 1e-3 && solved.iter().all(|s| s.is_finite())).then(|| solved.map(|s| s * MEAN_IRRADIANCE / lit))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_known_light_comes_back_up_to_its_colour() {
        let mut truth = Environment::uniform([1.0; 3]);
        for (index, radiance) in truth.radiance.iter_mut().enumerate().take(N).skip(1) {
            *radiance = [0.25 * ((index * 7 % 5) as f32 - 2.0); 3];
        }
        let samples: Vec<LightSample> = (0..2000)
            .map(|i| {
                let (u, v) = (i as f32 / 2000.0, (i as f32 * 0.618).fract());
                let z = 0.1 + 0.9 * u;
                let normal = Vec3::new((std::f32::consts::TAU * v).cos(), (std::f32::consts::TAU * v).sin(), 0.0)
                    * (1.0 - z * z).max(0.0).sqrt()
                    + Vec3::Z * z;
                let albedo = if i % 17 == 0 { [0.02; 3] } else { [0.6, 0.4, 0.3] };
                let e = irradiance(&truth, normal);
                LightSample { normal, color: std::array::from_fn(|c| albedo[c] * e[c]) }
            })
            .collect();
        let fitted = fit_light(&samples);
        let ratio = |normal: Vec3| irradiance(&fitted, normal)[1] / irradiance(&truth, normal)[1];
        let reference = ratio(Vec3::Z);
        // The ridge holds band 2 back to a sixth or so of this rather contrasty light; without it the bound would be 0.01.
        for sample in samples.iter().step_by(97) {
            assert!((ratio(sample.normal) / reference - 1.0).abs() < 0.16, "{}", ratio(sample.normal) / reference);
        }
    }

    #[test]
    fn too_little_or_black_skin_means_white_light() {
        let black = LightSample { normal: Vec3::Z, color: [0.0; 3] };
        for samples in [vec![], vec![black; 10], vec![black; 500]] {
            let e = irradiance(&fit_light(&samples), Vec3::Y);
            assert!(e.iter().all(|e| (e - MEAN_IRRADIANCE as f32).abs() < 1e-4), "{e:?}");
        }
    }
}
