//! Small dense symmetric systems in f64: sums of products of columns, Cholesky, inverse.
//!
//! Matrices are row-major `n×n`; sums run in a fixed order, so results do not depend on threads.

/// Sum of products with eight interleaved partial sums: vectorises, and always in the same order.
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 8];
    let (a_chunks, a_rest) = a.as_chunks::<8>();
    let (b_chunks, b_rest) = b.as_chunks::<8>();
    for (x, y) in a_chunks.iter().zip(b_chunks) {
        for lane in 0..8 {
            sums[lane] += x[lane] * y[lane];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(x, y)| x * y).sum();
    (sums[0] + sums[4]) + (sums[1] + sums[5]) + (sums[2] + sums[6]) + (sums[3] + sums[7]) + rest
}

/// Factors `matrix` in place into its lower Cholesky factor (the upper triangle is left as it was). Returns `false`
/// when it is not positive definite.
#[must_use]
pub fn cholesky(matrix: &mut [f64], n: usize) -> bool {
    for j in 0..n {
        let (head, tail) = matrix.split_at_mut(j * n + j);
        let row_j = &head[j * n..];
        let pivot = tail[0] - dot(row_j, row_j);
        if !(pivot > 0.0 && pivot.is_finite()) {
            return false;
        }
        let diagonal = pivot.sqrt();
        matrix[j * n + j] = diagonal;
        for i in j + 1..n {
            let (upper, lower) = matrix.split_at_mut(i * n);
            let sum = dot(&upper[j * n..j * n + j], &lower[..j]);
            lower[j] = (lower[j] - sum) / diagonal;
        }
    }
    true
}

/// Solves `L·Lᵀ·x = b` in place, given the factor.
pub fn solve(factor: &[f64], n: usize, b: &mut [f64]) {
    forward(factor, n, b);
    for i in (0..n).rev() {
        b[i] /= factor[i * n + i];
        for j in 0..i {
            b[j] -= factor[i * n + j] * b[i];
        }
    }
}

/// Solves `L·x = b` in place.
pub fn forward(factor: &[f64], n: usize, b: &mut [f64]) {
    for i in 0..n {
        let sum = dot(&factor[i * n..i * n + i], &b[..i]);
        b[i] = (b[i] - sum) / factor[i * n + i];
    }
}

/// Solves `(matrix + damping·diag(matrix) + tiny)·x = b`, leaving out unknowns marked as held (their x is 0).
/// `None` when the system is not positive definite.
pub fn damped_solve(matrix: &[f64], b: &[f64], damping: f64, held: &[bool]) -> Option<Vec<f64>> {
    let n = b.len();
    let mut system = matrix.to_vec();
    let mut x = b.to_vec();
    for i in 0..n {
        let diagonal = system[i * n + i];
        system[i * n + i] = diagonal * (1.0 + damping) + 1e-9;
        if held.get(i).copied().unwrap_or(false) {
            for j in 0..n {
                system[i * n + j] = 0.0;
                system[j * n + i] = 0.0;
            }
            system[i * n + i] = 1.0;
            x[i] = 0.0;
        }
    }
    if !cholesky(&mut system, n) {
        return None;
    }
    solve(&system, n, &mut x);
    x.iter().all(|value| value.is_finite()).then_some(x)
}

/// Products of all pairs of columns: `width × width`, row-major and symmetric, from `width × rows` columns.
pub fn gram(columns: &[f64], rows: usize) -> Vec<f64> {
    let width = columns.len().checked_div(rows).unwrap_or(0);
    let across = Strided { values: columns, row: rows, column: 1 };
    let down = Strided { values: columns, row: 1, column: rows };
    multiply([width, rows, width], across, down)
}

/// `A·Σ·Aᵀ` of square row-major matrices.
pub fn congruent(a: &[f64], middle: &[f64], n: usize) -> Vec<f64> {
    let plain = |values| Strided { values, row: n, column: 1 };
    let half = multiply([n; 3], plain(a), plain(middle));
    multiply([n; 3], plain(&half), Strided { values: a, row: 1, column: n })
}

/// The inverse of `L·Lᵀ`, given the factor: symmetric, row-major.
pub fn inverse(factor: &[f64], n: usize) -> Vec<f64> {
    // Columns of L⁻¹: their products are the inverse.
    let mut columns = vec![0.0; n * n];
    for k in 0..n {
        let column = &mut columns[k * n..(k + 1) * n];
        column[k] = 1.0;
        forward(factor, n, column);
    }
    gram(&columns, n)
}

/// A matrix in a slice: the distance of neighbours in a column and in a row.
#[derive(Clone, Copy)]
struct Strided<'a> {
    values: &'a [f64],
    row: usize,
    column: usize,
}

impl Strided<'_> {
    fn covers(&self, rows: usize, columns: usize) -> bool {
        rows == 0 || columns == 0 || (rows - 1) * self.row + (columns - 1) * self.column < self.values.len()
    }
}

/// Product of a `rows × inner` and an `inner × columns` matrix, row-major.
fn multiply([rows, inner, columns]: [usize; 3], a: Strided, b: Strided) -> Vec<f64> {
    assert!(a.covers(rows, inner) && b.covers(inner, columns), "a matrix is smaller than its product needs");
    let mut matrix = vec![0.0; rows * columns];
    // SAFETY: `covers` has checked that every element read lies inside the operands; the result is `rows·columns` values,
    // exactly `matrix`, which nothing else borrows.
    unsafe {
        gemm::gemm(
            rows,
            columns,
            inner,
            matrix.as_mut_ptr(),
            1,
            columns as isize,
            false,
            a.values.as_ptr(),
            a.column as isize,
            a.row as isize,
            b.values.as_ptr(),
            b.column as isize,
            b.row as isize,
            0.0,
            1.0,
            false,
            false,
            false,
            gemm::Parallelism::None,
        );
    }
    matrix
}

/// A tall matrix by columns, its right-hand side the last one: the rows of a weighted least-squares problem.
pub struct Design {
    /// Number of rows.
    pub rows: usize,
    /// Number of unknowns.
    pub width: usize,
    /// `(width + 1) × rows`; the last column is the residual.
    pub columns: Vec<f64>,
}

impl Design {
    /// All zeros.
    pub fn new(rows: usize, width: usize) -> Self {
        Self { rows, width, columns: vec![0.0; rows * (width + 1)] }
    }

    /// One column; column `width` is the residual.
    #[cfg(test)]
    pub fn column(&self, k: usize) -> &[f64] {
        &self.columns[k * self.rows..(k + 1) * self.rows]
    }

    /// `JᵀJ` and `Jᵀr`.
    pub fn normal(&self) -> (Vec<f64>, Vec<f64>) {
        let product = gram(&self.columns, self.rows);
        let rows = product.chunks(self.width + 1).take(self.width);
        let matrix = rows.clone().flat_map(|row| &row[..self.width]).copied().collect();
        (matrix, rows.map(|row| row[self.width]).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fast_product_is_the_plain_one() {
        let columns: Vec<f64> = (0..7 * 33).map(|k| (0.7 * f64::from(k)).sin()).collect();
        let fast = gram(&columns, 33);
        for i in 0..7 {
            for j in 0..7 {
                let plain: f64 = (0..33).map(|k| columns[33 * i + k] * columns[33 * j + k]).sum();
                assert!((fast[7 * i + j] - plain).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn an_inverse_undoes_its_matrix_and_a_congruence_is_the_plain_product() {
        let matrix = [4.0, 1.0, 0.5, 1.0, 3.0, 0.2, 0.5, 0.2, 2.0];
        let mut factor = matrix;
        assert!(cholesky(&mut factor, 3));
        let inverse = inverse(&factor, 3);
        let sandwich = congruent(&matrix, &inverse, 3);
        for (found, plain) in sandwich.iter().zip(matrix) {
            assert!((found - plain).abs() < 1e-12, "A·A⁻¹·Aᵀ = A: {found} {plain}");
        }
    }

    #[test]
    fn solves_what_it_factored_and_refuses_the_indefinite() {
        let matrix = [4.0, 1.0, 0.5, 1.0, 3.0, 0.2, 0.5, 0.2, 2.0];
        let x = damped_solve(&matrix, &[1.0, -2.0, 3.0], 0.0, &[]);
        let x = x.unwrap_or_default();
        for (row, b) in matrix.chunks(3).zip([1.0, -2.0, 3.0]) {
            assert!((dot(row, &x) - b).abs() < 1e-7);
        }
        let held = damped_solve(&matrix, &[1.0, -2.0, 3.0], 0.0, &[false, true, false]).unwrap_or_default();
        assert_eq!(held[1], 0.0);
        assert!((4.0 * held[0] + 0.5 * held[2] - 1.0).abs() < 1e-7);
        assert!(damped_solve(&[1.0, 2.0, 2.0, 1.0], &[1.0, 1.0], 0.0, &[]).is_none());
    }
}
