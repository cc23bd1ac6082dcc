//! Small dense linear systems, in f64.

/// Solves a symmetric positive definite system by Cholesky's decomposition; the lower half of `a` is used. A pivot that
/// is not positive is lifted to 1e-30, so a singular system gives large numbers rather than none.
pub(crate) fn solve<const N: usize>(mut a: [[f64; N]; N], mut b: [f64; N]) -> [f64; N] {
    for i in 0..N {
        for j in 0..=i {
            let dot: f64 = (0..j).map(|k| a[i][k] * a[j][k]).sum();
            a[i][j] = if i == j { (a[i][i] - dot).max(1e-30).sqrt() } else { (a[i][j] - dot) / a[j][j] };
        }
    }
    for i in 0..N {
        b[i] = (b[i] - (0..i).map(|k| a[i][k] * b[k]).sum::<f64>()) / a[i][i];
    }
    for i in (0..N).rev() {
        b[i] = (b[i] - (i + 1..N).map(|k| a[k][i] * b[k]).sum::<f64>()) / a[i][i];
    }
    b
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_solution_satisfies_the_system() {
        let a: [[f64; 4]; 4] = std::array::from_fn(|i| {
            std::array::from_fn(|j| if i == j { 5.0 + i as f64 } else { ((i.min(j) * 3 + i.max(j)) % 4) as f64 - 1.5 })
        });
        let b = [1.0, -2.0, 0.5, 3.0];
        let x = solve(a, b);
        for i in 0..4 {
            assert!(((0..4).map(|j| a[i][j] * x[j]).sum::<f64>() - b[i]).abs() < 1e-12);
        }
    }
}
