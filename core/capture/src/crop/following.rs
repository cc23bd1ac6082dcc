//! A square that goes with the head, for people who move across the picture.
//!
//! Its centre is the head's, steadied in time; its side is one for the clip, so that a pixel stays a pixel. Gaps are bridged
//! and single stray detections passed over. The clip is then one of a camera that pans with the head: poses and light are
//! that camera's.

use super::{CropSquare, Points, head_box, quantile};

/// Standard deviation of the Gaussian that steadies the centre, seconds: slower than nods and speech, faster than steps.
const STEADY_SECONDS: f64 = 0.5;
/// The Gaussian ends after so many deviations.
const REACH: f64 = 3.0;
/// A centre is the median of so many frames before it is steadied.
const MEDIAN_FRAMES: usize = 5;

/// The square of every frame; `None` without any finite landmark. `faces` and `times_seconds` have one entry a frame.
pub(super) fn squares(faces: &[Option<&Points>], times_seconds: &[f64]) -> Option<Vec<CropSquare>> {
    let boxes: Vec<Option<[f32; 4]>> = faces.iter().map(|face| face.and_then(head_box)).collect();
    let seen: Vec<(usize, [f64; 2])> = boxes
        .iter()
        .enumerate()
        .filter_map(|(frame, edges)| edges.map(|[left, top, right, bottom]| (frame, [left + right, top + bottom])))
        .map(|(frame, sums)| (frame, sums.map(|sum| f64::from(sum) / 2.0)))
        .collect();
    let medians: Vec<(f64, [f64; 2])> =
        (0..seen.len()).map(|k| (times_seconds[seen[k].0], median_about(&seen, k))).collect();
    let bridged: Vec<[f64; 2]> = times_seconds.iter().map(|time| bridge(&medians, *time)).collect::<Option<_>>()?;
    let centres: Vec<[f64; 2]> = (0..bridged.len()).map(|frame| steadied(&bridged, times_seconds, frame)).collect();
    let needed = |(edges, [x, y]): (&Option<[f32; 4]>, &[f64; 2])| {
        let [left, top, right, bottom] = (*edges)?.map(f64::from);
        Some(2.0 * (x - left).max(right - x).max(y - top).max(bottom - y) as f32)
    };
    let side_px = quantile(&mut boxes.iter().zip(&centres).filter_map(needed).collect::<Vec<f32>>(), 0.98)?;
    let square =
        |[x, y]: [f64; 2]| CropSquare { left_px: x as f32 - side_px / 2.0, top_px: y as f32 - side_px / 2.0, side_px };
    Some(centres.into_iter().map(square).collect())
}

fn median_about(seen: &[(usize, [f64; 2])], k: usize) -> [f64; 2] {
    let from = k.saturating_sub(MEDIAN_FRAMES / 2);
    let near = &seen[from..(k + MEDIAN_FRAMES / 2 + 1).min(seen.len())];
    [0, 1].map(|axis| {
        let mut values: Vec<f64> = near.iter().map(|(_, centre)| centre[axis]).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    })
}

/// Straight between the nearest known centres, flat beyond the ends; `None` where none is known.
fn bridge(known: &[(f64, [f64; 2])], time: f64) -> Option<[f64; 2]> {
    let after = known.partition_point(|(at, _)| *at < time);
    match (after.checked_sub(1).map(|before| known[before]), known.get(after)) {
        (Some((t0, a)), Some((t1, b))) => {
            let share = ((time - t0) / (t1 - t0).max(1e-9)).clamp(0.0, 1.0);
            Some([0, 1].map(|axis| a[axis] + share * (b[axis] - a[axis])))
        }
        (Some((_, only)), None) => Some(only),
        (None, first) => first.map(|(_, only)| *only),
    }
}

fn steadied(centres: &[[f64; 2]], times_seconds: &[f64], frame: usize) -> [f64; 2] {
    let now = times_seconds[frame];
    let from = times_seconds.partition_point(|time| *time < now - REACH * STEADY_SECONDS);
    let to = times_seconds.partition_point(|time| *time <= now + REACH * STEADY_SECONDS);
    let (mut sum, mut total) = ([0.0; 2], 0.0);
    for near in from..to {
        let weight = (-0.5 * ((times_seconds[near] - now) / STEADY_SECONDS).powi(2)).exp();
        total += weight;
        (0..2).for_each(|axis| sum[axis] += weight * centres[near][axis]);
    }
    sum.map(|value| value / total)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::crop::CropMotion;

    const FACE_PX: f32 = 50.0;

    fn face(x: f32) -> Vec<[f32; 3]> {
        vec![[x, 100.0, 0.0], [x + FACE_PX, 150.0, 0.0]]
    }

    fn of(faces: &[Option<Vec<[f32; 3]>>], motion: CropMotion) -> Option<Vec<CropSquare>> {
        let faces: Vec<Option<&Points>> = faces.iter().map(|face| face.as_deref()).collect();
        let times: Vec<f64> = (0..faces.len()).map(|frame| frame as f64 / 25.0).collect();
        motion.squares(&faces, &times)
    }

    #[test]
    fn a_head_that_walks_stays_in_a_small_square() {
        let mut faces: Vec<Option<Vec<[f32; 3]>>> = (0..200).map(|frame| Some(face(4.0 * frame as f32))).collect();
        faces[50] = Some(face(5000.0));
        faces[100..120].fill(None);
        faces[0] = Some(vec![[f32::NAN, 0.0, 0.0]]);
        let squares = of(&faces, CropMotion::Following).unwrap();
        let fixed = of(&faces, CropMotion::Fixed).unwrap();
        assert_eq!((squares.len(), fixed.len()), (200, 200));
        assert!(squares[0].side_px < 0.4 * fixed[0].side_px, "{} {}", squares[0].side_px, fixed[0].side_px);
        // Within a Gaussian's reach of the ends the centre lags, and the side allows for it.
        for (frame, square) in squares.iter().enumerate().take(162).skip(38) {
            let centre = square.left_px + square.side_px / 2.0;
            let head = 4.0 * frame as f32 + FACE_PX / 2.0;
            assert!((centre - head).abs() < 2.0, "frame {frame}: {centre} for {head}");
            assert_eq!(square.side_px, squares[0].side_px, "the scale is one for the clip");
        }
    }

    #[test]
    fn a_still_head_is_not_shaken_by_its_landmarks() {
        let faces: Vec<Option<Vec<[f32; 3]>>> =
            (0..100).map(|frame| Some(face(300.0 + if frame % 2 == 0 { 1.0 } else { -1.0 }))).collect();
        let squares = of(&faces, CropMotion::Following).unwrap();
        let moved = squares.windows(2).map(|pair| (pair[1].left_px - pair[0].left_px).abs()).fold(0.0, f32::max);
        assert!(moved < 0.1, "{moved}");
        assert_eq!(of(&[None, None], CropMotion::Following), None);
        assert_eq!(of(&[], CropMotion::Following), None);
        assert_eq!(of(&[None, Some(face(10.0)), None], CropMotion::Following).unwrap().len(), 3);
    }
}
