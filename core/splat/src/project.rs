//! EWA projection of Gaussians to the picture, and its derivative, in lane code. Twin of `reference/project.rs`.
//!
//! The 2-D covariance `Σ = A·Aᵀ + ℓ·I` (A = J·W·R·S, 2×3, ℓ the low-pass) is kept as the conditional form
//! `p(dx, dy) = −½·(dx − s·dy)²/v − ½·e·dy²` with `e = 1/Σyy`, `s = Σxy/Σyy`, `v = det Σ/Σyy`: a picture row is then one
//! parabola. `det Σ` is summed from squares (Cauchy–Binet), so needles and pancakes lose no digits.
//! Pixels; camera frame x right, y down, z forward. After Zwicker et al. 2001 and Kerbl et al. 2023.

use crate::gaussians::Gaussians;
use crate::lanes::wide::{Wide, dot, each};
use crate::lanes::{Lanes, MAX_LANES, dispatched};
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

    fn is_usable(&self) -> bool {
        self.variance > 0.0
            && self.variance.is_finite()
            && self.shear.is_finite()
            && self.precision_y > 0.0
            && self.mean.iter().all(|m| m.is_finite())
            && self.extent().iter().all(|m| m.is_finite())
    }
}

/// Gradients of a loss with respect to a [`Splat`]'s geometry.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SplatGradient {
    pub mean: [f32; 2],
    pub variance: f32,
    pub shear: f32,
    pub precision_y: f32,
    pub depth: f32,
}

/// Gradients of one Gaussian's geometry.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct GeometryGradient {
    pub mean: [f32; 3],
    pub scale: [f32; 3],
    pub rotation: [f32; 4],
}

/// What projection needs of a camera, prepared once.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View {
    /// Rotation camera-from-world, row by row.
    rows: [[f32; 3]; 3],
    translation: [f32; 3],
    focal: [f32; 2],
    principal: [f32; 2],
    /// Bounds on x/z and y/z inside the Jacobian.
    low: [f32; 2],
    high: [f32; 2],
    near: f32,
    low_pass: f32,
}

impl View {
    pub fn new(camera: &Camera, options: &RasterOptions) -> Self {
        let (focal, principal) = (camera.focal_px, camera.principal_px);
        let size = [camera.width as f32, camera.height as f32];
        let margin = [0, 1].map(|k| FRUSTUM_MARGIN * 0.5 * size[k] / focal[k]);
        Self {
            rows: [0, 1, 2].map(|r| [0, 1, 2].map(|c| camera.rotation[c][r])),
            translation: camera.translation,
            focal,
            principal,
            low: [0, 1].map(|k| -principal[k] / focal[k] - margin[k]),
            high: [0, 1].map(|k| (size[k] - principal[k]) / focal[k] + margin[k]),
            near: options.near_metres.max(1e-6),
            low_pass: options.low_pass_px2.max(1e-4),
        }
    }
}

/// Values of up to `MAX_LANES` Gaussians, by kind.
type Block<const K: usize> = [[f32; MAX_LANES]; K];
/// Mean 3, scale 3, rotation 4, opacity.
const INPUTS: usize = 11;
/// Centre 2, depth, variance, shear, precision, reach.
const PROJECTED: usize = 7;
/// Centre 2, variance, shear, precision, depth; then the splat's shear and precision.
const UPSTREAM: usize = 8;
/// Mean 3, scale 3, rotation 4.
const GRADIENTS: usize = 10;

fn read_block(gaussians: &Gaussians, indices: &[u32]) -> Block<INPUTS> {
    let mut block = [[0.0; MAX_LANES]; INPUTS];
    for (lane, &i) in indices.iter().enumerate() {
        let i = i as usize;
        for k in 0..3 {
            block[k][lane] = gaussians.means[i][k];
            block[3 + k][lane] = gaussians.scales[i][k];
        }
        for k in 0..4 {
            block[6 + k][lane] = gaussians.rotations[i][k];
        }
        block[10][lane] = gaussians.opacities[i];
    }
    block
}

/// Projects the Gaussians of a range and gives those that can be seen; one that has an attribute that makes no Gaussian
/// cannot.
pub(crate) fn project(
    view: &View,
    gaussians: &Gaussians,
    range: std::ops::Range<usize>,
    found: &mut Vec<(u32, Splat)>,
) {
    let mut indices = [0u32; MAX_LANES];
    for first in range.clone().step_by(MAX_LANES) {
        let count = MAX_LANES.min(range.end - first);
        for (lane, index) in indices[..count].iter_mut().enumerate() {
            *index = (first + lane) as u32;
        }
        let block = read_block(gaussians, &indices[..count]);
        let mut out = [[0.0; MAX_LANES]; PROJECTED];
        project_block(view, &block, &mut out);
        for lane in 0..count {
            let get = |k: usize| block[k][lane];
            // NaN fails the comparisons.
            let drawable = get(10) >= ALPHA_MIN
                && (0..10).all(|k| get(k).is_finite())
                && (3..6).all(|k| get(k) >= 0.0)
                && out[2][lane] > view.near
                && out[2][lane].is_finite();
            let splat = Splat {
                mean: [out[0][lane], out[1][lane]],
                depth: out[2][lane],
                variance: out[3][lane],
                shear: out[4][lane],
                precision_y: out[5][lane],
                opacity: get(10).min(1.0),
                reach: out[6][lane],
            };
            if drawable && splat.is_usable() {
                found.push((indices[lane], splat));
            }
        }
    }
}

/// Gradients of up to `MAX_LANES` Gaussians' geometry from those of their splats.
pub(crate) fn project_backward(
    view: &View,
    gaussians: &Gaussians,
    indices: &[u32],
    splats: &[(Splat, SplatGradient)],
    out: &mut [GeometryGradient; MAX_LANES],
) {
    let block = read_block(gaussians, indices);
    let mut upstream = [[0.0; MAX_LANES]; UPSTREAM];
    for (lane, (splat, g)) in splats.iter().enumerate() {
        let values =
            [g.mean[0], g.mean[1], g.variance, g.shear, g.precision_y, g.depth, splat.shear, splat.precision_y];
        for (row, value) in upstream.iter_mut().zip(values) {
            row[lane] = value;
        }
    }
    let mut gradients = [[0.0; MAX_LANES]; GRADIENTS];
    backward_block(view, &block, &upstream, &mut gradients);
    for (lane, out) in out.iter_mut().enumerate().take(indices.len()) {
        let get = |k: usize| gradients[k][lane];
        *out = GeometryGradient {
            mean: [get(0), get(1), get(2)],
            scale: [get(3), get(4), get(5)],
            rotation: [get(6), get(7), get(8), get(9)],
        };
    }
}

type Vector<V> = [Wide<V>; 3];

/// Everything between a Gaussian and its 2-D covariance.
struct Factors<V: Lanes> {
    in_camera: Vector<V>,
    inverse_z: Wide<V>,
    scale: Vector<V>,
    /// Unit quaternion, and one over the given one's norm (0 where it counts as the identity).
    unit: [Wide<V>; 4],
    inverse_norm: Wide<V>,
    /// Local axes in the world.
    axes: [Vector<V>; 3],
    /// Rows of J·W.
    t: [Vector<V>; 2],
    /// Rows of A = J·W·R·S.
    a: [Vector<V>; 2],
    /// x/z and y/z, and as the Jacobian uses them.
    free: [Wide<V>; 2],
    slope: [Wide<V>; 2],
}

/// # Safety
/// Inside a function with the features of `V`; `from + V::N ≤ MAX_LANES`.
#[inline(always)]
unsafe fn factors<V: Lanes>(view: &View, block: &Block<INPUTS>, from: usize) -> Factors<V> {
    // SAFETY: the caller's contract.
    let get = |k: usize| Wide(unsafe { V::load(block[k].as_ptr().add(from)) });
    let (mean, scale) = ([get(0), get(1), get(2)], [get(3), get(4), get(5)]);
    let in_camera = each(
        #[inline(always)]
        |r| {
            let [x, y, z] = view.rows[r];
            mean[0] * x + mean[1] * y + mean[2] * z + view.translation[r]
        },
    );
    let inverse_z = in_camera[2].recip();
    // SAFETY: as above.
    let (unit, inverse_norm) = unsafe { unit_quaternion([get(6), get(7), get(8), get(9)]) };
    let axes = rotation_columns(unit);
    let free = [in_camera[0] * inverse_z, in_camera[1] * inverse_z];
    let slope = each(
        #[inline(always)]
        |k: usize| free[k].clamp(view.low[k], view.high[k]),
    );
    let t: [Vector<V>; 2] = each(
        #[inline(always)]
        |k: usize| {
            let scaled = inverse_z * view.focal[k];
            // SAFETY: as above.
            each(
                #[inline(always)]
                |c: usize| scaled * (unsafe { Wide::splat(view.rows[k][c]) } - slope[k] * view.rows[2][c]),
            )
        },
    );
    let a = each(
        #[inline(always)]
        |k: usize| {
            each(
                #[inline(always)]
                |j: usize| scale[j] * dot(axes[j], t[k]),
            )
        },
    );
    Factors { in_camera, inverse_z, scale, unit, inverse_norm, axes, t, a, free, slope }
}

/// The normalised quaternion and one over the given norm; the identity and 0 where there is no direction.
///
/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn unit_quaternion<V: Lanes>(q: [Wide<V>; 4]) -> ([Wide<V>; 4], Wide<V>) {
    let largest = q[0].abs().max(q[1].abs()).max(q[2].abs().max(q[3].abs()));
    let usable = largest.inside(QUATERNION_MIN, f32::MAX);
    // Scaled first, so that neither large nor small norms leave the range.
    let by_largest = largest.clamp(QUATERNION_MIN, f32::MAX).recip();
    let q: [Wide<V>; 4] = each(
        #[inline(always)]
        |k: usize| q[k] * by_largest,
    );
    let norm2 = q[0].mul_add(q[0], q[1].mul_add(q[1], q[2].mul_add(q[2], q[3] * q[3])));
    let inverse = norm2.sqrt().recip();
    let unit: [Wide<V>; 4] = each(
        #[inline(always)]
        |k: usize| q[k] * inverse,
    );
    // SAFETY: the caller's contract.
    let (one, zero) = unsafe { (Wide::splat(1.0), Wide::splat(0.0)) };
    let unit = [
        Wide::pick(usable, unit[0], one),
        Wide::pick(usable, unit[1], zero),
        Wide::pick(usable, unit[2], zero),
        Wide::pick(usable, unit[3], zero),
    ];
    (unit, Wide::pick(usable, by_largest * inverse, zero))
}

#[inline(always)]
fn rotation_columns<V: Lanes>([w, x, y, z]: [Wide<V>; 4]) -> [Vector<V>; 3] {
    let diagonal = |a: Wide<V>, b: Wide<V>| (a * a + b * b) * -2.0 + 1.0;
    let (xy, xz, yz, wx, wy, wz) = (x * y, x * z, y * z, w * x, w * y, w * z);
    [
        [diagonal(y, z), (xy + wz) * 2.0, (xz - wy) * 2.0],
        [(xy - wz) * 2.0, diagonal(x, z), (yz + wx) * 2.0],
        [(xz + wy) * 2.0, (yz - wx) * 2.0, diagonal(x, y)],
    ]
}

#[inline(always)]
fn cross<V: Lanes>(a: Vector<V>, b: Vector<V>) -> Vector<V> {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn project_lanes<V: Lanes>(view: &View, block: &Block<INPUTS>, out: &mut Block<PROJECTED>) {
    for from in (0..MAX_LANES).step_by(V::N) {
        // SAFETY: V::N divides MAX_LANES; V's features are here by contract.
        unsafe {
            let f = factors::<V>(view, block, from);
            let (xx, yy, xy) = (dot(f.a[0], f.a[0]), dot(f.a[1], f.a[1]), dot(f.a[0], f.a[1]));
            let area = cross(f.a[0], f.a[1]);
            let det = dot(area, area) + (xx + yy + view.low_pass) * view.low_pass;
            let precision = (yy + view.low_pass).recip();
            let opacity = Wide(V::load(block[10].as_ptr().add(from))).clamp(ALPHA_MIN, 1.0);
            let reach = (opacity * 255.0).log2() * (2.0 * std::f32::consts::LN_2);
            let values = [
                f.free[0] * view.focal[0] + view.principal[0],
                f.free[1] * view.focal[1] + view.principal[1],
                f.in_camera[2],
                det * precision,
                xy * precision,
                precision,
                reach,
            ];
            for (row, value) in out.iter_mut().zip(values) {
                value.0.store(row.as_mut_ptr().add(from));
            }
        }
    }
}

/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn backward_lanes<V: Lanes>(
    view: &View,
    block: &Block<INPUTS>,
    upstream: &Block<UPSTREAM>,
    out: &mut Block<GRADIENTS>,
) {
    for from in (0..MAX_LANES).step_by(V::N) {
        // SAFETY: V::N divides MAX_LANES; V's features are here by contract.
        unsafe {
            let f = factors::<V>(view, block, from);
            let get = |k: usize| Wide(V::load(upstream[k].as_ptr().add(from)));
            let (on_mean, gv, gs, ge, on_depth) = ([get(0), get(1)], get(2), get(3), get(4), get(5));
            // v = Σxx − Σxy²/Σyy, s = Σxy/Σyy, e = 1/Σyy.
            let (s, e) = (get(6), get(7));
            let (gxx, gxy, gyy) = (gv, e * gs - s * gv * 2.0, s * s * gv - s * e * gs - e * e * ge);
            let zero = Wide::splat(0.0);
            let mut on_a = [[zero; 3]; 2];
            for j in 0..3 {
                on_a[0][j] = gxx * f.a[0][j] * 2.0 + gxy * f.a[1][j];
                on_a[1][j] = gyy * f.a[1][j] * 2.0 + gxy * f.a[0][j];
            }
            // A's column j is s_j·(T·axis_j).
            let (mut on_scale, mut on_axes, mut on_t) = ([zero; 3], [[zero; 3]; 3], [[zero; 3]; 2]);
            for j in 0..3 {
                let column: Vector<V> = each(
                    #[inline(always)]
                    |c: usize| f.t[0][c] * on_a[0][j] + f.t[1][c] * on_a[1][j],
                );
                on_scale[j] = dot(f.axes[j], column);
                on_axes[j] = each(
                    #[inline(always)]
                    |c: usize| column[c] * f.scale[j],
                );
                for (row, on_a) in on_t.iter_mut().zip(&on_a) {
                    let share = f.scale[j] * on_a[j];
                    for (t, axis) in row.iter_mut().zip(f.axes[j]) {
                        *t = share.mul_add(axis, *t);
                    }
                }
            }
            let on_camera = camera_gradient(view, &f, on_mean, on_depth, on_t);
            let on_world: Vector<V> = each(
                #[inline(always)]
                |c: usize| {
                    on_camera[0] * view.rows[0][c] + on_camera[1] * view.rows[1][c] + on_camera[2] * view.rows[2][c]
                },
            );
            let on_rotation = rotation_gradient(f.unit, f.inverse_norm, &on_axes);
            for (row, value) in out.iter_mut().zip(on_world.into_iter().chain(on_scale).chain(on_rotation)) {
                value.0.store(row.as_mut_ptr().add(from));
            }
        }
    }
}

/// Gradient of the camera-space centre, through the projected centre, the Jacobian's rows and the depth.
#[inline(always)]
fn camera_gradient<V: Lanes>(
    view: &View,
    f: &Factors<V>,
    on_mean: [Wide<V>; 2],
    on_depth: Wide<V>,
    on_t: [Vector<V>; 2],
) -> Vector<V> {
    let mut out = [on_depth; 3];
    for k in 0..2 {
        let in_camera =
            |c: usize| on_t[k][0] * view.rows[c][0] + on_t[k][1] * view.rows[c][1] + on_t[k][2] * view.rows[c][2];
        let (on_diagonal, on_last) = (in_camera(k), in_camera(2));
        let scaled = f.inverse_z * view.focal[k];
        // Row k of J: f/z at column k, −(f/z)·slope at column 2; the slope is free between its bounds.
        let on_slope = -(scaled * on_last) * f.free[k].within(view.low[k], view.high[k]);
        let on_free = on_mean[k] * view.focal[k] + on_slope;
        out[k] = on_free * f.inverse_z;
        out[2] =
            out[2] - on_free * f.free[k] * f.inverse_z + (on_last * f.slope[k] - on_diagonal) * scaled * f.inverse_z;
    }
    out
}

/// Gradient of the given quaternion from that of its rotation matrix' columns.
#[inline(always)]
fn rotation_gradient<V: Lanes>([w, x, y, z]: [Wide<V>; 4], inverse_norm: Wide<V>, d: &[Vector<V>; 3]) -> [Wide<V>; 4] {
    let m = |row: usize, column: usize| d[column][row];
    let (twist_x, twist_y, twist_z) = (m(2, 1) - m(1, 2), m(0, 2) - m(2, 0), m(1, 0) - m(0, 1));
    let (mix_xy, mix_xz, mix_yz) = (m(0, 1) + m(1, 0), m(0, 2) + m(2, 0), m(1, 2) + m(2, 1));
    let half = [
        x * twist_x + y * twist_y + z * twist_z,
        x * (m(1, 1) + m(2, 2)) * -2.0 + y * mix_xy + z * mix_xz + w * twist_x,
        x * mix_xy - y * (m(0, 0) + m(2, 2)) * 2.0 + z * mix_yz + w * twist_y,
        x * mix_xz + y * mix_yz - z * (m(0, 0) + m(1, 1)) * 2.0 + w * twist_z,
    ];
    let unit: [Wide<V>; 4] = each(
        #[inline(always)]
        |k: usize| half[k] * 2.0,
    );
    let along = w * unit[0] + x * unit[1] + y * unit[2] + z * unit[3];
    let q = [w, x, y, z];
    each(
        #[inline(always)]
        |k: usize| (unit[k] - q[k] * along) * inverse_norm,
    )
}

dispatched! { fn project_block(view: &View, block: &Block<INPUTS>, out: &mut Block<PROJECTED>) = project_lanes; }
dispatched! { fn backward_block(view: &View, block: &Block<INPUTS>, upstream: &Block<UPSTREAM>, out: &mut Block<GRADIENTS>) = backward_lanes; }
