//! Eigenvalues and eigenvectors of small symmetric matrices by cyclic Jacobi rotations, in f64.

/// Sweeps before giving up; ten suffice for any matrix met here.
const SWEEPS: usize = 60;

/// Eigenvalues, largest first, and the matching eigenvectors: `vectors[k]` has length `n`.
#[derive(Clone, Debug)]
pub struct Eigen {
    /// `n` values, decreasing.
    pub values: Vec<f64>,
    /// `n` orthonormal vectors.
    pub vectors: Vec<Vec<f64>>,
}

/// Decomposes the symmetric `n×n` matrix `a` (row-major; only its upper half is trusted).
pub fn symmetric_eigen(n: usize, a: &[f64]) -> Eigen {
    let mut a: Vec<f64> = (0..n * n).map(|i| if i / n <= i % n { a[i] } else { a[(i % n) * n + i / n] }).collect();
    let mut v: Vec<f64> = (0..n * n).map(|i| if i / n == i % n { 1.0 } else { 0.0 }).collect();
    let total: f64 = a.iter().map(|x| x * x).sum();
    for _ in 0..SWEEPS {
        let off: f64 = (0..n * n).filter(|i| i / n != i % n).map(|i| a[i] * a[i]).sum();
        if off <= 1e-28 * total {
            break;
        }
        for p in 0..n {
            for q in p + 1..n {
                rotate(n, &mut a, &mut v, (p, q));
            }
        }
    }
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|&i, &j| a[j * n + j].total_cmp(&a[i * n + i]).then(i.cmp(&j)));
    Eigen {
        values: order.iter().map(|&k| a[k * n + k]).collect(),
        vectors: order.iter().map(|&k| (0..n).map(|i| v[i * n + k]).collect()).collect(),
    }
}

fn rotate(n: usize, a: &mut [f64], v: &mut [f64], (p, q): (usize, usize)) {
    let apq = a[p * n + q];
    if apq == 0.0 {
        return;
    }
    let theta = (a[q * n + q] - a[p * n + p]) / (2.0 * apq);
    let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
    let t = if theta == 0.0 { 1.0 } else { t };
    let c = 1.0 / (t * t + 1.0).sqrt();
    let s = t * c;
    for k in 0..n {
        let (x, y) = (a[k * n + p], a[k * n + q]);
        (a[k * n + p], a[k * n + q]) = (c * x - s * y, s * x + c * y);
    }
    for k in 0..n {
        let (x, y) = (a[p * n + k], a[q * n + k]);
        (a[p * n + k], a[q * n + k]) = (c * x - s * y, s * x + c * y);
        let (x, y) = (v[k * n + p], v[k * n + q]);
        (v[k * n + p], v[k * n + q]) = (c * x - s * y, s * x + c * y);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_parts_give_the_matrix_back() {
        let n = 7;
        let a: Vec<f64> = (0..n * n)
            .map(|i| {
                let (r, c) = ((i / n).min(i % n), (i / n).max(i % n));
                ((r * 31 + c * 17) % 13) as f64 - 6.0
            })
            .collect();
        let Eigen { values, vectors } = symmetric_eigen(n, &a);
        assert!(values.is_sorted_by(|x, y| x >= y));
        for r in 0..n {
            for c in 0..n {
                let back: f64 = (0..n).map(|k| values[k] * vectors[k][r] * vectors[k][c]).sum();
                assert!((back - a[r * n + c]).abs() < 1e-9, "{r} {c}");
            }
        }
        assert!(symmetric_eigen(0, &[]).values.is_empty());
        assert_eq!(symmetric_eigen(2, &[0.0; 4]).values, [0.0, 0.0]);
    }
}
