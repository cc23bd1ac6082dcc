//! Canonical Gaussians to one frame's world, and the exact way back.
//!
//! `x_e = x_c + Σ_k c_k B_k`, `T = Σ_j w̃_j A_j` with `w̃ = max(w, 0) / Σ max(w, 0)`, `x_w = T [x_e; 1]`, and the world
//! rotation is (unit quaternion of T's linear part) ⊗ (normalised canonical rotation); scales and opacities do not
//! depend on the pose. Metres throughout, so the baseline's free scale κ is absent. Sums over Gaussians are made in
//! fixed chunks and added in order: the result does not depend on the number of threads. The f64 text of the forward
//! half is `deform/reference.rs`.

#[cfg(test)]
mod reference;

use glam::{DMat4, DVec3};
use rayon::prelude::*;

use crate::canonical::Canonical;
use crate::rig::JOINTS;

/// Gaussians handled by one task; fixed, so that sums are associated the same way everywhere.
const CHUNK: usize = 512;
/// Smallest sum of clamped weights; below it a Gaussian does not move with any joint's weight.
const WEIGHT_FLOOR: f32 = 1e-6;

/// What moves the Gaussians in one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// World-from-canonical transform of each joint.
    pub joints: [DMat4; JOINTS],
    /// `K` motion coefficients.
    pub coefficients: Vec<f32>,
}

/// Gaussians in the world.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Deformed {
    /// `N×3`, metres.
    pub positions: Vec<f32>,
    /// `N×4`, unit quaternions (w, x, y, z).
    pub rotations: Vec<f32>,
}

/// Gradients with respect to what moves the Gaussians.
#[derive(Clone, Debug, PartialEq)]
pub struct MotionGradient {
    /// With respect to each joint transform; the last row is zero.
    pub joints: [DMat4; JOINTS],
    /// `K`.
    pub coefficients: Vec<f64>,
}

/// A 3×4 transform, rows.
type Affine = [[f32; 4]; 3];

fn affine(transform: &DMat4) -> Affine {
    std::array::from_fn(|row| std::array::from_fn(|column| transform.col(column)[row] as f32))
}

/// Everything the backward pass needs again of one Gaussian.
struct Local {
    expressed: [f32; 3],
    weights: [f32; JOINTS],
    weight_sum: f32,
    blended: Affine,
}

fn local(canonical: &Canonical, index: usize, joints: &[Affine; JOINTS], coefficients: &[f32]) -> Local {
    let mut expressed = canonical.position(index);
    let row = 3 * canonical.modes;
    let bases = canonical.bases[index * row..(index + 1) * row].as_chunks::<3>().0;
    for (basis, &coefficient) in bases.iter().zip(coefficients) {
        for axis in 0..3 {
            expressed[axis] += coefficient * basis[axis];
        }
    }
    let raw = &canonical.weights[index * JOINTS..(index + 1) * JOINTS];
    let mut weights: [f32; JOINTS] = std::array::from_fn(|j| raw[j].max(0.0));
    let weight_sum = weights.iter().sum::<f32>().max(WEIGHT_FLOOR);
    weights.iter_mut().for_each(|w| *w /= weight_sum);
    let mut blended = [[0.0; 4]; 3];
    for (weight, joint) in weights.iter().zip(joints) {
        for row in 0..3 {
            for column in 0..4 {
                blended[row][column] += weight * joint[row][column];
            }
        }
    }
    Local { expressed, weights, weight_sum, blended }
}

/// The four rows (one for each of x, y, z, w being largest) of the symmetric matrix that is `4qqᵀ` for a rotation;
/// columns x, y, z, w. Any non-zero row is parallel to the quaternion.
fn quaternion_row(m: &Affine) -> (usize, [f32; 4]) {
    let diagonal = [
        1.0 + m[0][0] - m[1][1] - m[2][2],
        1.0 - m[0][0] + m[1][1] - m[2][2],
        1.0 - m[0][0] - m[1][1] + m[2][2],
        1.0 + m[0][0] + m[1][1] + m[2][2],
    ];
    let chosen = (0..4).fold(3, |best, i| if diagonal[i] > diagonal[best] { i } else { best });
    let row = match chosen {
        0 => [diagonal[0], m[1][0] + m[0][1], m[2][0] + m[0][2], m[2][1] - m[1][2]],
        1 => [m[1][0] + m[0][1], diagonal[1], m[2][1] + m[1][2], m[0][2] - m[2][0]],
        2 => [m[2][0] + m[0][2], m[2][1] + m[1][2], diagonal[2], m[1][0] - m[0][1]],
        _ => [m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1], diagonal[3]],
    };
    (chosen, row)
}

/// Transpose of [`quaternion_row`]: adds the gradient of the chosen row to that of the matrix.
fn quaternion_row_backward(chosen: usize, g: [f32; 4], out: &mut Affine) {
    let [gx, gy, gz, gw] = g;
    let sign = |i: usize, c: usize| if i == c || c == 3 { 1.0 } else { -1.0 };
    let diagonal = [gx, gy, gz, gw][chosen];
    for i in 0..3 {
        out[i][i] += diagonal * sign(i, chosen);
    }
    let mut symmetric = |a: usize, b: usize, value: f32| {
        out[a][b] += value;
        out[b][a] += value;
    };
    match chosen {
        0 => (symmetric(0, 1, gy), symmetric(0, 2, gz)),
        1 => (symmetric(0, 1, gx), symmetric(1, 2, gz)),
        2 => (symmetric(0, 2, gx), symmetric(1, 2, gy)),
        _ => ((), ()),
    };
    let mut skew = |a: usize, b: usize, value: f32| {
        out[a][b] += value;
        out[b][a] -= value;
    };
    match chosen {
        0 => skew(2, 1, gw),
        1 => skew(0, 2, gw),
        2 => skew(1, 0, gw),
        _ => {
            skew(2, 1, gx);
            skew(0, 2, gy);
            skew(1, 0, gz);
        }
    }
}

/// Hamilton product, (w, x, y, z).
fn hamilton(a: [f32; 4], b: [f32; 4]) -> [f32; 4] {
    [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]
}

fn conjugate(q: [f32; 4]) -> [f32; 4] {
    [q[0], -q[1], -q[2], -q[3]]
}

/// Unit vector and length; a zero quaternion becomes the identity.
fn normalised(q: [f32; 4]) -> ([f32; 4], f32) {
    let length = q.iter().map(|v| v * v).sum::<f32>().sqrt();
    if length > 1e-12 { (q.map(|v| v / length), length) } else { ([1.0, 0.0, 0.0, 0.0], 1e-12) }
}

/// Transpose of the Jacobian of normalisation: `(I − u uᵀ) g / length`.
fn normalised_backward(unit: [f32; 4], length: f32, g: [f32; 4]) -> [f32; 4] {
    let along: f32 = unit.iter().zip(g).map(|(u, g)| u * g).sum();
    std::array::from_fn(|i| (g[i] - along * unit[i]) / length)
}

/// (w, x, y, z) of a row stored (x, y, z, w).
fn w_first(row: [f32; 4]) -> [f32; 4] {
    [row[3], row[0], row[1], row[2]]
}

fn canonical_rotation(canonical: &Canonical, index: usize) -> ([f32; 4], f32) {
    normalised(std::array::from_fn(|i| canonical.rotations[4 * index + i]))
}

/// World positions and rotations of all Gaussians. Coefficients beyond the bases are ignored, missing ones are 0.
pub fn deform(canonical: &Canonical, motion: &Motion) -> Deformed {
    let joints = motion.joints.each_ref().map(affine);
    let count = canonical.len();
    let mut out = Deformed { positions: vec![0.0; 3 * count], rotations: vec![0.0; 4 * count] };
    out.positions.par_chunks_mut(3 * CHUNK).zip(out.rotations.par_chunks_mut(4 * CHUNK)).enumerate().for_each(
        |(chunk, (positions, rotations))| {
            let positions = positions.as_chunks_mut::<3>().0;
            let rotations = rotations.as_chunks_mut::<4>().0;
            for (offset, (position, rotation)) in positions.iter_mut().zip(rotations).enumerate() {
                let index = chunk * CHUNK + offset;
                let Local { expressed: x, blended: m, .. } = local(canonical, index, &joints, &motion.coefficients);
                *position = std::array::from_fn(|r| m[r][0] * x[0] + m[r][1] * x[1] + m[r][2] * x[2] + m[r][3]);
                let (turn, _) = normalised(w_first(quaternion_row(&m).1));
                *rotation = hamilton(turn, canonical_rotation(canonical, index).0);
            }
        },
    );
    out
}

/// One chunk's share of the gradients.
struct Share<'a> {
    positions: &'a mut [[f32; 3]],
    rotations: &'a mut [[f32; 4]],
    bases: &'a mut [f32],
    weights: &'a mut [[f32; JOINTS]],
}

/// Pulls gradients of world positions (`N×3`) and rotations (`N×4`) back: *adds* to the positions, rotations, bases and
/// weights of `gradient`, and returns the gradient of the motion.
pub fn deform_backward(
    canonical: &Canonical,
    motion: &Motion,
    upstream: &Deformed,
    gradient: &mut Canonical,
) -> MotionGradient {
    let joints = motion.joints.each_ref().map(affine);
    let modes = canonical.modes;
    let row = (3 * modes).max(1);
    let chunks = canonical.len().div_ceil(CHUNK);
    let mut bases: Vec<&mut [f32]> = gradient.bases.chunks_mut(row * CHUNK).collect();
    bases.resize_with(chunks, Default::default);
    let sums: Vec<MotionGradient> = gradient
        .positions
        .par_chunks_mut(3 * CHUNK)
        .zip(gradient.rotations.par_chunks_mut(4 * CHUNK))
        .zip(bases)
        .zip(gradient.weights.par_chunks_mut(JOINTS * CHUNK))
        .enumerate()
        .map(|(chunk, (((positions, rotations), bases), weights))| {
            let share = Share {
                positions: positions.as_chunks_mut::<3>().0,
                rotations: rotations.as_chunks_mut::<4>().0,
                bases,
                weights: weights.as_chunks_mut::<JOINTS>().0,
            };
            chunk_backward(canonical, (&joints, &motion.coefficients), upstream, chunk * CHUNK, share)
        })
        .collect();
    let mut total = MotionGradient { joints: [DMat4::ZERO; JOINTS], coefficients: vec![0.0; modes] };
    for sum in sums {
        total.joints.iter_mut().zip(sum.joints).for_each(|(t, s)| *t += s);
        total.coefficients.iter_mut().zip(sum.coefficients).for_each(|(t, s)| *t += s);
    }
    total
}

fn chunk_backward(
    canonical: &Canonical,
    (joints, coefficients): (&[Affine; JOINTS], &[f32]),
    upstream: &Deformed,
    start: usize,
    share: Share<'_>,
) -> MotionGradient {
    let modes = canonical.modes;
    let mut joint_sums = [[[0.0f64; 4]; 3]; JOINTS];
    let mut coefficient_sums = vec![0.0f64; modes];
    for offset in 0..share.positions.len() {
        let index = start + offset;
        let local = local(canonical, index, joints, coefficients);
        let m = &local.blended;
        let g: [f32; 3] = std::array::from_fn(|i| upstream.positions[3 * index + i]);
        let g_rotation: [f32; 4] = std::array::from_fn(|i| upstream.rotations[4 * index + i]);
        if g == [0.0; 3] && g_rotation == [0.0; 4] {
            continue;
        }
        // Position.
        let g_expressed: [f32; 3] = std::array::from_fn(|c| m[0][c] * g[0] + m[1][c] * g[1] + m[2][c] * g[2]);
        let x = local.expressed;
        let mut g_blended: Affine = std::array::from_fn(|r| [g[r] * x[0], g[r] * x[1], g[r] * x[2], g[r]]);
        for axis in 0..3 {
            share.positions[offset][axis] += g_expressed[axis];
        }
        let own = &canonical.bases[index * 3 * modes..(index + 1) * 3 * modes];
        let out = &mut share.bases[offset * 3 * modes..(offset + 1) * 3 * modes];
        for (mode, (basis, out)) in own.as_chunks::<3>().0.iter().zip(out.as_chunks_mut::<3>().0).enumerate() {
            let coefficient = coefficients.get(mode).copied().unwrap_or(0.0);
            let mut along = 0.0;
            for axis in 0..3 {
                out[axis] += coefficient * g_expressed[axis];
                along += basis[axis] * g_expressed[axis];
            }
            coefficient_sums[mode] += f64::from(along);
        }
        // Rotation.
        let (canonical_unit, canonical_length) = canonical_rotation(canonical, index);
        let (chosen, row) = quaternion_row(m);
        let (turn, turn_length) = normalised(w_first(row));
        let g_canonical = normalised_backward(canonical_unit, canonical_length, hamilton(conjugate(turn), g_rotation));
        for i in 0..4 {
            share.rotations[offset][i] += g_canonical[i];
        }
        let g_turn = normalised_backward(turn, turn_length, hamilton(g_rotation, conjugate(canonical_unit)));
        quaternion_row_backward(chosen, [g_turn[1], g_turn[2], g_turn[3], g_turn[0]], &mut g_blended);
        // Blend.
        let along: [f32; JOINTS] = std::array::from_fn(|j| dot(&joints[j], &g_blended));
        let mean: f32 = along.iter().zip(local.weights).map(|(a, w)| a * w).sum();
        for j in 0..JOINTS {
            if canonical.weights[index * JOINTS + j] > 0.0 {
                share.weights[offset][j] += (along[j] - mean) / local.weight_sum;
            }
            for r in 0..3 {
                for c in 0..4 {
                    joint_sums[j][r][c] += f64::from(local.weights[j] * g_blended[r][c]);
                }
            }
        }
    }
    let joints = joint_sums.map(|rows| {
        let column = |c: usize| DVec3::new(rows[0][c], rows[1][c], rows[2][c]).extend(0.0);
        DMat4::from_cols(column(0), column(1), column(2), column(3))
    });
    MotionGradient { joints, coefficients: coefficient_sums }
}

fn dot(a: &Affine, b: &Affine) -> f32 {
    a.as_flattened().iter().zip(b.as_flattened()).map(|(a, b)| a * b).sum()
}
