//! EWA projection of a Gaussian to the picture, and its derivative. Twin of `reference/project.rs`.
//!
//! The 2-D covariance `Σ = A·Aᵀ + ℓ·I` (A = J·W·R·S, 2×3, ℓ the low-pass) is kept as the conditional form
//! `p(dx, dy) = −½·(dx − s·dy)²/v − ½·e·dy²` with `e = 1/Σyy`, `s = Σxy/Σyy`, `v = det Σ/Σyy`: a picture row is then one
//! parabola. `det Σ` is summed from squares (Cauchy–Binet), so needles and pancakes lose no digits.
//! Pixels; camera frame x right, y down, z forward. After Zwicker et al. 2001 and Kerbl et al. 2023.

use crate::gaussians::Gaussians;
use glam::{Mat3, Quat, Vec2, Vec3};
use heartian_space::Camera;

/// How the rasteriser treats a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RasterOptions {
    /// Gaussians whose centre is not farther than this along the view axis are left out, metres.
    pub near_metres: f32,
    /// Added to both variances in the picture, square pixels.
    pub low_pass_px2: f32,
    /// Whether the camera-space depth `z` is composited too, as one more channel (its gradient goes to the means).
    pub depth: bool,
}

impl Default for RasterOptions {
    fn default() -> Self {
        Self { near_metres: 0.05, low_pass_px2: 0.3, depth: false }
    }
}

/// Smallest alpha that is composited.
pub(crate) const ALPHA_MIN: f32 = 1.0 / 255.0;
/// Largest alpha: keeps `1/(1−α)` at most 100.
pub(crate) const ALPHA_MAX: f32 = 0.99;
/// A pixel is finished before its transmittance falls below this.
pub(crate) const TRANSMITTANCE_MIN: f32 = 1e-4;
/// Directions outside the picture by more than this share of its half-angle tangent are held there in the Jacobian.
pub(crate) const FRUSTUM_MARGIN: f32 = 0.3;
/// Quaternions shorter than this count as the identity and get no gradient.
pub(crate) const QUATERNION_MIN: f32 = 1e-12;

/// A projected Gaussian.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Splat {
    /// Projected centre, pixels.
    pub mean: [f32; 2],
    /// Camera-space z, metres.
    pub depth: f32,
    /// `v`: variance in x at fixed y.
    pub variance: f32,
    /// `s`: shift in x of a row's centre a pixel of y.
    pub shear: f32,
    /// `e = 1/Σyy`.
    pub precision_y: f32,
    /// Opacity in (0, 1].
    pub opacity: f32,
    /// `2·ln(255·opacity)`: where −2p exceeds it, alpha is below 1/255.
    pub reach: f32,
}

impl Splat {
    /// Half-width and half-height in the picture of the region with alpha ≥ 1/255, pixels.
    pub fn extent(&self) -> [f32; 2] {
        let variance_y = 1.0 / self.precision_y;
        let variance_x = self.variance + self.shear * self.shear * variance_y;
        [(self.reach * variance_x).sqrt(), (self.reach * variance_y).sqrt()]
    }
}

/// Gradients of a loss with respect to a [`Splat`]'s geometry.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SplatGradient {
    pub mean: Vec2,
    pub variance: f32,
    pub shear: f32,
    pub precision_y: f32,
    pub depth: f32,
}

/// Gradients of one Gaussian's geometry.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct GeometryGradient {
    pub mean: Vec3,
    pub scale: Vec3,
    pub rotation: [f32; 4],
}

/// What projection needs of a camera, prepared once.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View {
    camera_from_world: Mat3,
    translation: Vec3,
    focal: Vec2,
    principal: Vec2,
    /// Bounds on x/z and y/z inside the Jacobian.
    low: Vec2,
    high: Vec2,
    near: f32,
    low_pass: f32,
}

impl View {
    pub fn new(camera: &Camera, options: &RasterOptions) -> Self {
        let focal = Vec2::from_array(camera.focal_px);
        let principal = Vec2::from_array(camera.principal_px);
        let size = Vec2::new(camera.width as f32, camera.height as f32);
        let margin = FRUSTUM_MARGIN * 0.5 * size / focal;
        Self {
            camera_from_world: camera.camera_from_world_rotation(),
            translation: Vec3::from_array(camera.translation),
            focal,
            principal,
            low: -principal / focal - margin,
            high: (size - principal) / focal + margin,
            near: options.near_metres.max(1e-6),
            low_pass: options.low_pass_px2.max(1e-4),
        }
    }
}

/// Everything between a Gaussian and its 2-D covariance.
struct Factors {
    in_camera: Vec3,
    /// Unit quaternion's rotation, columns are the local axes in the world.
    axes: Mat3,
    /// Rows of J·W.
    t: [Vec3; 2],
    /// Rows of A = J·W·R·S.
    a: [Vec3; 2],
    /// x/z and y/z as the Jacobian uses them, and whether each was held at its bound.
    slope: Vec2,
    held: [bool; 2],
}

fn factors(view: &View, mean: Vec3, scale: Vec3, rotation: [f32; 4]) -> Factors {
    let p = view.camera_from_world * mean + view.translation;
    let axes = Mat3::from_quat(unit_quaternion(rotation).0);
    let free = Vec2::new(p.x, p.y) / p.z;
    let slope = free.clamp(view.low, view.high);
    let w = view.camera_from_world.transpose();
    let f = view.focal / p.z;
    let t = [w * Vec3::new(f.x, 0.0, -f.x * slope.x), w * Vec3::new(0.0, f.y, -f.y * slope.y)];
    let local = axes.transpose();
    let a = [(local * t[0]) * scale, (local * t[1]) * scale];
    Factors { in_camera: p, axes, t, a, slope, held: [slope.x != free.x, slope.y != free.y] }
}

/// The normalised quaternion and the given norm; the identity and 0 when there is no direction to normalise.
fn unit_quaternion([w, x, y, z]: [f32; 4]) -> (Quat, f32) {
    let largest = w.abs().max(x.abs()).max(y.abs()).max(z.abs());
    if !(largest > QUATERNION_MIN && largest.is_finite()) {
        return (Quat::IDENTITY, 0.0);
    }
    let q = glam::Vec4::new(x, y, z, w) / largest;
    let norm = q.length();
    (Quat::from_vec4(q / norm), norm * largest)
}

/// Projects Gaussian `i`; `None` when it cannot be seen or has an attribute that makes no Gaussian.
pub(crate) fn project(view: &View, gaussians: &Gaussians, i: usize) -> Option<Splat> {
    let opacity = gaussians.opacities[i].min(1.0);
    let (mean, scale) = (Vec3::from_array(gaussians.means[i]), Vec3::from_array(gaussians.scales[i]));
    // A NaN opacity fails the first test: `min` would have made it 1, so it is asked before.
    let drawable =
        gaussians.opacities[i] >= ALPHA_MIN && mean.is_finite() && scale.is_finite() && scale.min_element() >= 0.0;
    if !drawable || gaussians.rotations[i].iter().any(|q| !q.is_finite()) {
        return None;
    }
    let f = factors(view, mean, scale, gaussians.rotations[i]);
    if !(f.in_camera.z > view.near && f.in_camera.z.is_finite()) {
        return None;
    }
    let [r0, r1] = f.a;
    let (xx, yy, xy) = (r0.length_squared(), r1.length_squared(), r0.dot(r1));
    let det = r0.cross(r1).length_squared() + view.low_pass * (xx + yy) + view.low_pass * view.low_pass;
    let yy = yy + view.low_pass;
    let splat = Splat {
        mean: (view.focal * Vec2::new(f.in_camera.x, f.in_camera.y) / f.in_camera.z + view.principal).to_array(),
        depth: f.in_camera.z,
        variance: det / yy,
        shear: xy / yy,
        precision_y: 1.0 / yy,
        opacity,
        reach: 2.0 * (255.0 * opacity).ln(),
    };
    let usable = splat.variance > 0.0
        && splat.variance.is_finite()
        && splat.shear.is_finite()
        && splat.precision_y > 0.0
        && splat.mean.iter().all(|m| m.is_finite())
        && splat.extent().iter().all(|m| m.is_finite());
    usable.then_some(splat)
}

/// Gradients of Gaussian `i`'s geometry from those of its [`Splat`].
pub(crate) fn project_backward(
    view: &View,
    gaussians: &Gaussians,
    i: usize,
    splat: &Splat,
    gradient: &SplatGradient,
) -> GeometryGradient {
    let (mean, scale) = (Vec3::from_array(gaussians.means[i]), Vec3::from_array(gaussians.scales[i]));
    let f = factors(view, mean, scale, gaussians.rotations[i]);
    // v = Σxx − Σxy²/Σyy, s = Σxy/Σyy, e = 1/Σyy.
    let (s, e) = (splat.shear, splat.precision_y);
    let (gv, gs, ge) = (gradient.variance, gradient.shear, gradient.precision_y);
    let (gxx, gxy, gyy) = (gv, -2.0 * s * gv + e * gs, s * s * gv - s * e * gs - e * e * ge);
    let ga = [2.0 * gxx * f.a[0] + gxy * f.a[1], 2.0 * gyy * f.a[1] + gxy * f.a[0]];
    // A's column j is s_j·(T·axis_j).
    let (mut grad_scale, mut grad_axes) = (Vec3::ZERO, Mat3::ZERO);
    let mut grad_t = [Vec3::ZERO; 2];
    for j in 0..3 {
        let axis = f.axes.col(j);
        let on_column = f.t[0] * ga[0][j] + f.t[1] * ga[1][j];
        grad_scale[j] = axis.dot(on_column);
        *grad_axes.col_mut(j) = scale[j] * on_column;
        for (row, g) in grad_t.iter_mut().zip(&ga) {
            *row += scale[j] * g[j] * axis;
        }
    }
    let grad_camera = camera_gradient(view, &f, gradient, grad_t.map(|row| view.camera_from_world * row));
    GeometryGradient {
        mean: view.camera_from_world.transpose() * grad_camera,
        scale: grad_scale,
        rotation: rotation_gradient(gaussians.rotations[i], &grad_axes),
    }
}

/// Gradient of the camera-space centre, through the projected centre, the Jacobian's rows and the depth.
fn camera_gradient(view: &View, f: &Factors, gradient: &SplatGradient, grad_j: [Vec3; 2]) -> Vec3 {
    let p = f.in_camera;
    let inverse_z = 1.0 / p.z;
    let mut out = Vec3::new(0.0, 0.0, gradient.depth);
    for k in 0..2 {
        let scaled = view.focal[k] * inverse_z;
        let free = p[k] * inverse_z;
        out[k] += gradient.mean[k] * scaled;
        out.z -= gradient.mean[k] * scaled * free;
        // Row k of J: f/z at column k, −(f/z)·slope at column 2.
        out.z += (-grad_j[k][k] + grad_j[k].z * f.slope[k]) * scaled * inverse_z;
        if !f.held[k] {
            let on_slope = -scaled * grad_j[k].z;
            out[k] += on_slope * inverse_z;
            out.z -= on_slope * free * inverse_z;
        }
    }
    out
}

/// Gradient of the given quaternion from that of its rotation matrix (columns).
fn rotation_gradient(rotation: [f32; 4], d: &Mat3) -> [f32; 4] {
    let (q, norm) = unit_quaternion(rotation);
    if norm == 0.0 {
        return [0.0; 4];
    }
    let (w, x, y, z) = (q.w, q.x, q.y, q.z);
    let m = |row: usize, column: usize| d.col(column)[row];
    let unit = [
        2.0 * (x * (m(2, 1) - m(1, 2)) + y * (m(0, 2) - m(2, 0)) + z * (m(1, 0) - m(0, 1))),
        2.0 * (-2.0 * x * (m(1, 1) + m(2, 2))
            + y * (m(0, 1) + m(1, 0))
            + z * (m(0, 2) + m(2, 0))
            + w * (m(2, 1) - m(1, 2))),
        2.0 * (x * (m(0, 1) + m(1, 0)) - 2.0 * y * (m(0, 0) + m(2, 2))
            + z * (m(1, 2) + m(2, 1))
            + w * (m(0, 2) - m(2, 0))),
        2.0 * (x * (m(0, 2) + m(2, 0)) + y * (m(1, 2) + m(2, 1)) - 2.0 * z * (m(0, 0) + m(1, 1))
            + w * (m(1, 0) - m(0, 1))),
    ];
    let along = w * unit[0] + x * unit[1] + y * unit[2] + z * unit[3];
    [
        (unit[0] - w * along) / norm,
        (unit[1] - x * along) / norm,
        (unit[2] - y * along) / norm,
        (unit[3] - z * along) / norm,
    ]
}
