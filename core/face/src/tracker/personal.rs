//! What makes one face unlike any sum of modes: a smooth offset of the rest shape at the landmarks.
//!
//! A Gaussian process over the head's surface (squared-exponential kernel) is cut to its leading directions by a pivoted
//! Cholesky factorisation of the landmarks' kernel matrix. Each direction gives three unknowns of unit variance; they
//! join the identity while it is fitted and are then baked into one extra mode of the head, coefficient 1.

use glam::DVec3;

use super::linear::forward;
use super::points::Points;
use crate::model::{HeadModel, JOINTS, Region, joint};

/// Reach of the kernel, metres.
const REACH: f64 = 0.016;
/// Standard deviation of the offset across and along the line of sight, metres.
const DEVIATION: DVec3 = DVec3::new(0.0026, 0.0026, 0.0018);
/// Directions whose variance is below this share of the whole are dropped.
const CUT: f64 = 0.02;

/// The directions: pivots and the factor of their kernel matrix.
pub struct Offsets {
    pivots: Vec<DVec3>,
    /// Row-major lower factor of the kernel of the pivots.
    factor: Vec<f64>,
}

fn kernel(a: DVec3, b: DVec3) -> f64 {
    (-(a - b).length_squared() / (2.0 * REACH * REACH)).exp()
}

impl Offsets {
    /// Chooses at most `limit` pivots among the landmarks of the template.
    pub fn new(rest: &[DVec3], limit: usize) -> Self {
        let mut remaining: Vec<f64> = vec![1.0; rest.len()];
        let mut rows: Vec<Vec<f64>> = Vec::new();
        let mut chosen: Vec<usize> = Vec::new();
        while chosen.len() < limit {
            let Some(next) = (0..rest.len()).max_by(|a, b| remaining[*a].total_cmp(&remaining[*b]).then(b.cmp(a)))
            else {
                break;
            };
            if remaining[next] < CUT {
                break;
            }
            let root = remaining[next].sqrt();
            let row: Vec<f64> = (0..rest.len())
                .map(|k| {
                    let explained: f64 = rows.iter().map(|row| row[k] * row[next]).sum();
                    (kernel(rest[k], rest[next]) - explained) / root
                })
                .collect();
            remaining
                .iter_mut()
                .zip(&row)
                .for_each(|(variance, value)| *variance = (*variance - value * value).max(0.0));
            rows.push(row);
            chosen.push(next);
        }
        let n = chosen.len();
        let mut factor = vec![0.0; n * n];
        for (j, row) in rows.iter().enumerate() {
            for (i, &pivot) in chosen.iter().enumerate().skip(j) {
                factor[i * n + j] = row[pivot];
            }
        }
        Self { pivots: chosen.iter().map(|&k| rest[k]).collect(), factor }
    }

    /// Amplitude of every direction at a point.
    fn amplitudes(&self, point: DVec3) -> Vec<f64> {
        let mut values: Vec<f64> = self.pivots.iter().map(|pivot| kernel(point, *pivot)).collect();
        let n = values.len();
        forward(&self.factor, n, &mut values);
        values
    }

    /// The landmark points with the directions appended to the identity basis (the jaw's hinge stays).
    pub fn extended(&self, points: &Points) -> Points {
        let amplitudes: Vec<Vec<f64>> = points.rest.iter().map(|point| self.amplitudes(*point)).collect();
        let mut extended = points.clone();
        for direction in 0..self.pivots.len() {
            for axis in DVec3::AXES {
                extended.identity.extend(amplitudes.iter().map(|values| axis * DEVIATION * values[direction]));
                extended.jaw_identity.push(DVec3::ZERO);
            }
        }
        extended
    }

    /// Offset of a point for given coefficients.
    fn offset(&self, point: DVec3, coefficients: &[f64]) -> DVec3 {
        let shifts = coefficients.as_chunks::<3>().0;
        let amplitudes = self.amplitudes(point);
        amplitudes.iter().zip(shifts).map(|(amplitude, shift)| DVec3::from_array(*shift) * DEVIATION * *amplitude).sum()
    }

    /// The head with the offset as one more identity mode, of coefficient 1. Eyeballs move as the lids around them do on
    /// average, the rest of the skeleton stays.
    pub fn baked(&self, head: &HeadModel, coefficients: &[f64]) -> HeadModel {
        let vector = |p: &[f32; 3]| DVec3::from_array(p.map(f64::from));
        let eyes = [joint::EYE_LEFT, joint::EYE_RIGHT].map(|eye| {
            let centre = vector(&head.joints[eye]);
            let around: Vec<DVec3> = head
                .landmarks
                .iter()
                .map(|anchor| vector(&head.landmark_position(anchor, &head.vertices)))
                .filter(|landmark| (*landmark - centre).truncate().length() < 0.017 && landmark.z > centre.z)
                .collect();
            let sum: DVec3 = around.iter().map(|landmark| self.offset(*landmark, coefficients)).sum();
            sum / around.len().max(1) as f64
        });
        let mut extended = head.clone();
        for (vertex, region) in head.vertices.iter().zip(&head.regions) {
            let shift = match region {
                Region::EyeLeft => eyes[0],
                Region::EyeRight => eyes[1],
                _ => self.offset(vector(vertex), coefficients),
            };
            extended.identity.data.extend(shift.as_vec3().to_array());
        }
        extended.identity.count += 1;
        let mut joints = [DVec3::ZERO; JOINTS];
        [joints[joint::EYE_LEFT], joints[joint::EYE_RIGHT]] = eyes;
        extended.joint_identity.extend(joints.iter().flat_map(|shift| shift.as_vec3().to_array()));
        extended
    }
}
