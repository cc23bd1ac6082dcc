//! The deformation again, naive and in f64: the specification that `deform.rs` is held against.

use super::*;

/// Canonical parameters of one Gaussian as f64.
#[derive(Clone)]
pub struct Naive {
    position: [f64; 3],
    rotation: [f64; 4],
    bases: Vec<[f64; 3]>,
    weights: [f64; JOINTS],
}

impl Naive {
    fn of(canonical: &Canonical, index: usize) -> Self {
        let wide = |values: &[f32]| values.iter().map(|v| f64::from(*v)).collect::<Vec<_>>();
        let row = 3 * canonical.modes;
        let bases = wide(&canonical.bases[index * row..(index + 1) * row]);
        Self {
            position: canonical.position(index).map(f64::from),
            rotation: std::array::from_fn(|i| f64::from(canonical.rotations[4 * index + i])),
            bases: bases.as_chunks::<3>().0.to_vec(),
            weights: std::array::from_fn(|j| f64::from(canonical.weights[JOINTS * index + j])),
        }
    }

    /// Every number of it, for finite differences: position, rotation, bases, weights.
    fn numbers(&mut self) -> Vec<&mut f64> {
        let bases = self.bases.as_flattened_mut().iter_mut();
        self.position.iter_mut().chain(&mut self.rotation).chain(bases).chain(&mut self.weights).collect()
    }
}

/// World position and rotation (w, x, y, z) of one Gaussian.
pub fn deform_one(gaussian: &Naive, joints: &[DMat4; JOINTS], coefficients: &[f64]) -> ([f64; 3], [f64; 4]) {
    let mut x = DVec3::from_array(gaussian.position);
    for (basis, c) in gaussian.bases.iter().zip(coefficients) {
        x += *c * DVec3::from_array(*basis);
    }
    let clamped = gaussian.weights.map(|w| w.max(0.0));
    let sum: f64 = clamped.iter().sum::<f64>().max(f64::from(WEIGHT_FLOOR));
    let mut blended = DMat4::ZERO;
    for (w, joint) in clamped.iter().zip(joints) {
        blended += *joint * (w / sum);
    }
    let m = |r: usize, c: usize| blended.col(c)[r];
    let world = (blended * x.extend(1.0)).truncate();
    let rows = [
        [1.0 + m(0, 0) - m(1, 1) - m(2, 2), m(1, 0) + m(0, 1), m(2, 0) + m(0, 2), m(2, 1) - m(1, 2)],
        [m(1, 0) + m(0, 1), 1.0 + m(1, 1) - m(2, 2) - m(0, 0), m(2, 1) + m(1, 2), m(0, 2) - m(2, 0)],
        [m(2, 0) + m(0, 2), m(2, 1) + m(1, 2), 1.0 + m(2, 2) - m(0, 0) - m(1, 1), m(1, 0) - m(0, 1)],
        [m(2, 1) - m(1, 2), m(0, 2) - m(2, 0), m(1, 0) - m(0, 1), 1.0 + m(0, 0) + m(1, 1) + m(2, 2)],
    ];
    let chosen = (0..4).fold(3, |best, i| if rows[i][i] > rows[best][best] { i } else { best });
    let row = rows[chosen];
    let length = row.iter().map(|v| v * v).sum::<f64>().sqrt();
    let d = [row[3] / length, row[0] / length, row[1] / length, row[2] / length];
    let length = gaussian.rotation.iter().map(|v| v * v).sum::<f64>().sqrt();
    let p = gaussian.rotation.map(|v| v / length);
    let quaternion = [
        d[0] * p[0] - d[1] * p[1] - d[2] * p[2] - d[3] * p[3],
        d[0] * p[1] + d[1] * p[0] + d[2] * p[3] - d[3] * p[2],
        d[0] * p[2] - d[1] * p[3] + d[2] * p[0] + d[3] * p[1],
        d[0] * p[3] + d[1] * p[2] - d[2] * p[1] + d[3] * p[0],
    ];
    (world.to_array(), quaternion)
}

/// Numbers in [−1, 1] that repeat from run to run.
fn noise(seed: u32) -> impl FnMut() -> f64 {
    let mut state = seed;
    move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(state >> 8) / f64::from(1u32 << 23) - 1.0
    }
}

struct Case {
    canonical: Canonical,
    rig: crate::rig::Rig,
    pose: crate::rig::Pose,
    coefficients: Vec<f64>,
    upstream: Deformed,
}

impl Case {
    fn new(count: usize, turn: f64) -> Self {
        let mut next = noise(7);
        let modes = 4;
        let mut canonical = Canonical::zeros(count, modes);
        canonical.positions.iter_mut().for_each(|v| *v = 0.1 * next() as f32);
        canonical.rotations.iter_mut().for_each(|v| *v = next() as f32);
        canonical.bases.iter_mut().for_each(|v| *v = 0.01 * next() as f32);
        canonical.weights.iter_mut().for_each(|v| *v = (next() as f32 + 0.6).max(-0.1));
        let rig = crate::rig::Rig { joints: std::array::from_fn(|_| std::array::from_fn(|_| 0.05 * next())) };
        let mut pose: crate::rig::Pose = std::array::from_fn(|_| 0.3 * next());
        pose[0] = turn;
        let coefficients = (0..modes).map(|_| next()).collect();
        let upstream = Deformed {
            positions: (0..3 * count).map(|_| next() as f32).collect(),
            rotations: (0..4 * count).map(|_| next() as f32).collect(),
        };
        Self { canonical, rig, pose, coefficients, upstream }
    }

    fn loss_of(&self, index: usize, gaussian: &Naive, pose: &crate::rig::Pose, coefficients: &[f64]) -> f64 {
        let (position, rotation) = deform_one(gaussian, &self.rig.transforms(pose), coefficients);
        let weighted = |values: &[f64], weights: &[f32]| -> f64 {
            values.iter().zip(weights).map(|(v, w)| v * f64::from(*w)).sum()
        };
        weighted(&position, &self.upstream.positions[3 * index..])
            + weighted(&rotation, &self.upstream.rotations[4 * index..])
    }

    fn loss(&self, pose: &crate::rig::Pose, coefficients: &[f64]) -> f64 {
        (0..self.canonical.len()).map(|i| self.loss_of(i, &Naive::of(&self.canonical, i), pose, coefficients)).sum()
    }

    fn motion(&self) -> Motion {
        Motion {
            joints: self.rig.transforms(&self.pose),
            coefficients: self.coefficients.iter().map(|c| *c as f32).collect(),
        }
    }
}

/// Central difference of `f` at 0.
fn slope(f: impl Fn(f64) -> f64) -> f64 {
    (f(1e-5) - f(-1e-5)) / 2e-5
}

fn assert_near(what: &str, fast: f64, exact: f64, scale: f64) {
    assert!((fast - exact).abs() <= 3e-4 * exact.abs().max(scale), "{what}: {fast} against {exact}");
}

#[test]
fn fast_and_naive_agree() {
    for turn in [0.1, 2.0, 3.1] {
        let case = Case::new(700, turn);
        let fast = deform(&case.canonical, &case.motion());
        for index in 0..case.canonical.len() {
            let naive = Naive::of(&case.canonical, index);
            let (position, rotation) = deform_one(&naive, &case.motion().joints, &case.coefficients);
            for (a, b) in position.iter().zip(&fast.positions[3 * index..]) {
                assert_near("position", f64::from(*b), *a, 1e-2);
            }
            for (a, b) in rotation.iter().zip(&fast.rotations[4 * index..]) {
                assert_near("rotation", f64::from(*b), *a, 0.1);
            }
        }
    }
}

#[test]
fn gradients_match_finite_differences_of_the_naive_text() {
    for turn in [0.1, 2.0, 3.1] {
        let case = Case::new(9, turn);
        let mut gradient = Canonical::zeros(9, case.canonical.modes);
        let motion_gradient = deform_backward(&case.canonical, &case.motion(), &case.upstream, &mut gradient);
        for index in 0..case.canonical.len() {
            let naive = Naive::of(&case.canonical, index);
            let row = 3 * gradient.modes;
            let fast = [
                &gradient.positions[3 * index..3 * index + 3],
                &gradient.rotations[4 * index..4 * index + 4],
                &gradient.bases[row * index..row * (index + 1)],
                &gradient.weights[JOINTS * index..JOINTS * (index + 1)],
            ]
            .concat();
            for (number, fast) in fast.iter().enumerate() {
                let exact = slope(|h| {
                    let mut moved = naive.clone();
                    *moved.numbers()[number] += h;
                    case.loss_of(index, &moved, &case.pose, &case.coefficients)
                });
                assert_near(&format!("Gaussian {index}, number {number}"), f64::from(*fast), exact, 0.3);
            }
        }
        let pose_gradient = case.rig.backward(&case.pose, &motion_gradient.joints);
        for (number, fast) in pose_gradient.iter().enumerate() {
            let exact = slope(|h| {
                let mut pose = case.pose;
                pose[number] += h;
                case.loss(&pose, &case.coefficients)
            });
            assert_near(&format!("pose {number}"), *fast, exact, 1.0);
        }
        for (number, fast) in motion_gradient.coefficients.iter().enumerate() {
            let exact = slope(|h| {
                let mut coefficients = case.coefficients.clone();
                coefficients[number] += h;
                case.loss(&case.pose, &coefficients)
            });
            assert_near(&format!("coefficient {number}"), *fast, exact, 0.05);
        }
    }
}

#[test]
fn the_thread_count_changes_no_bit() -> Result<(), rayon::ThreadPoolBuildError> {
    let case = Case::new(2000, 0.4);
    let run = || {
        let mut gradient = Canonical::zeros(2000, case.canonical.modes);
        let motion = deform_backward(&case.canonical, &case.motion(), &case.upstream, &mut gradient);
        (gradient, motion)
    };
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build()?.install(run);
    let four = rayon::ThreadPoolBuilder::new().num_threads(4).build()?.install(run);
    assert!(one == four);
    Ok(())
}

#[test]
fn degenerate_gaussians_stay_finite() {
    let mut case = Case::new(2, 0.3);
    case.canonical.rotations[..4].fill(0.0);
    case.canonical.weights.fill(-1.0);
    let out = deform(&case.canonical, &case.motion());
    let mut gradient = Canonical::zeros(2, case.canonical.modes);
    deform_backward(&case.canonical, &case.motion(), &case.upstream, &mut gradient);
    assert!(out.positions.iter().chain(&out.rotations).all(|v| v.is_finite()));
    assert!(gradient.first_not_finite().is_none());
}
