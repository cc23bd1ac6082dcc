//! Deferred shading: a composited material picture under a far light, in linear light, and its exact derivative.
//! Twin of `reference/shade.rs`.
//!
//! Channels as composited (premultiplied): albedo 3, world normal 3, roughness, reflectance at normal incidence; alpha is
//! one minus transmittance. With `n` the normalised normal, `v` to the camera, `ρ` the mirrored view and `α·h(x/α)` for
//! roughness and reflectance (so silhouettes keep their material; differs from HRAvatar, which does not divide):
//!
//! `rgb = albedo·I(n)·(1 − K) + α·Q(ρ, r)·K`, `K = f0·B0(n·v, r) + min(50·f0, 1)·B1(n·v, r)`
//!
//! `I` is irradiance over π and `Q` the lobe's radiance (Karis 2013's split sum); `1 − K` keeps a white furnace white.
//! Both lights pass `½(x + √(x² + ε²))`, ε = 2e-3, so that a band-limited light is never negative. Output is linear RGB
//! premultiplied over black.

use crate::brdf::{Tables, tables};
use crate::environment::{COSINE_BANDS, Environment};
use crate::error::{SplatError, expect_length};
use crate::harmonics::{BAND_OF, BANDS, COUNT, basis, gradient};
use crate::lanes::wide::{Wide, dot, each};
use crate::lanes::{Lanes, MAX_LANES, dispatched};
use crate::render::Frame;
use glam::{Vec2, Vec3};
use heartian_space::Camera;
use rayon::prelude::*;

/// Channels that shading reads; a frame may have more behind them.
pub const DEFERRED_CHANNELS: usize = 8;

/// First channel of each material.
pub mod channel {
    /// Linear RGB albedo, three channels.
    pub const ALBEDO: usize = 0;
    /// World-space normal, three channels.
    pub const NORMAL: usize = 3;
    /// Perceptual roughness in [0, 1].
    pub const ROUGHNESS: usize = 6;
    /// Reflectance at normal incidence in [0, 1].
    pub const REFLECTANCE: usize = 7;
}

/// Pixels with less alpha than this stay black; a drawn Gaussian gives at least 1/255.
pub(crate) const ALPHA_SHADED: f32 = 1.0 / 512.0;
/// Softness of the guard against negative light.
pub(crate) const LIGHT_SOFTNESS: f32 = 2e-3;
/// Squared length that is added before a normal is normalised.
pub(crate) const NORMAL_SOFTNESS: f32 = 1e-12;
/// Smallest n·v that the BRDF table is asked for.
pub(crate) const COSINE_MIN: f32 = 1e-3;
/// Reflectance from which grazing light is fully reflected, inverted.
pub(crate) const GRAZING_GAIN: f32 = 50.0;

/// Gradients of a loss with respect to what [`shade`] reads.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ShadeGradients {
    /// `channels × height × width`, as the frame's planes; zero beyond [`DEFERRED_CHANNELS`].
    pub planes: Vec<f32>,
    /// `height × width`, with respect to transmittance.
    pub transmittance: Vec<f32>,
    /// `25 × RGB`, with respect to the light's coefficients.
    pub radiance: Vec<[f32; 3]>,
}

/// The light as the kernels read it.
struct Light {
    diffuse: [[f32; 3]; COUNT],
    radiance: [[f32; 3]; COUNT],
}

impl Light {
    fn new(environment: &Environment) -> Self {
        let radiance: [[f32; 3]; COUNT] = std::array::from_fn(|i| environment.radiance[i]);
        Self { diffuse: std::array::from_fn(|i| radiance[i].map(|c| c * COSINE_BANDS[BAND_OF[i]])), radiance }
    }
}

/// One vector of pixels on its way in or out: eight channels, transmittance, three components of the view.
type Block<const K: usize> = [[f32; MAX_LANES]; K];
const INPUTS: usize = DEFERRED_CHANNELS + 4;
const OUTPUTS: usize = DEFERRED_CHANNELS + 1;

/// Shades a frame: `3 × height × width` linear RGB, premultiplied over black.
///
/// # Errors
/// When the frame has fewer than eight channels, or camera, light and frame do not agree in size.
pub fn shade(frame: &Frame, camera: &Camera, environment: &Environment) -> Result<Vec<f32>, SplatError> {
    check(frame, camera, environment)?;
    let (light, pixels) = (Light::new(environment), frame.width * frame.height);
    let mut rgb = vec![0.0; 3 * pixels];
    let (r, rest) = rgb.split_at_mut(pixels);
    let (g, b) = rest.split_at_mut(pixels);
    let rows = r.par_chunks_mut(frame.width).zip(g.par_chunks_mut(frame.width)).zip(b.par_chunks_mut(frame.width));
    rows.enumerate().for_each(|(y, ((r, g), b))| forward_row(frame, camera, &light, y, &mut [r, g, b]));
    Ok(rgb)
}

/// Exact derivative of [`shade`].
///
/// # Errors
/// As [`shade`], and when `gradient` is not `3 × height × width`.
pub fn shade_backward(
    frame: &Frame,
    camera: &Camera,
    environment: &Environment,
    gradient: &[f32],
) -> Result<ShadeGradients, SplatError> {
    check(frame, camera, environment)?;
    let (width, pixels) = (frame.width, frame.width * frame.height);
    expect_length("the gradient of the shaded picture", 3 * pixels, gradient.len())?;
    let light = Light::new(environment);
    let mut out = ShadeGradients {
        planes: vec![0.0; frame.planes.len()],
        transmittance: vec![0.0; pixels],
        radiance: Vec::new(),
    };
    let mut rows: Vec<Vec<&mut [f32]>> = (0..frame.height).map(|_| Vec::with_capacity(OUTPUTS)).collect();
    let planes = out.planes.chunks_exact_mut(pixels).take(DEFERRED_CHANNELS);
    for plane in planes.chain(std::iter::once(out.transmittance.as_mut_slice())) {
        for (row, values) in rows.iter_mut().zip(plane.chunks_exact_mut(width)) {
            row.push(values);
        }
    }
    let partial: Vec<[[f32; 3]; COUNT]> =
        rows.par_iter_mut().enumerate().map(|(y, row)| backward_row(frame, camera, &light, y, gradient, row)).collect();
    let mut sum = [[0.0f64; 3]; COUNT];
    for row in &partial {
        for (s, v) in sum.as_flattened_mut().iter_mut().zip(row.as_flattened()) {
            *s += f64::from(*v);
        }
    }
    out.radiance = sum.iter().map(|s| s.map(|v| v as f32)).collect();
    Ok(out)
}

fn check(frame: &Frame, camera: &Camera, environment: &Environment) -> Result<(), SplatError> {
    let pixels = frame.width * frame.height;
    if frame.channels < DEFERRED_CHANNELS {
        return Err(SplatError::Length {
            what: "the channels of a frame to shade",
            expected: DEFERRED_CHANNELS,
            found: frame.channels,
        });
    }
    expect_length("the camera's picture", pixels, camera.width * camera.height)?;
    expect_length("the frame's planes", frame.channels * pixels, frame.planes.len())?;
    expect_length("the frame's transmittance", pixels, frame.transmittance.len())?;
    expect_length("the light's coefficients", COUNT, environment.radiance.len())
}

/// Reads up to `lanes` pixels from column `x` of row `y`; `None` when none of them is to be shaded.
fn read_block(frame: &Frame, camera: &Camera, y: usize, x: usize, lanes: usize) -> Option<Block<INPUTS>> {
    let count = lanes.min(frame.width - x);
    let at = y * frame.width + x;
    let transmittance = &frame.transmittance[at..at + count];
    if transmittance.iter().all(|t| 1.0 - t < ALPHA_SHADED) {
        return None;
    }
    let mut block = [[0.0; MAX_LANES]; INPUTS];
    for c in 0..DEFERRED_CHANNELS {
        block[c][..count].copy_from_slice(&frame.plane(c)[at..at + count]);
    }
    block[DEFERRED_CHANNELS] = [1.0; MAX_LANES];
    block[DEFERRED_CHANNELS][..count].copy_from_slice(transmittance);
    let world_from_camera = camera.camera_from_world_rotation().transpose();
    let ([fx, fy], [cx, cy]) = (camera.focal_px, camera.principal_px);
    for i in 0..lanes {
        let pixel = Vec2::new((x + i) as f32 + 0.5, y as f32 + 0.5);
        let ray = world_from_camera * Vec3::new((pixel.x - cx) / fx, (pixel.y - cy) / fy, 1.0);
        let view = -ray / ray.length();
        for k in 0..3 {
            block[DEFERRED_CHANNELS + 1 + k][i] = view[k];
        }
    }
    Some(block)
}

fn forward_row(frame: &Frame, camera: &Camera, light: &Light, y: usize, out: &mut [&mut [f32]; 3]) {
    let tables = tables();
    for x in (0..frame.width).step_by(MAX_LANES) {
        let Some(block) = read_block(frame, camera, y, x, MAX_LANES) else { continue };
        let mut rgb = [[0.0; MAX_LANES]; 3];
        forward_block(&block, light, tables, &mut rgb);
        let count = MAX_LANES.min(frame.width - x);
        for (out, rgb) in out.iter_mut().zip(&rgb) {
            out[x..x + count].copy_from_slice(&rgb[..count]);
        }
    }
}

fn backward_row(
    frame: &Frame,
    camera: &Camera,
    light: &Light,
    y: usize,
    gradient: &[f32],
    out: &mut [&mut [f32]],
) -> [[f32; 3]; COUNT] {
    let (tables, pixels) = (tables(), frame.width * frame.height);
    let mut on_light = [[[0.0f32; MAX_LANES]; 3]; COUNT];
    let mut touched = false;
    for x in (0..frame.width).step_by(MAX_LANES) {
        let Some(block) = read_block(frame, camera, y, x, MAX_LANES) else { continue };
        touched = true;
        let count = MAX_LANES.min(frame.width - x);
        let mut rgb = [[0.0; MAX_LANES]; 3];
        for (c, rgb) in rgb.iter_mut().enumerate() {
            rgb[..count].copy_from_slice(&gradient[c * pixels + y * frame.width + x..][..count]);
        }
        let mut grads = [[0.0; MAX_LANES]; OUTPUTS];
        backward_block(&block, light, tables, &rgb, &mut grads, &mut on_light);
        for (out, grad) in out.iter_mut().zip(&grads) {
            out[x..x + count].copy_from_slice(&grad[..count]);
        }
    }
    if !touched {
        return [[0.0; 3]; COUNT];
    }
    on_light.map(|channels| channels.map(|lanes| lanes.iter().sum()))
}

/// What forward and backward both need of a vector of pixels.
struct Surface<V: Lanes> {
    albedo: [Wide<V>; 3],
    normal: [Wide<V>; 3],
    inverse_length: Wide<V>,
    view: [Wide<V>; 3],
    /// n·v before and after it is held in the table's range.
    facing: Wide<V>,
    mirrored: [Wide<V>; 3],
    alpha: Wide<V>,
    inverse_alpha: Wide<V>,
    roughness: Wide<V>,
    reflectance: Wide<V>,
    /// 1 where the pixel is shaded.
    shaded: Wide<V>,
    /// Share of each band in the lobe, and its derivative by roughness.
    lobe: [[Wide<V>; BANDS]; 2],
    /// Scale and bias, by value, by n·v, by roughness.
    brdf: [[Wide<V>; 2]; 3],
}

/// # Safety
/// Inside a function with the features of `V`; `from + V::N ≤ MAX_LANES`.
#[inline(always)]
unsafe fn part<V: Lanes>(values: &[f32; MAX_LANES], from: usize) -> Wide<V> {
    // SAFETY: the caller's contract.
    Wide(unsafe { V::load(values.as_ptr().add(from)) })
}

/// # Safety
/// As [`part`].
#[inline(always)]
unsafe fn surface<V: Lanes>(block: &Block<INPUTS>, tables: &Tables, from: usize) -> Surface<V> {
    // SAFETY: V's features are here by contract.
    unsafe {
        let get = |k: usize| part::<V>(&block[k], from);
        let alpha = Wide::<V>::splat(1.0) - get(DEFERRED_CHANNELS);
        let shaded = alpha.at_least(ALPHA_SHADED);
        let inverse_alpha = alpha.clamp(ALPHA_SHADED, 1.0).recip();
        let raw = [get(channel::NORMAL), get(channel::NORMAL + 1), get(channel::NORMAL + 2)];
        let inverse_length = (dot(raw, raw) + NORMAL_SOFTNESS).sqrt().recip();
        let normal: [Wide<V>; 3] = each(
            #[inline(always)]
            |k: usize| raw[k] * inverse_length,
        );
        let view = [get(DEFERRED_CHANNELS + 1), get(DEFERRED_CHANNELS + 2), get(DEFERRED_CHANNELS + 3)];
        let facing = dot(normal, view);
        let mirrored = each(
            #[inline(always)]
            |k: usize| normal[k] * facing * 2.0 - view[k],
        );
        let roughness = get(channel::ROUGHNESS) * inverse_alpha;
        let reflectance = get(channel::REFLECTANCE) * inverse_alpha;
        let (mut cosines, mut roughnesses) = ([0.0; MAX_LANES], [0.0; MAX_LANES]);
        facing.clamp(COSINE_MIN, 1.0).store(&mut cosines);
        roughness.clamp(0.0, 1.0).store(&mut roughnesses);
        let mut looked_up = [[0.0; MAX_LANES]; 6 + 2 * BANDS];
        for i in 0..V::N {
            let brdf = tables.sample_brdf(cosines[i], roughnesses[i]);
            let (lobe, slope) = tables.sample_lobe(roughnesses[i]);
            for k in 0..2 {
                looked_up[k][i] = brdf.value[k];
                looked_up[2 + k][i] = brdf.by_cosine[k];
                looked_up[4 + k][i] = brdf.by_roughness[k];
            }
            for l in 0..BANDS {
                looked_up[6 + l][i] = lobe[l];
                looked_up[6 + BANDS + l][i] = slope[l];
            }
        }
        let table = |k: usize| Wide::<V>::load(&looked_up[k]);
        Surface {
            albedo: [get(channel::ALBEDO), get(channel::ALBEDO + 1), get(channel::ALBEDO + 2)],
            normal,
            inverse_length,
            view,
            facing,
            mirrored,
            alpha,
            inverse_alpha,
            roughness,
            reflectance,
            shaded,
            lobe: [
                each(
                    #[inline(always)]
                    |l: usize| table(6 + l),
                ),
                each(
                    #[inline(always)]
                    |l: usize| table(6 + BANDS + l),
                ),
            ],
            brdf: [[table(0), table(1)], [table(2), table(3)], [table(4), table(5)]],
        }
    }
}

/// Positive light and its slope.
#[inline(always)]
fn positive<V: Lanes>(x: Wide<V>) -> (Wide<V>, Wide<V>) {
    let root = (x * x + LIGHT_SOFTNESS * LIGHT_SOFTNESS).sqrt();
    ((x + root) * 0.5, (x * root.recip() + 1.0) * 0.5)
}

/// The two lights of a surface, before they are made positive, and the harmonics they came from.
struct Lit<V: Lanes> {
    diffuse: [Wide<V>; 3],
    specular: [Wide<V>; 3],
    at_normal: [Wide<V>; COUNT],
    at_mirrored: [Wide<V>; COUNT],
}

/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn light_up<V: Lanes>(surface: &Surface<V>, light: &Light) -> Lit<V> {
    // SAFETY: V's features are here by contract.
    let zero = unsafe { Wide::<V>::splat(0.0) };
    let (at_normal, mut at_mirrored) = (basis(surface.normal), basis(surface.mirrored));
    let (mut diffuse, mut specular) = ([zero; 3], [zero; 3]);
    for i in 0..COUNT {
        at_mirrored[i] = at_mirrored[i] * surface.lobe[0][BAND_OF[i]];
        for c in 0..3 {
            diffuse[c] = at_normal[i].scale_add(light.diffuse[i][c], diffuse[c]);
            specular[c] = at_mirrored[i].scale_add(light.radiance[i][c], specular[c]);
        }
    }
    Lit { diffuse, specular, at_normal, at_mirrored }
}

/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn forward_lanes<V: Lanes>(block: &Block<INPUTS>, light: &Light, tables: &Tables, rgb: &mut Block<3>) {
    for from in (0..MAX_LANES).step_by(V::N) {
        // SAFETY: V::N divides MAX_LANES; V's features are here by contract.
        unsafe {
            let s = surface::<V>(block, tables, from);
            let lit = light_up(&s, light);
            let f0 = s.reflectance.clamp(0.0, 1.0);
            let k = f0 * s.brdf[0][0] + (f0 * GRAZING_GAIN).clamp(0.0, 1.0) * s.brdf[0][1];
            let kept = (-k + 1.0) * s.shaded;
            let mirrored = k * s.alpha * s.shaded;
            for c in 0..3 {
                let (diffuse, specular) = (positive(lit.diffuse[c]).0, positive(lit.specular[c]).0);
                let value = (s.albedo[c] * kept).mul_add(diffuse, mirrored * specular);
                value.0.store(rgb[c].as_mut_ptr().add(from));
            }
        }
    }
}

/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn backward_lanes<V: Lanes>(
    block: &Block<INPUTS>,
    light: &Light,
    tables: &Tables,
    rgb: &Block<3>,
    out: &mut Block<OUTPUTS>,
    on_light: &mut [Block<3>; COUNT],
) {
    for from in (0..MAX_LANES).step_by(V::N) {
        // SAFETY: V::N divides MAX_LANES; V's features are here by contract.
        unsafe {
            let s = surface::<V>(block, tables, from);
            let lit = light_up(&s, light);
            let g: [Wide<V>; 3] = each(
                #[inline(always)]
                |c: usize| part::<V>(&rgb[c], from) * s.shaded,
            );
            let zero = Wide::<V>::splat(0.0);
            let f0 = s.reflectance.clamp(0.0, 1.0);
            let grazing = (f0 * GRAZING_GAIN).clamp(0.0, 1.0);
            let k = f0 * s.brdf[0][0] + grazing * s.brdf[0][1];
            let kept = -k + 1.0;
            let (mut on_k, mut on_alpha) = (zero, zero);
            let (mut on_diffuse, mut on_specular) = ([zero; 3], [zero; 3]);
            for c in 0..3 {
                let ((diffuse, diffuse_slope), (specular, specular_slope)) =
                    (positive(lit.diffuse[c]), positive(lit.specular[c]));
                let on_albedo = diffuse * kept * g[c];
                on_albedo.0.store(out[channel::ALBEDO + c].as_mut_ptr().add(from));
                on_diffuse[c] = s.albedo[c] * kept * g[c] * diffuse_slope;
                on_specular[c] = s.alpha * k * g[c] * specular_slope;
                on_k = on_k + (s.alpha * specular - s.albedo[c] * diffuse) * g[c];
                on_alpha = on_alpha + k * specular * g[c];
            }
            // Light coefficients, and the weights of the harmonics' gradients at n and ρ.
            let (mut at_n, mut at_rho, mut on_lobe) = ([zero; COUNT], [zero; COUNT], [zero; BANDS]);
            for i in 0..COUNT {
                let band = BAND_OF[i];
                let cosine = lit.at_normal[i] * COSINE_BANDS[band];
                for c in 0..3 {
                    let lanes = on_light[i][c].as_mut_ptr().add(from);
                    let sum = cosine.mul_add(on_diffuse[c], Wide(V::load(lanes)));
                    lit.at_mirrored[i].mul_add(on_specular[c], sum).0.store(lanes);
                    at_n[i] = on_diffuse[c].scale_add(light.diffuse[i][c], at_n[i]);
                    at_rho[i] = on_specular[c].scale_add(light.radiance[i][c], at_rho[i]);
                }
            }
            // The lobe's shares were multiplied into the harmonics; undo by taking the bare ones once more.
            let bare = basis(s.mirrored);
            for i in 0..COUNT {
                on_lobe[BAND_OF[i]] = bare[i].mul_add(at_rho[i], on_lobe[BAND_OF[i]]);
                at_rho[i] = at_rho[i] * s.lobe[0][BAND_OF[i]];
            }
            let (mut on_normal, on_mirrored) = (gradient(s.normal, &at_n), gradient(s.mirrored, &at_rho));
            // n·v reaches the table where it is not held, and the mirrored direction everywhere.
            let by_cosine = on_k * (f0 * s.brdf[1][0] + grazing * s.brdf[1][1]) * s.facing.inside(COSINE_MIN, 1.0);
            let on_facing = by_cosine + dot(s.normal, on_mirrored) * 2.0;
            for i in 0..3 {
                on_normal[i] = on_normal[i] + on_mirrored[i] * s.facing * 2.0 + s.view[i] * on_facing;
            }
            let mut by_roughness = on_k * (f0 * s.brdf[2][0] + grazing * s.brdf[2][1]);
            for (slope, on_lobe) in s.lobe[1].iter().zip(on_lobe) {
                by_roughness = slope.mul_add(on_lobe, by_roughness);
            }
            let on_f0 = on_k * (s.brdf[0][0] + s.brdf[0][1] * GRAZING_GAIN * (f0 * GRAZING_GAIN).inside(-1.0, 1.0));
            let on_roughness = by_roughness * s.roughness.inside(0.0, 1.0) * s.inverse_alpha;
            let on_reflectance = on_f0 * s.reflectance.inside(0.0, 1.0) * s.inverse_alpha;
            on_alpha = on_alpha - on_roughness * s.roughness - on_reflectance * s.reflectance;
            let along = dot(s.normal, on_normal);
            for i in 0..3 {
                let value = (on_normal[i] - s.normal[i] * along) * s.inverse_length * s.shaded;
                value.0.store(out[channel::NORMAL + i].as_mut_ptr().add(from));
            }
            (on_roughness * s.shaded).0.store(out[channel::ROUGHNESS].as_mut_ptr().add(from));
            (on_reflectance * s.shaded).0.store(out[channel::REFLECTANCE].as_mut_ptr().add(from));
            (-on_alpha * s.shaded).0.store(out[DEFERRED_CHANNELS].as_mut_ptr().add(from));
        }
    }
}

dispatched! {
    fn forward_block(block: &Block<INPUTS>, light: &Light, tables: &Tables, rgb: &mut Block<3>) = forward_lanes;
}
dispatched! {
    fn backward_block(block: &Block<INPUTS>, light: &Light, tables: &Tables, rgb: &Block<3>, out: &mut Block<OUTPUTS>, on_light: &mut [Block<3>; COUNT]) = backward_lanes;
}
