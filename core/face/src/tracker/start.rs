//! Where a fit begins: a scaled orthographic pose from an affine least-squares fit, and which frames are key frames.

use glam::{DMat3, DVec2, DVec3};

use super::frame::{Lens, Seen, State};
use super::linear::damped_solve;
use super::points::{Points, Shape};

/// Pose of a neutral face from one frame's landmarks (Procrustes under weak perspective); `None` when they are too
/// few or degenerate.
pub fn weak_perspective(points: &Points, shape: &Shape, lens: Lens, seen: &Seen) -> Option<State> {
    // u = a₁·X + b₁, v = a₂·X + b₂ by normal equations; both share the matrix.
    let mut matrix = vec![0.0; 16];
    let mut right = [[0.0; 4]; 2];
    for (k, &point) in seen.points.iter().enumerate() {
        let weight = seen.weights[k] * points.importance[point];
        let x = shape.rest[point];
        let row = [x.x, x.y, x.z, 0.1];
        for i in 0..4 {
            for j in 0..4 {
                matrix[4 * i + j] += weight * row[i] * row[j];
            }
            right[0][i] += weight * row[i] * (seen.pixels[k].x - lens.centre.x);
            right[1][i] += weight * row[i] * (lens.centre.y - seen.pixels[k].y);
        }
    }
    let [a, b] = right.map(|b| damped_solve(&matrix, &b, 1e-9, &[]));
    let (a, b) = (a?, b?);
    let (across, up) = (DVec3::from_slice(&a), DVec3::from_slice(&b));
    let pixels_per_metre = 0.5 * (across.length() + up.length());
    let (n1, n2) = (across.try_normalize()?, up.try_normalize()?);
    let (sum, difference) = ((n1 + n2).try_normalize()?, (n1 - n2).try_normalize()?);
    let (r1, r2) =
        ((sum + difference) * std::f64::consts::FRAC_1_SQRT_2, (sum - difference) * std::f64::consts::FRAC_1_SQRT_2);
    let rotation = DMat3::from_cols(r1, r2, r1.cross(r2)).transpose();
    let depth = lens.focal / pixels_per_metre;
    let offset = DVec2::new(0.1 * a[3], 0.1 * b[3]) / pixels_per_metre;
    // The affine offset is where the head's origin projects; depth is that of the landmarks' mean.
    let mean: DVec3 = seen.points.iter().map(|&point| shape.rest[point]).sum::<DVec3>() / seen.points.len() as f64;
    let origin_depth = depth + (rotation * mean).z;
    let grow = origin_depth / depth;
    let mut state = State::rest(points.expression_count());
    state.rotation = rotation;
    state.translation = DVec3::new(offset.x * grow, offset.y * grow, -origin_depth);
    (state.is_finite() && depth > 0.0).then_some(state)
}

/// Up to `count` frames that differ: two thirds evenly spread in time, the rest the least like those already chosen, by
/// the landmarks' places after removing shift and size.
pub fn key_frames(frames: &[Seen], usable: &[usize], count: usize) -> Vec<usize> {
    if usable.len() <= count {
        return usable.to_vec();
    }
    let even = (2 * count / 3).max(1);
    let mut chosen: Vec<usize> =
        (0..even).map(|k| usable[((2 * k + 1) * usable.len() / (2 * even)).min(usable.len() - 1)]).collect();
    let signatures: Vec<Vec<(usize, DVec2)>> = usable.iter().map(|&frame| signature(&frames[frame])).collect();
    let of_frame = |frame: usize| usable.binary_search(&frame).ok().map(|k| &signatures[k]);
    let mut nearest: Vec<f64> = signatures
        .iter()
        .map(|own| {
            chosen.iter().filter_map(|&c| of_frame(c)).map(|other| distance(own, other)).fold(f64::MAX, f64::min)
        })
        .collect();
    while chosen.len() < count {
        let Some(next) = (0..usable.len()).max_by(|a, b| nearest[*a].total_cmp(&nearest[*b]).then(b.cmp(a))) else {
            break;
        };
        if nearest[next] <= 0.0 {
            break;
        }
        chosen.push(usable[next]);
        for (value, own) in nearest.iter_mut().zip(&signatures) {
            *value = value.min(distance(own, &signatures[next]));
        }
    }
    chosen.sort_unstable();
    chosen.dedup();
    chosen
}

/// Landmarks without shift and size.
fn signature(seen: &Seen) -> Vec<(usize, DVec2)> {
    let count = seen.points.len().max(1) as f64;
    let mean = seen.pixels.iter().sum::<DVec2>() / count;
    let size = (seen.pixels.iter().map(|p| (*p - mean).length_squared()).sum::<f64>() / count).sqrt().max(1e-6);
    seen.points.iter().zip(&seen.pixels).map(|(point, pixel)| (*point, (*pixel - mean) / size)).collect()
}

/// Mean squared distance over the landmarks both have.
fn distance(a: &[(usize, DVec2)], b: &[(usize, DVec2)]) -> f64 {
    let (mut i, mut j, mut sum, mut count) = (0, 0, 0.0, 0);
    while i < a.len() && j < b.len() {
        match a[i].0.cmp(&b[j].0) {
            std::cmp::Ordering::Less => i += 1,
            std::cmp::Ordering::Greater => j += 1,
            std::cmp::Ordering::Equal => {
                sum += (a[i].1 - b[j].1).length_squared();
                (i, j, count) = (i + 1, j + 1, count + 1);
            }
        }
    }
    if count == 0 { 0.0 } else { sum / f64::from(count) }
}
