//! Tables of the split sum, generated on first use: the environment BRDF's scale and bias over (n·v, roughness), and how
//! much of each harmonic band a lobe of given roughness lets through.
//!
//! GGX with `α = roughness²` and height-correlated Smith visibility (Karis 2013; Heitz 2014; Walter et al. 2007).

use crate::harmonics::BANDS;
use rayon::prelude::*;
use std::sync::OnceLock;

/// Texels of the BRDF table along each axis, at centres `(i + ½)/SIZE`.
pub(crate) const SIZE: usize = 64;
/// Nodes of the lobe table, at `i/(NODES − 1)`.
pub(crate) const NODES: usize = 65;
/// Strata of the importance-sampled integrals: half-angle and azimuth (half a turn, by symmetry).
const STRATA: [usize; 2] = [32, 12];

/// The tables.
#[derive(Debug)]
pub(crate) struct Tables {
    /// `SIZE × SIZE` (row = roughness, column = n·v) of scale and bias.
    pub brdf: Vec<[f32; 2]>,
    /// `NODES` of the share of each band that passes; band 0 is always 1.
    pub lobe: Vec<[f32; BANDS]>,
}

/// A bilinear or linear look-up: value and slope.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct BrdfSample {
    /// Scale and bias.
    pub value: [f32; 2],
    /// Their derivative by n·v.
    pub by_cosine: [f32; 2],
    /// Their derivative by roughness.
    pub by_roughness: [f32; 2],
}

/// The tables, made once in a process.
pub(crate) fn tables() -> &'static Tables {
    static TABLES: OnceLock<Tables> = OnceLock::new();
    TABLES.get_or_init(|| Tables {
        brdf: (0..SIZE * SIZE)
            .into_par_iter()
            .map(|i| {
                let at = |k: usize| (k as f64 + 0.5) / SIZE as f64;
                environment_brdf(at(i % SIZE), at(i / SIZE), STRATA).map(|v| v as f32)
            })
            .collect(),
        lobe: (0..NODES).map(|i| lobe_bands(i as f64 / (NODES - 1) as f64, 2048).map(|v| v as f32)).collect(),
    })
}

impl Tables {
    /// Scale and bias, bilinear; both arguments in [0, 1].
    #[inline]
    pub fn sample_brdf(&self, cosine: f32, roughness: f32) -> BrdfSample {
        // Half a texel at each edge goes on along the outermost cell.
        let place = |v: f32| {
            let t = v * SIZE as f32 - 0.5;
            let cell = (t.max(0.0) as usize).min(SIZE - 2);
            (cell, t - cell as f32)
        };
        let slope = SIZE as f32;
        let ((x, fx), (y, fy)) = (place(cosine), place(roughness));
        let mut out = BrdfSample::default();
        for k in 0..2 {
            let texel = |dx: usize, dy: usize| self.brdf[(y + dy) * SIZE + x + dx][k];
            let (low, high) =
                (texel(0, 0) + fx * (texel(1, 0) - texel(0, 0)), texel(0, 1) + fx * (texel(1, 1) - texel(0, 1)));
            let (left, right) =
                (texel(0, 0) + fy * (texel(0, 1) - texel(0, 0)), texel(1, 0) + fy * (texel(1, 1) - texel(1, 0)));
            out.value[k] = low + fy * (high - low);
            out.by_cosine[k] = slope * (right - left);
            out.by_roughness[k] = slope * (high - low);
        }
        out
    }

    /// Share of each band at a roughness in [0, 1], linear between nodes, and its derivative.
    #[inline]
    pub fn sample_lobe(&self, roughness: f32) -> ([f32; BANDS], [f32; BANDS]) {
        let t = roughness.clamp(0.0, 1.0) * (NODES - 1) as f32;
        let cell = (t as usize).min(NODES - 2);
        let (a, b, f) = (&self.lobe[cell], &self.lobe[cell + 1], t - cell as f32);
        (std::array::from_fn(|l| a[l] + f * (b[l] - a[l])), std::array::from_fn(|l| (NODES - 1) as f32 * (b[l] - a[l])))
    }
}

/// Scale and bias of the environment BRDF: `∫ f(v, l)·(n·l) dl = F0·scale + bias` by importance sampling of GGX.
pub(crate) fn environment_brdf(cosine: f64, roughness: f64, [angles, turns]: [usize; 2]) -> [f64; 2] {
    let alpha2 = roughness.powi(4).max(1e-8);
    let (nv, view_x) = (cosine, (1.0 - cosine * cosine).max(0.0).sqrt());
    let mut sum = [0.0; 2];
    for i in 0..angles {
        // u = 1 − q³ crowds the strata at the lobe's tail, where the integrand has its cusp.
        let q = 1.0 - (i as f64 + 0.5) / angles as f64;
        let u = 1.0 - q * q * q;
        let nh = ((1.0 - u) / (1.0 + (alpha2 - 1.0) * u)).sqrt();
        let side = (1.0 - nh * nh).max(0.0).sqrt();
        for j in 0..turns {
            let phi = std::f64::consts::PI * (j as f64 + 0.5) / turns as f64;
            let vh = (side * phi.cos() * view_x + nh * nv).max(0.0);
            let nl = 2.0 * vh * nh - nv;
            if nl > 0.0 {
                let smith = |a: f64, b: f64| a * (b * b * (1.0 - alpha2) + alpha2).sqrt();
                let weight = 2.0 / (smith(nl, nv) + smith(nv, nl)) * nl * vh / nh * 3.0 * q * q;
                let fresnel = (1.0 - vh).powi(5);
                sum[0] += (1.0 - fresnel) * weight;
                sum[1] += fresnel * weight;
            }
        }
    }
    sum.map(|s| s / (angles * turns) as f64)
}

/// Zonal coefficients, relative to band 0, of the lobe `D(θ/2)·max(cos θ, 0)` around the mirror direction (n = v).
fn lobe_bands(roughness: f64, samples: usize) -> [f64; BANDS] {
    let alpha2 = roughness.powi(4);
    let (mut sum, mut whole) = ([0.0; BANDS], 0.0);
    for i in 0..samples {
        let u = (i as f64 + 0.5) / samples as f64;
        let x = 2.0 * (1.0 - u) / (1.0 + (alpha2 - 1.0) * u) - 1.0;
        if x > 0.0 {
            whole += x;
            for (s, p) in sum.iter_mut().zip(legendre(x)) {
                *s += x * p;
            }
        }
    }
    sum.map(|s| s / whole)
}

/// Legendre polynomials of the bands in use.
pub(crate) fn legendre(x: f64) -> [f64; BANDS] {
    let x2 = x * x;
    [1.0, x, 1.5 * x2 - 0.5, x * (2.5 * x2 - 1.5), (x2 * (35.0 * x2 - 30.0) + 3.0) / 8.0]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_gives_the_known_values_of_the_split_sum() {
        // Scale and bias at (row, column) of a 256-texel table, from an independent integration.
        for (row, column, want) in [
            (64.5, 64.5, [0.7606, 0.2005]),
            (128.5, 128.5, [0.8343, 0.0219]),
            (192.5, 64.5, [0.7152, 0.0275]),
            (255.5, 192.5, [0.3653, 0.0006]),
        ] {
            let got = tables().sample_brdf(column / 256.0, row / 256.0).value;
            assert!(
                (got[0] - want[0]).abs() < 2e-3 && (got[1] - want[1]).abs() < 2e-3,
                "{row} {column}: {got:?} {want:?}"
            );
        }
    }

    #[test]
    fn the_lobe_narrows_to_a_mirror_and_agrees_with_plain_quadrature() {
        let lobe = &tables().lobe;
        assert!(lobe[0].iter().all(|w| (w - 1.0).abs() < 1e-6));
        assert!(lobe.windows(2).all(|w| (0..BANDS).all(|l| w[1][l] <= w[0][l] + 1e-5)));
        for node in [24, 45, 64] {
            let alpha2 = (node as f64 / 64.0).powi(4);
            let (mut sum, mut whole) = ([0.0; BANDS], 0.0);
            for i in 0..20_000 {
                let theta = std::f64::consts::FRAC_PI_2 * (f64::from(i) + 0.5) / 20_000.0;
                let d = alpha2 / ((theta / 2.0).cos().powi(2) * (alpha2 - 1.0) + 1.0).powi(2);
                let weight = d * theta.cos() * theta.sin();
                whole += weight;
                for (s, p) in sum.iter_mut().zip(legendre(theta.cos())) {
                    *s += weight * p;
                }
            }
            for l in 0..BANDS {
                assert!((sum[l] / whole - f64::from(lobe[node][l])).abs() < 2e-4, "node {node} band {l}");
            }
        }
    }
}
