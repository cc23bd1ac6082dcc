//! The derivative of the projection, in lane code. Twin of `reference/composite.rs`' last step.
//!
//! Camera frame as in `project.rs`; gradients per pixel in, per metre and per unit of the given quaternion out.

use super::{Block, Factors, INPUTS, Splat, Vector, View, factors, read_block};
use crate::gaussians::Gaussians;
use crate::lanes::wide::{Wide, dot, each};
use crate::lanes::{Lanes, MAX_LANES, dispatched};

/// Centre 2, variance, shear, precision, depth; then the splat's shear and precision.
const UPSTREAM: usize = 8;
/// Mean 3, scale 3, rotation 4.
const GRADIENTS: usize = 10;

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

dispatched! { fn backward_block(view: &View, block: &Block<INPUTS>, upstream: &Block<UPSTREAM>, out: &mut Block<GRADIENTS>) = backward_lanes; }
