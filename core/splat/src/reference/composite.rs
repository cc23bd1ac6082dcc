//! Compositing in f64, every pixel against every Gaussian: the specification of `raster.rs` and of the gather.
//!
//! The backward text goes back to front by the usual recursion for the features, opacities and the 2-D geometry; the
//! projection's part is a central difference in f64, so that no derivative of it is written twice.

use super::Scene;
use super::project::{Projected, project};
use crate::project::{ALPHA_MAX, ALPHA_MIN, RasterOptions, TRANSMITTANCE_MIN};
use heartian_space::Camera;

/// A composited picture in f64, planar; see [`crate::Frame`].
#[derive(Clone, Debug, Default)]
pub struct Picture {
    /// `channels × height × width`.
    pub planes: Vec<f64>,
    /// `height × width` composited depth, metres.
    pub depth: Vec<f64>,
    /// `height × width`.
    pub transmittance: Vec<f64>,
    /// How many (Gaussian, pixel) pairs were composited.
    pub pairs: usize,
}

/// Gradients in f64; see [`crate::SceneGradients`].
#[derive(Clone, Debug, Default)]
pub struct Gradients {
    /// `N`.
    pub means: Vec<[f64; 3]>,
    /// `N`.
    pub scales: Vec<[f64; 3]>,
    /// `N`.
    pub rotations: Vec<[f64; 4]>,
    /// `N`.
    pub opacities: Vec<f64>,
    /// `N × channels`.
    pub features: Vec<f64>,
    /// `N`, per pixel.
    pub means_px: Vec<[f64; 2]>,
    /// `N`, sum of blend weights.
    pub weights: Vec<f64>,
}

/// Gradient of a loss with respect to a [`Picture`].
#[derive(Clone, Debug, Default)]
pub struct PictureGradient {
    /// `channels × height × width`.
    pub planes: Vec<f64>,
    /// `height × width`.
    pub depth: Vec<f64>,
    /// `height × width`.
    pub transmittance: Vec<f64>,
}

/// One contribution to a pixel.
struct Contribution {
    splat: usize,
    offset: [f64; 2],
    /// `e^p`.
    falloff: f64,
    alpha: f64,
    /// Transmittance in front of it.
    before: f64,
}

/// A Gaussian of the scene in the picture.
pub(super) type Visible = (usize, Projected);

/// Visible Gaussians in order of depth, ties in the order of the scene.
pub(super) fn visible(scene: &Scene, camera: &Camera, options: &RasterOptions) -> Vec<Visible> {
    let mut order: Vec<_> =
        (0..scene.len()).filter_map(|i| project(scene, i, camera, options).map(|p| (i, p))).collect();
    order.sort_by(|a, b| a.1.depth.total_cmp(&b.1.depth));
    order
}

/// The contributions to the pixel centred at (`x`, `y`), front to back, and the transmittance behind them.
fn contributions(scene: &Scene, splats: &[Visible], [x, y]: [f64; 2]) -> (Vec<Contribution>, f64) {
    let (mut found, mut transmittance) = (Vec::new(), 1.0);
    for (splat, (i, projected)) in splats.iter().enumerate() {
        let [xx, xy, yy] = projected.covariance;
        let offset = [x - projected.mean[0], y - projected.mean[1]];
        let det = xx * yy - xy * xy;
        let quadratic =
            (yy * offset[0] * offset[0] - 2.0 * xy * offset[0] * offset[1] + xx * offset[1] * offset[1]) / det;
        let falloff = (-0.5 * quadratic).exp();
        let alpha = (scene.opacities[*i].min(1.0) * falloff).min(f64::from(ALPHA_MAX));
        if alpha < f64::from(ALPHA_MIN) {
            continue;
        }
        if transmittance * (1.0 - alpha) < f64::from(TRANSMITTANCE_MIN) {
            break;
        }
        found.push(Contribution { splat, offset, falloff, alpha, before: transmittance });
        transmittance *= 1.0 - alpha;
    }
    (found, transmittance)
}

/// Centres of all pixels in row-major order.
fn pixel_centres(camera: &Camera) -> impl Iterator<Item = [f64; 2]> + '_ {
    (0..camera.width * camera.height).map(|i| [(i % camera.width) as f64 + 0.5, (i / camera.width) as f64 + 0.5])
}

/// Composites a scene.
pub fn composite(scene: &Scene, camera: &Camera, options: &RasterOptions) -> Picture {
    let splats = visible(scene, camera, options);
    let mut out = Picture::empty(scene.channels, camera);
    for at in 0..camera.width * camera.height {
        draw(scene, &splats, at, camera.width, &mut out);
    }
    out
}

impl Picture {
    /// A picture that nothing was drawn to.
    pub(super) fn empty(channels: usize, camera: &Camera) -> Self {
        let pixels = camera.width * camera.height;
        Self {
            planes: vec![0.0; channels * pixels],
            depth: vec![0.0; pixels],
            transmittance: vec![1.0; pixels],
            pairs: 0,
        }
    }
}

/// Composites pixel `at` of a picture `width` pixels wide.
pub(super) fn draw(scene: &Scene, splats: &[Visible], at: usize, width: usize, out: &mut Picture) {
    let pixels = out.depth.len();
    let (found, transmittance) = contributions(scene, splats, [(at % width) as f64 + 0.5, (at / width) as f64 + 0.5]);
    out.transmittance[at] = transmittance;
    out.pairs += found.len();
    for item in found {
        let (i, projected) = &splats[item.splat];
        let weight = item.alpha * item.before;
        out.depth[at] += weight * projected.depth;
        for c in 0..scene.channels {
            out.planes[c * pixels + at] += weight * scene.features[i * scene.channels + c];
        }
    }
}

/// `Σ gradient · picture`, the loss whose gradients [`backward`] gives.
pub fn inner_product(picture: &Picture, gradient: &PictureGradient) -> f64 {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    dot(&picture.planes, &gradient.planes)
        + dot(&picture.depth, &gradient.depth)
        + dot(&picture.transmittance, &gradient.transmittance)
}

/// Gradient with respect to a [`Projected`]: centre 2, covariance 3 (xy once), depth.
type OnProjected = [f64; 6];

/// Gradients of [`inner_product`] with respect to the scene.
pub fn backward(scene: &Scene, camera: &Camera, options: &RasterOptions, gradient: &PictureGradient) -> Gradients {
    let (splats, n, channels) = (visible(scene, camera, options), scene.len(), scene.channels);
    let mut out = Gradients {
        means: vec![[0.0; 3]; n],
        scales: vec![[0.0; 3]; n],
        rotations: vec![[0.0; 4]; n],
        opacities: vec![0.0; n],
        features: vec![0.0; n * channels],
        means_px: vec![[0.0; 2]; n],
        weights: vec![0.0; n],
    };
    let mut on_projected = vec![[0.0; 6]; splats.len()];
    for (at, centre) in pixel_centres(camera).enumerate() {
        backward_pixel(scene, &splats, gradient, (at, centre), &mut out, &mut on_projected);
    }
    for ((i, projected), on) in splats.iter().zip(&on_projected) {
        out.means_px[*i] = [on[0], on[1]];
        through_projection(scene, *i, (camera, options), projected, on, &mut out);
    }
    out
}

fn backward_pixel(
    scene: &Scene,
    splats: &[(usize, Projected)],
    gradient: &PictureGradient,
    (at, centre): (usize, [f64; 2]),
    out: &mut Gradients,
    on_projected: &mut [OnProjected],
) {
    let (channels, pixels) = (scene.channels, gradient.depth.len());
    let (found, transmittance) = contributions(scene, splats, centre);
    // What lies behind: its value times the gradient, and the transmittance's share.
    let mut behind = transmittance * gradient.transmittance[at];
    for item in found.iter().rev() {
        let (i, projected) = &splats[item.splat];
        let on = &mut on_projected[item.splat];
        let weight = item.alpha * item.before;
        let mut towards = projected.depth * gradient.depth[at];
        on[5] += weight * gradient.depth[at];
        for c in 0..channels {
            out.features[i * channels + c] += weight * gradient.planes[c * pixels + at];
            towards += scene.features[i * channels + c] * gradient.planes[c * pixels + at];
        }
        out.weights[*i] += weight;
        let on_alpha = item.before * towards - behind / (1.0 - item.alpha);
        behind += weight * towards;
        if scene.opacities[*i].min(1.0) * item.falloff >= f64::from(ALPHA_MAX) {
            continue;
        }
        if scene.opacities[*i] <= 1.0 {
            out.opacities[*i] += item.falloff * on_alpha;
        }
        // α = o·e^p with p = −½·dᵀ·Σ⁻¹·d: ∂p/∂d = −Σ⁻¹·d =: −k, ∂p/∂Σ = ½·k·kᵀ.
        let on_exponent = item.alpha * on_alpha;
        let [xx, xy, yy] = projected.covariance;
        let det = xx * yy - xy * xy;
        let k = [(yy * item.offset[0] - xy * item.offset[1]) / det, (xx * item.offset[1] - xy * item.offset[0]) / det];
        for (slot, value) in on.iter_mut().zip([k[0], k[1], 0.5 * k[0] * k[0], k[0] * k[1], 0.5 * k[1] * k[1]]) {
            *slot += on_exponent * value;
        }
    }
}

/// Adds `gradient · ∂(projected)/∂(mean, scale, rotation)`, the Jacobian by central differences.
fn through_projection(
    scene: &Scene,
    i: usize,
    (camera, options): (&Camera, &RasterOptions),
    projected: &Projected,
    on: &OnProjected,
    out: &mut Gradients,
) {
    let one = Scene {
        means: vec![scene.means[i]],
        scales: vec![scene.scales[i]],
        rotations: vec![scene.rotations[i]],
        ..Scene::default()
    };
    let value = |s: &Scene| {
        let p = project(s, 0, camera, options).unwrap_or(*projected);
        on[0] * p.mean[0]
            + on[1] * p.mean[1]
            + on[2] * p.covariance[0]
            + on[3] * p.covariance[1]
            + on[4] * p.covariance[2]
            + on[5] * p.depth
    };
    let slope = |touch: &dyn Fn(&mut Scene, f64), step: f64| {
        let (mut up, mut down) = (one.clone(), one.clone());
        touch(&mut up, step);
        touch(&mut down, -step);
        (value(&up) - value(&down)) / (2.0 * step)
    };
    let norm = scene.rotations[i].iter().map(|q| q * q).sum::<f64>().sqrt();
    for k in 0..3 {
        out.means[i][k] += slope(&|s, h| s.means[0][k] += h, 1e-6);
        out.scales[i][k] += slope(&|s, h| s.scales[0][k] += h, 1e-4 * scene.scales[i][k].max(1e-6));
    }
    for k in 0..4 {
        out.rotations[i][k] += slope(&|s, h| s.rotations[0][k] += h, 1e-6 * norm);
    }
}
