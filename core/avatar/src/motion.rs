//! From a tracked pose to what moves the Gaussians: joint transforms and a short vector of motion coefficients.
//!
//! The tracker's expression space is wider than any one clip. Its modes are replaced by the principal displacement
//! fields of the *training* frames (metric: displacement of the mesh), each with unit root-mean-square coefficient, and
//! only those above a tenth of a millimetre are kept. To them come the two eyelids and correctives, zero at first,
//! driven by the jaw and by the rigid motion about its mean (what does not move with the head: neck, shoulders, loose
//! hair). A driver the clip does not excite is left out. All coefficients are affine in the tracked numbers.

use heartian_face::{Basis, Eigen, FramePose, HeadModel, Track, symmetric_eigen};

use crate::AvatarError;
use crate::deform::Motion;
use crate::rig::{POSE_SIZE, Pose, Rig};

/// Tracked numbers beyond the expression: eyelids 2, jaw 3, rotation 3, translation 3.
const EXTRA: usize = 11;
/// Smallest root-mean-square vertex displacement of a kept expression mode, metres.
const LEAST_DISPLACEMENT_METRES: f64 = 1e-5;
/// Root-mean-square below which a driver is not excited, in the order of `EXTRA`: lids (of [0, 1]), radians, radians, metres.
const LEAST_EXCITED: [f64; EXTRA] = [0.02, 0.02, 5e-3, 5e-3, 5e-3, 0.01, 0.01, 0.01, 2e-3, 2e-3, 2e-3];

/// How far beyond the range of the training frames a coefficient may go, relative to that range.
const RANGE_MARGIN: f32 = 0.05;

/// The affine map from a tracked pose to motion coefficients, and the skeleton.
#[derive(Clone, Debug, PartialEq)]
pub struct MotionModel {
    /// The skeleton at rest.
    pub rig: Rig,
    /// Expression coefficients of the tracker, `E`.
    pub expression_count: usize,
    /// `K × (E + 11)`: coefficients per tracked number (expression, eyelids, jaw, rotation, translation).
    pub matrix: Vec<f32>,
    /// `E + 11`: the tracked numbers at which every coefficient is 0.
    pub origin: Vec<f32>,
    /// `K × 2`: least and largest value that each coefficient may take. What was learned of a coefficient holds in the
    /// range the training frames covered; beyond it a basis would only extrapolate.
    pub range: Vec<[f32; 2]>,
}

/// A motion model with the displacement of every mesh vertex per coefficient.
pub struct FittedMotion {
    /// The model.
    pub model: MotionModel,
    /// `K` modes over the vertices; correctives are zero.
    pub basis: Basis,
}

/// One frame's pose and coefficients: the numbers that joint refinement may move.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameState {
    /// The skeleton's pose.
    pub pose: Pose,
    /// `K`.
    pub coefficients: Vec<f32>,
}

impl MotionModel {
    /// Number of motion coefficients, `K`.
    pub fn modes(&self) -> usize {
        self.matrix.len() / self.width()
    }

    /// Number of tracked numbers, `E + 11`.
    pub fn width(&self) -> usize {
        self.expression_count + EXTRA
    }

    /// What a tracked frame says.
    pub fn state(&self, frame: &FramePose) -> FrameState {
        let raw = tracked_numbers(frame, self.expression_count);
        let coefficients = self
            .matrix
            .chunks(self.width())
            .map(|row| row.iter().zip(&raw).zip(&self.origin).map(|((m, r), o)| m * (r - o)).sum::<f32>())
            .zip(&self.range)
            .map(|(value, [least, most])| value.clamp(*least, *most))
            .collect();
        FrameState { pose: pose_of(frame), coefficients }
    }

    /// What moves the Gaussians.
    pub fn motion(&self, state: &FrameState) -> Motion {
        Motion { joints: self.rig.transforms(&state.pose), coefficients: state.coefficients.clone() }
    }

    /// Fits the model to the frames of a track that are used for training.
    ///
    /// # Errors
    /// When the head's skeleton is not FLAME's tree.
    pub fn fit(track: &Track, head: &HeadModel, training: &[usize], most: usize) -> Result<FittedMotion, AvatarError> {
        if head.parents != [-1, 0, 1, 1, 1] || head.joints.len() != crate::rig::JOINTS {
            return Err(AvatarError::Skeleton { name: head.name.clone() });
        }
        let joints = std::array::from_fn(|j| head.joints[j].map(f64::from));
        let expression_count = head.expression.count;
        let raw: Vec<Vec<f32>> =
            training.iter().map(|&t| tracked_numbers(&track.frames[t], expression_count)).collect();
        let width = expression_count + EXTRA;
        let vertices = head.vertices.len();
        let mut model = MotionModel {
            rig: Rig { joints },
            expression_count,
            matrix: Vec::new(),
            origin: vec![0.0; width],
            range: Vec::new(),
        };
        let mut basis = Basis::default();
        for (row, field) in expression_modes(&head.expression, &raw, most) {
            model.matrix.extend(row.iter().map(|v| *v as f32).chain([0.0; EXTRA]));
            basis.data.extend(field);
            basis.count += 1;
        }
        for (extra, least) in LEAST_EXCITED.into_iter().enumerate() {
            let column = expression_count + extra;
            let count = raw.len().max(1) as f64;
            let mean = raw.iter().map(|r| f64::from(r[column])).sum::<f64>() / count;
            let origin = if extra < 2 { 0.0 } else { mean };
            let rms = (raw.iter().map(|r| (f64::from(r[column]) - origin).powi(2)).sum::<f64>() / count).sqrt();
            if rms < least {
                continue;
            }
            let lid = extra < 2 && head.eyelids.count == 2;
            let start = model.matrix.len();
            model.matrix.resize(start + width, 0.0);
            model.matrix[start + column] = if lid { 1.0 } else { (1.0 / rms) as f32 };
            model.origin[column] = origin as f32;
            if lid {
                basis.data.extend_from_slice(head.eyelids.mode(extra).as_flattened());
            } else {
                basis.data.resize(basis.data.len() + 3 * vertices, 0.0);
            }
            basis.count += 1;
        }
        model.range = vec![[f32::NEG_INFINITY, f32::INFINITY]; basis.count];
        let states: Vec<FrameState> = training.iter().map(|&frame| model.state(&track.frames[frame])).collect();
        for (mode, range) in model.range.iter_mut().enumerate() {
            let values = || states.iter().map(|state| state.coefficients[mode]);
            let (least, most) = (values().fold(f32::INFINITY, f32::min), values().fold(f32::NEG_INFINITY, f32::max));
            let margin = RANGE_MARGIN * (most - least);
            *range = [least - margin, most + margin];
        }
        Ok(FittedMotion { model, basis })
    }
}

fn pose_of(frame: &FramePose) -> Pose {
    let parts = [frame.rotation, frame.translation, frame.neck, frame.jaw, frame.eyes[0], frame.eyes[1]];
    let mut pose = [0.0; POSE_SIZE];
    pose.iter_mut().zip(parts.as_flattened()).for_each(|(to, from)| *to = f64::from(*from));
    pose
}

fn tracked_numbers(frame: &FramePose, expression_count: usize) -> Vec<f32> {
    let mut raw = frame.expression.clone();
    raw.resize(expression_count, 0.0);
    raw.extend(frame.eyelids.iter().chain(&frame.jaw).chain(&frame.rotation).chain(&frame.translation));
    raw
}

/// Principal displacement fields: rows of the coefficient matrix and the fields, strongest first.
fn expression_modes(basis: &Basis, raw: &[Vec<f32>], most: usize) -> Vec<(Vec<f64>, Vec<f32>)> {
    let n = basis.count;
    let Some(length) = basis.data.len().checked_div(n).filter(|length| *length > 0) else {
        return Vec::new();
    };
    let vertices = (length / 3) as f64;
    let product = |i: usize, j: usize| -> f64 {
        let mode = |k: usize| basis.data[k * length..(k + 1) * length].iter();
        mode(i).zip(mode(j)).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>() / vertices
    };
    let moment = |i: usize, j: usize| -> f64 {
        raw.iter().map(|r| f64::from(r[i]) * f64::from(r[j])).sum::<f64>() / raw.len().max(1) as f64
    };
    let (mut gram, mut second) = (vec![0.0; n * n], vec![0.0; n * n]);
    for i in 0..n {
        for j in i..n {
            gram[i * n + j] = product(i, j);
            gram[j * n + i] = gram[i * n + j];
            second[i * n + j] = moment(i, j);
            second[j * n + i] = second[i * n + j];
        }
    }
    let (root, inverse_root) = square_roots(n, &symmetric_eigen(n, &second));
    let Eigen { values, vectors } = symmetric_eigen(n, &multiply(n, &multiply(n, &root, &gram), &root));
    let apply = |matrix: &[f64], v: &[f64]| -> Vec<f64> {
        matrix.chunks(n).map(|row| row.iter().zip(v).map(|(a, b)| a * b).sum()).collect()
    };
    values
        .iter()
        .zip(&vectors)
        .take(most)
        .take_while(|(value, _)| value.max(0.0).sqrt() >= LEAST_DISPLACEMENT_METRES)
        .map(|(_, vector)| {
            let mix = apply(&root, vector);
            let mut field = vec![0.0f64; length];
            for (k, weight) in mix.iter().enumerate() {
                let mode = &basis.data[k * length..(k + 1) * length];
                field.iter_mut().zip(mode).for_each(|(f, m)| *f += weight * f64::from(*m));
            }
            (apply(&inverse_root, vector), field.into_iter().map(|f| f as f32).collect())
        })
        .collect()
}

/// Symmetric square root and its pseudo-inverse.
fn square_roots(n: usize, eigen: &Eigen) -> (Vec<f64>, Vec<f64>) {
    let largest = eigen.values.first().copied().unwrap_or(0.0).max(0.0);
    let (mut root, mut inverse) = (vec![0.0; n * n], vec![0.0; n * n]);
    for (value, vector) in eigen.values.iter().zip(&eigen.vectors) {
        if *value <= 1e-9 * largest || *value <= 0.0 {
            continue;
        }
        let s = value.sqrt();
        for i in 0..n {
            for j in 0..n {
                let outer = vector[i] * vector[j];
                root[i * n + j] += s * outer;
                inverse[i * n + j] += outer / s;
            }
        }
    }
    (root, inverse)
}

fn multiply(n: usize, a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; n * n];
    for i in 0..n {
        for k in 0..n {
            for j in 0..n {
                out[i * n + j] += a[i * n + k] * b[k * n + j];
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn head() -> HeadModel {
        let vertices = 40;
        let wave = |count: usize, size: f32| Basis {
            count,
            data: (0..count * vertices * 3).map(|i| size * ((i * 37 % 101) as f32 / 50.0 - 1.0)).collect(),
        };
        HeadModel {
            name: "test".into(),
            vertices: (0..vertices).map(|i| [i as f32 * 0.001, (i % 7) as f32 * 0.01, 0.05]).collect(),
            triangles: vec![[0, 1, 2]],
            regions: vec![heartian_face::Region::Skin; vertices],
            identity: Basis::default(),
            expression: wave(6, 0.004),
            eyelids: wave(2, 0.002),
            joints: vec![[0.0; 3], [0.0, -0.1, 0.0], [0.0, 0.0, 0.01], [0.03, 0.03, 0.05], [-0.03, 0.03, 0.05]],
            joint_identity: Vec::new(),
            parents: [-1, 0, 1, 1, 1],
            weights: vec![[0.5, 0.0, 0.5, 0.0, 0.0]; vertices],
            landmarks: Vec::new(),
        }
    }

    fn track(head: &HeadModel) -> Track {
        let frames = (0..50)
            .map(|t| {
                let phase = t as f32 * 0.4;
                FramePose {
                    rotation: [0.02, 0.1 * phase.sin(), 0.0],
                    translation: [0.0, 0.0, -1.0],
                    jaw: [0.1 + 0.1 * phase.cos(), 0.0, 0.0],
                    eyelids: [(3.0 * phase).sin().max(0.0), (3.0 * phase).sin().max(0.0)],
                    // Two independent motions spread over four coefficients.
                    expression: vec![phase.sin(), 2.0 * phase.sin(), (1.7 * phase).cos(), 0.0, -phase.sin(), 0.0],
                    fitted: true,
                    ..FramePose::rest(6)
                }
            })
            .collect::<Vec<_>>();
        Track {
            head: head.clone(),
            identity: Vec::new(),
            camera: heartian_space::Camera::at_origin(8, 8, 10.0),
            times_seconds: (0..frames.len()).map(|t| t as f64).collect(),
            sigma: heartian_face::TrackSigma::default(),
            frames,
            landmark_rms_px: 0.5,
            interocular_px: 3.0,
        }
    }

    #[test]
    fn reduced_modes_move_the_mesh_as_the_tracker_did() -> Result<(), AvatarError> {
        let head = head();
        let track = track(&head);
        let training: Vec<usize> = (0..40).collect();
        let FittedMotion { model, basis } = MotionModel::fit(&track, &head, &training, 12)?;
        // Two expression modes, two lids, one jaw angle, one rotation angle.
        assert_eq!(model.modes(), 6);
        assert_eq!(basis.data.len(), 6 * 40 * 3);
        for pose in &track.frames[..40] {
            let state = model.state(pose);
            let mut moved = head.vertices.clone();
            basis.add_to(&state.coefficients, &mut moved);
            for (a, b) in moved.as_flattened().iter().zip(head.shaped(pose).as_flattened()) {
                assert!((a - b).abs() < 2e-6, "{a} {b}");
            }
            let joints = model.rig.transforms(&state.pose);
            for (a, b) in joints.iter().zip(head.joint_transforms(pose)) {
                assert!(a.as_mat4().abs_diff_eq(b, 1e-5));
            }
        }
        let mean_square: f32 = training.iter().map(|&t| model.state(&track.frames[t]).coefficients[0].powi(2)).sum();
        assert!((mean_square / 40.0 - 1.0).abs() < 1e-3, "unit coefficients");
        let wild = FramePose { expression: vec![50.0; 6], ..track.frames[0].clone() };
        assert!(model.state(&wild).coefficients[0].abs() < 3.0, "held in the range of the training frames");
        Ok(())
    }

    #[test]
    fn a_still_clip_needs_no_modes_and_a_strange_skeleton_is_refused() {
        let head = head();
        let mut still = track(&head);
        let first = FramePose { expression: vec![0.0; 6], eyelids: [0.0; 2], ..still.frames[0].clone() };
        still.frames.fill(first);
        assert!(MotionModel::fit(&still, &head, &[0, 1, 2], 12).is_ok_and(|fitted| fitted.model.modes() == 0));
        let strange = HeadModel { parents: [-1, 0, 0, 1, 1], ..head };
        assert!(matches!(MotionModel::fit(&still, &strange, &[0], 12), Err(AvatarError::Skeleton { .. })));
    }
}
