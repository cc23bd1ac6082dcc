//! The face as its landmarks outline it, and what hangs together with it.

use crate::crop::Points;

/// The face's outline in MediaPipe's mesh, once around.
const OVAL: [usize; 36] = [
    10, 338, 297, 332, 284, 251, 389, 356, 454, 323, 361, 288, 397, 365, 379, 378, 400, 377, 152, 148, 176, 149, 150,
    136, 172, 58, 132, 93, 234, 127, 162, 21, 54, 103, 67, 109,
];
/// In profile the outline bulges past the face: draw it a little smaller.
const SHRINK: f32 = 0.90;

/// 1 well inside the face, else 0; all 0 when landmarks are missing.
pub(super) fn face_mask(face: &Points, size: usize) -> Vec<f32> {
    let mut out = vec![0.0; size * size];
    let corners: Vec<[f32; 2]> = OVAL.iter().filter_map(|i| face.get(*i)).map(|p| [p[0], p[1]]).collect();
    if corners.len() < OVAL.len() || corners.iter().flatten().any(|value| !value.is_finite()) {
        return out;
    }
    let centre = [0, 1].map(|axis| corners.iter().map(|c| c[axis]).sum::<f32>() / corners.len() as f32);
    let corners: Vec<[f32; 2]> =
        corners.iter().map(|c| [0, 1].map(|axis| centre[axis] + SHRINK * (c[axis] - centre[axis]))).collect();
    for (y, row) in out.chunks_exact_mut(size).enumerate() {
        let line = y as f32 + 0.5;
        let mut crossings: Vec<f32> = Vec::new();
        for (a, b) in corners.iter().zip(corners.iter().cycle().skip(1)) {
            if (a[1] <= line) != (b[1] <= line) {
                crossings.push(a[0] + (line - a[1]) / (b[1] - a[1]) * (b[0] - a[0]));
            }
        }
        crossings.sort_by(f32::total_cmp);
        for [from, to] in crossings.as_chunks::<2>().0 {
            let column = |x: f32| ((x - 0.5).ceil().max(0.0) as usize).min(size);
            row[column(*from)..column(*to).max(column(*from))].fill(1.0);
        }
    }
    out
}

/// Clears what is not connected to the face through pixels of at least a half; without a face mask nothing changes.
pub(crate) fn keep_connected(alpha: &mut [f32], size: usize, face: &[f32]) {
    let mut kept = vec![false; alpha.len()];
    let mut open: Vec<usize> = (0..alpha.len()).filter(|i| face[*i] > 0.5).collect();
    if open.is_empty() {
        return;
    }
    open.iter().for_each(|i| kept[*i] = true);
    while let Some(i) = open.pop() {
        let (y, x) = (i / size, i % size);
        let neighbours = [
            (y > 0).then(|| i - size),
            (y + 1 < size).then_some(i + size),
            (x > 0).then(|| i - 1),
            (x + 1 < size).then_some(i + 1),
        ];
        for next in neighbours.into_iter().flatten() {
            if !kept[next] && alpha[next] >= 0.5 {
                kept[next] = true;
                open.push(next);
            }
        }
    }
    // Soft pixels within two steps of what is kept belong to its edge.
    for _ in 0..2 {
        let before = kept.clone();
        for i in 0..alpha.len() {
            let (y, x) = (i / size, i % size);
            let near = (y > 0 && before[i - size])
                || (y + 1 < size && before[i + size])
                || (x > 0 && before[i - 1])
                || (x + 1 < size && before[i + 1]);
            kept[i] |= near;
        }
    }
    alpha.iter_mut().zip(kept).filter(|(_, kept)| !kept).for_each(|(alpha, _)| *alpha = 0.0);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn oval(size: f32, angle: f32) -> Vec<[f32; 3]> {
        let mut face = vec![[0.0; 3]; 468];
        for (k, i) in OVAL.iter().enumerate() {
            let turn = k as f32 / OVAL.len() as f32 * std::f32::consts::TAU + angle;
            face[*i] = [size / 2.0 + size * 0.2 * turn.sin(), size * 0.4 - size * 0.25 * turn.cos(), 0.0];
        }
        face
    }

    #[test]
    fn the_face_is_filled() {
        let size = 128;
        let face = oval(size as f32, 0.0);
        let mask = face_mask(&face, size);
        assert_eq!((mask[51 * size + 64], mask[51 * size + 10], mask[120 * size + 64]), (1.0, 0.0, 0.0));
        let area = mask.iter().sum::<f32>() / (size * size) as f32;
        let want = std::f32::consts::PI * 0.2 * 0.25 * SHRINK * SHRINK;
        assert!((area - want).abs() < 0.03 * want, "{area} {want}");
        assert!(face_mask(&[], size).iter().all(|v| *v == 0.0));
    }

    #[test]
    fn only_what_touches_the_face_stays() {
        let size = 16;
        let mut alpha = vec![0.0; 256];
        let face: Vec<f32> = (0..256).map(|i| f32::from(u8::from(i / 16 == 4 && i % 16 == 4))).collect();
        (0..256).filter(|i| (3..7).contains(&(i / 16)) && (3..7).contains(&(i % 16))).for_each(|i| alpha[i] = 1.0);
        alpha[12 * 16 + 12] = 0.9;
        keep_connected(&mut alpha, size, &face);
        assert_eq!((alpha[6 * 16 + 6], alpha[12 * 16 + 12]), (1.0, 0.0));
    }
}
