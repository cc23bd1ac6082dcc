//! Eigenvalues of small symmetric matrices by cyclic Jacobi rotations.
#![expect(clippy::needless_range_loop, reason = "rows and columns of a matrix are clearest by index")]

/// Sweeps after which a matrix of at most nine rows has long converged (quadratic convergence; 6–8 are typical).
const MAX_SWEEPS: usize = 60;

/// Eigenvalues and eigenvectors of a symmetric `N×N` matrix: `vectors[k]` belongs to `values[k]`, unordered, orthonormal.
pub(super) struct Eigen<const N: usize> {
    pub(super) values: [f64; N],
    pub(super) vectors: [[f64; N]; N],
}

/// Decomposes a symmetric matrix (the upper triangle is read).
pub(super) fn symmetric<const N: usize>(matrix: [[f64; N]; N]) -> Eigen<N> {
    let mut a = matrix;
    let mut vectors = [[0.0; N]; N];
    for (k, row) in vectors.iter_mut().enumerate() {
        row[k] = 1.0;
    }
    for _ in 0..MAX_SWEEPS {
        let mut rotated = false;
        for p in 0..N {
            for q in p + 1..N {
                if a[p][q].abs() <= f64::EPSILON * 1e-3 * a[p][p].abs().sqrt() * a[q][q].abs().sqrt() {
                    continue;
                }
                rotated = true;
                rotate(&mut a, &mut vectors, p, q);
            }
        }
        if !rotated {
            break;
        }
    }
    Eigen { values: std::array::from_fn(|k| a[k][k]), vectors }
}

/// Annihilates `a[p][q]`, keeping the matrix symmetric, and turns the eigenvectors along.
fn rotate<const N: usize>(a: &mut [[f64; N]; N], vectors: &mut [[f64; N]; N], p: usize, q: usize) {
    let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
    let tangent = theta.signum() / (theta.abs() + theta.hypot(1.0));
    let cosine = tangent.hypot(1.0).recip();
    let sine = tangent * cosine;
    let shift = tangent * a[p][q];
    a[p][p] -= shift;
    a[q][q] += shift;
    (a[p][q], a[q][p]) = (0.0, 0.0);
    for k in (0..N).filter(|&k| k != p && k != q) {
        let (x, y) = (a[k][p], a[k][q]);
        (a[k][p], a[k][q]) = (cosine * x - sine * y, sine * x + cosine * y);
        (a[p][k], a[q][k]) = (a[k][p], a[k][q]);
    }
    for k in 0..N {
        let (x, y) = (vectors[p][k], vectors[q][k]);
        (vectors[p][k], vectors[q][k]) = (cosine * x - sine * y, sine * x + cosine * y);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rebuilds_the_matrix() {
        let mut a = [[0.0; 6]; 6];
        for i in 0..6 {
            for j in 0..6 {
                a[i][j] = 1.0 / (i + j + 1) as f64 + if i == j { -0.4 } else { 0.0 };
            }
        }
        let eigen = symmetric(a);
        for i in 0..6 {
            for j in 0..6 {
                let sum = |f: &dyn Fn(usize) -> f64| (0..6).map(f).sum::<f64>();
                let rebuilt = sum(&|k| eigen.values[k] * eigen.vectors[k][i] * eigen.vectors[k][j]);
                let dot = sum(&|k| eigen.vectors[i][k] * eigen.vectors[j][k]);
                assert!((rebuilt - a[i][j]).abs() < 1e-13);
                assert!((dot - f64::from(i == j)).abs() < 1e-13);
            }
        }
        assert_eq!(symmetric([[0.0; 3]; 3]).values, [0.0; 3]);
    }
}
