//! Small dense linear systems, in f64.

/// Solves a symmetric positive definite system by Cholesky's decomposition; the lower half of `a` is used. A pivot that
/// is not positive is lifted to 1e-30, so a singular system gives large numbers rather than none.
pub(crate) fn solve<const N: usize>(mut a: [[f64; N]; N], mut b: [f64; N]) -> [f64; N] {
    solve_in_place(a.as_flattened_mut(), &mut b);
    b
}

/// The same for `b.len()` unknowns with `a` row by row; `b` becomes the solution, `a` its decomposition.
pub(crate) fn solve_in_place(a: &mut [f64], b: &mut [f64]) {
    let n = b.len();
    for i in 0..n {
        for j in 0..=i {
            let dot: f64 = (0..j).map(|k| a[i * n + k] * a[j * n + k]).sum();
            let rest = a[i * n + j] - dot;
            a[i * n + j] = if i == j { rest.max(1e-30).sqrt() } else { rest / a[j * n + j] };
        }
    }
    for i in 0..n {
        b[i] = (b[i] - (0..i).map(|k| a[i * n + k] * b[k]).sum::<f64>()) / a[i * n + i];
    }
    for i in (0..n).rev() {
        b[i] = (b[i] - (i + 1..n).map(|k| a[k * n + i] * b[k]).sum::<f64>()) / a[i * n + i];
    }
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
