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
const REACH: f64 = 0.009;
/// Standard deviation of the offset across and along the line of sight, metres.
const DEVIATION: DVec3 = DVec3::new(0.0026, 0.0026, 0.0018);
/// Directions whose variance is below this share of the whole are dropped.
const CUT: f64 = 0.05;

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
}

/// The head with one more identity mode of coefficient 1: the personal offset (if any), and eyeballs seated behind the
/// lids of this person's face. The rest of the skeleton stays.
pub fn personalised(head: &HeadModel, identity: &[f32], offset: Option<(&Offsets, &[f64])>) -> HeadModel {
    let mut mode: Vec<DVec3> = head
        .vertices
        .iter()
        .map(|vertex| {
            offset.map_or(DVec3::ZERO, |(offsets, coefficients)| offsets.offset(vector(vertex), coefficients))
        })
        .collect();
    let person = head.with_identity(identity);
    let mut joints = [DVec3::ZERO; JOINTS];
    for (region, eye) in [(Region::EyeLeft, joint::EYE_LEFT), (Region::EyeRight, joint::EYE_RIGHT)] {
        let eyeball: Vec<usize> = (0..head.regions.len()).filter(|&i| head.regions[i] == region).collect();
        let centre = vector(&head.joints[eye]);
        let Some(seat) = Seat::of(head, &person, &mode, (centre, &eyeball)) else { continue };
        for &i in &eyeball {
            mode[i] = seat.centre + (vector(&head.vertices[i]) - centre) * seat.scale - vector(&person.vertices[i]);
        }
        joints[eye] = seat.centre - vector(&person.joints[eye]);
    }
    let mut extended = head.clone();
    extended.identity.data.extend(mode.iter().flat_map(|shift| shift.as_vec3().to_array()));
    extended.identity.count += 1;
    extended.joint_identity.extend(joints.iter().flat_map(|shift| shift.as_vec3().to_array()));
    extended
}

fn vector(p: &[f32; 3]) -> DVec3 {
    DVec3::from_array(p.map(f64::from))
}

/// Where an eyeball sits in a person's face, and its size relative to the template's.
struct Seat {
    centre: DVec3,
    scale: f64,
}

impl Seat {
    /// Moves and scales the eyeball as the lids around it were, then shrinks it until no lid cuts into it.
    fn of(head: &HeadModel, person: &HeadModel, mode: &[DVec3], (centre, eyeball): (DVec3, &[usize])) -> Option<Self> {
        let radius = eyeball.iter().map(|&i| vector(&head.vertices[i]).distance(centre)).fold(0.0, f64::max);
        let around: Vec<(DVec3, DVec3)> = (0..head.vertices.len())
            .filter(|&i| head.regions[i] == Region::Skin)
            .map(|i| (vector(&head.vertices[i]), vector(&person.vertices[i]) + mode[i]))
            .filter(|(rest, _)| (1.02 * radius..1.35 * radius).contains(&rest.distance(centre)) && rest.z > centre.z)
            .collect();
        if around.len() < 4 {
            return None;
        }
        let count = around.len() as f64;
        let from = around.iter().map(|pair| pair.0).sum::<DVec3>() / count;
        let to = around.iter().map(|pair| pair.1).sum::<DVec3>() / count;
        let (above, below) = around.iter().fold((0.0, 0.0), |(above, below), (rest, moved)| {
            (above + (*rest - from).dot(*moved - to), below + (*rest - from).length_squared())
        });
        let mut scale = (above / below).clamp(0.8, 1.2);
        let centre = to + (centre - from) * scale;
        let clearance = around.iter().map(|(_, moved)| moved.distance(centre)).fold(f64::MAX, f64::min);
        scale = scale.min(clearance / (1.03 * radius)).max(0.7);
        Some(Self { centre, scale })
    }
}
