//! EWA projection of Gaussians to the picture, and its derivative, in lane code. Twin of `reference/project.rs`.
//!
//! The 2-D covariance `Σ = A·Aᵀ + ℓ·I` (A = J·W·R·S, 2×3, ℓ the low-pass) is kept as the conditional form
//! `p(dx, dy) = −½·(dx − s·dy)²/v − ½·e·dy²` with `e = 1/Σyy`, `s = Σxy/Σyy`, `v = det Σ/Σyy`: a picture row is then one
//! parabola. `det Σ` is summed from squares (Cauchy–Binet), so needles and pancakes lose no digits.
//! The centre and the depth are f64, for alpha's cut and the order of near splats feel their last digits.
//! Pixels; camera frame x right, y down, z forward. After Zwicker et al. 2001 and Kerbl et al. 2023.

mod backward;

pub(crate) use backward::{GeometryGradient, SplatGradient, project_backward};

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

/// A projected Gaussian; all zeros where it is not drawn.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Splat {
    /// Whole pixels of the projected centre.
    pub cell: [f32; 2],
    /// The rest of it, in [0, 1): apart, because a f32 of some hundred pixels is known to 3e-5 only, enough to move dozens
    /// of a picture's samples across the alpha cut.
    pub fraction: [f32; 2],
    /// Camera-space z, metres.
    pub depth: f32,
    /// `v`: variance in x at fixed y.
    pub variance: f32,
    /// `s`: shift in x of a row's centre a pixel of y.
    pub shear: f32,
    /// `e = 1/Σyy`.
    pub precision_y: f32,
    /// Opacity in (0, 1], and its base-2 logarithm.
    pub opacity: f32,
    pub log2_opacity: f32,
    /// `2·ln(255·opacity)`: where −2p exceeds it, alpha is below 1/255.
    pub reach: f32,
}

/// Base-2 logarithm of 255.
const LOG2_255: f32 = 7.994_353_4;

/// `2·ln(255·opacity)` from the opacity's base-2 logarithm.
#[inline(always)]
pub(crate) fn reach(log2_opacity: f32) -> f32 {
    (log2_opacity + LOG2_255) * (2.0 * std::f32::consts::LN_2)
}

impl Splat {
    /// Projected centre, pixels, as one number each.
    #[inline(always)]
    pub fn mean(&self) -> [f32; 2] {
        [self.cell[0] + self.fraction[0], self.cell[1] + self.fraction[1]]
    }

    /// Whether it is drawn.
    pub fn is_drawn(&self) -> bool {
        self.opacity > 0.0
    }

    /// Half-width and half-height in the picture of the region with alpha ≥ 1/255, pixels.
    #[inline(always)]
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
            && self.mean().iter().all(|m| m.is_finite())
            && self.extent().iter().all(|m| m.is_finite())
    }
}

/// What projection needs of a camera, prepared once.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View {
    /// Rotation camera-from-world, row by row.
    pub rows: [[f32; 3]; 3],
    pub translation: [f32; 3],
    pub focal: [f32; 2],
    pub principal: [f32; 2],
    /// Bounds on x/z and y/z inside the Jacobian.
    pub low: [f32; 2],
    pub high: [f32; 2],
    pub near: f32,
    pub low_pass: f32,
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
/// Variance, shear, precision, base-2 logarithm of the opacity.
const PROJECTED: usize = 4;
/// Whole pixels of the centre 2, the rest of it 2, depth.
const CENTRE: usize = 5;

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

/// Projects consecutive Gaussians from `first` on, as many as there are `splats`, and gives each a key that orders by
/// depth: the bits of its f64. One that cannot be seen, or has an attribute that makes no Gaussian, has key 0.
pub(crate) fn project(view: &View, gaussians: &Gaussians, first: usize, splats: &mut [Splat], keys: &mut [u64]) {
    let mut indices = [0u32; MAX_LANES];
    for (block_index, (splats, keys)) in splats.chunks_mut(MAX_LANES).zip(keys.chunks_mut(MAX_LANES)).enumerate() {
        for (lane, index) in indices[..splats.len()].iter_mut().enumerate() {
            *index = (first + block_index * MAX_LANES + lane) as u32;
        }
        let block = read_block(gaussians, &indices[..splats.len()]);
        let (mut out, mut centres) = ([[0.0; MAX_LANES]; PROJECTED], [[0.0; MAX_LANES]; CENTRE]);
        project_block(view, &block, &mut out);
        centre_block(view, &block, &mut centres);
        for (lane, (splat, key)) in splats.iter_mut().zip(keys).enumerate() {
            let get = |k: usize| block[k][lane];
            let depth = centres[4][lane];
            // NaN fails the comparisons.
            let drawable = get(10) >= ALPHA_MIN
                && (0..10).all(|k| get(k).is_finite())
                && (3..6).all(|k| get(k) >= 0.0)
                && depth > f64::from(view.near)
                && depth <= f64::from(f32::MAX);
            let projected = Splat {
                cell: [centres[0][lane] as f32, centres[1][lane] as f32],
                fraction: [centres[2][lane] as f32, centres[3][lane] as f32],
                depth: depth as f32,
                variance: out[0][lane],
                shear: out[1][lane],
                precision_y: out[2][lane],
                opacity: get(10).min(1.0),
                log2_opacity: out[3][lane],
                reach: reach(out[3][lane]),
            };
            (*splat, *key) = match drawable && projected.is_usable() {
                true => (projected, depth.to_bits()),
                false => (Splat::default(), 0),
            };
        }
    }
}

type Vector<V> = [Wide<V>; 3];

/// Everything between a Gaussian and its 2-D covariance.
struct Factors<V: Lanes> {
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
    let in_camera: Vector<V> = each(
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
    Factors { inverse_z, scale, unit, inverse_norm, axes, t, a, free, slope }
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
            let values = [det * precision, xy * precision, precision, opacity.log2()];
            for (row, value) in out.iter_mut().zip(values) {
                value.0.store(row.as_mut_ptr().add(from));
            }
        }
    }
}

/// Projected centres and depths in f64: a plain loop, which the compiler vectorises at each level.
///
/// # Safety
/// Inside a function with the features of `V`.
#[inline(always)]
unsafe fn centre_lanes<V: Lanes>(view: &View, block: &Block<INPUTS>, out: &mut [[f64; MAX_LANES]; CENTRE]) {
    for lane in 0..MAX_LANES {
        let mean = [f64::from(block[0][lane]), f64::from(block[1][lane]), f64::from(block[2][lane])];
        let mut in_camera = [0.0; 3];
        for (r, value) in in_camera.iter_mut().enumerate() {
            let row = view.rows[r];
            *value = f64::from(row[0]) * mean[0]
                + f64::from(row[1]) * mean[1]
                + f64::from(row[2]) * mean[2]
                + f64::from(view.translation[r]);
        }
        for k in 0..2 {
            let at = f64::from(view.focal[k]) * in_camera[k] / in_camera[2] + f64::from(view.principal[k]);
            let cell = at.floor();
            out[k][lane] = cell;
            out[2 + k][lane] = at - cell;
        }
        out[4][lane] = in_camera[2];
    }
}

dispatched! { fn project_block(view: &View, block: &Block<INPUTS>, out: &mut Block<PROJECTED>) = project_lanes; }
dispatched! { fn centre_block(view: &View, block: &Block<INPUTS>, out: &mut [[f64; MAX_LANES]; CENTRE]) = centre_lanes; }
