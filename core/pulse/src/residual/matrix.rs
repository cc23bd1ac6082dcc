//! Row-major matrices of f32 or f64, their product through the `gemm` crate on one thread (so that the order of sums is
//! fixed), and the two-argument numbers the network needs.

use gemm::Parallelism;

/// f32 for speed, f64 as the judge: the network's text is written once over both.
pub trait Real:
    Copy
    + Send
    + Sync
    + 'static
    + Default
    + std::ops::Add<Output = Self>
    + std::ops::Sub<Output = Self>
    + std::ops::Mul<Output = Self>
    + std::ops::AddAssign
{
    /// 1.
    const ONE: Self;
    /// Rounds from f64.
    fn from_f64(value: f64) -> Self;
    /// Widens to f64.
    fn to_f64(self) -> f64;
    /// Hyperbolic tangent in place.
    fn tanh(values: &mut [Self]);
}

impl Real for f32 {
    const ONE: Self = 1.0;
    fn from_f64(value: f64) -> Self {
        value as f32
    }
    fn to_f64(self) -> f64 {
        f64::from(self)
    }
    fn tanh(values: &mut [Self]) {
        heartian_ops::activation::tanh(values);
    }
}

impl Real for f64 {
    const ONE: Self = 1.0;
    fn from_f64(value: f64) -> Self {
        value
    }
    fn to_f64(self) -> f64 {
        self
    }
    fn tanh(values: &mut [Self]) {
        for value in values {
            *value = f64::tanh(*value);
        }
    }
}

/// A borrowed matrix, possibly a transposed view.
#[derive(Clone, Copy)]
pub struct Matrix<'a, T> {
    data: &'a [T],
    rows: usize,
    columns: usize,
    transposed: bool,
}

impl<'a, T: Real> Matrix<'a, T> {
    /// `data` is rows×columns, row-major; shorter data shrink the number of rows.
    pub fn new(data: &'a [T], columns: usize) -> Self {
        Self { data, rows: data.len() / columns.max(1), columns, transposed: false }
    }

    /// The transpose, without moving anything.
    pub fn transpose(self) -> Self {
        Self { rows: self.columns, columns: self.rows, transposed: !self.transposed, ..self }
    }

    fn strides(&self) -> (isize, isize) {
        if self.transposed { (1, self.rows as isize) } else { (self.columns as isize, 1) }
    }
}

/// `output (+)= left · right`, row-major output of left.rows × right.columns.
///
/// Sizes are checked; a mismatch is a programming error of this crate and stops it.
pub fn multiply<T: Real>(output: &mut [T], left: Matrix<'_, T>, right: Matrix<'_, T>, accumulate: bool) {
    let (m, k, n) = (left.rows, left.columns, right.columns);
    assert!(right.rows == k && output.len() == m * n, "matrix product {m}×{k} by {}×{n}", right.rows);
    assert!(left.data.len() >= m * k && right.data.len() >= k * n, "a matrix holds fewer values than its size");
    let ((lrs, lcs), (rrs, rcs)) = (left.strides(), right.strides());
    // SAFETY: the three buffers hold m·n, m·k and k·n values as asserted above, the strides stay within them, and the
    // mutable output cannot overlap the shared inputs.
    unsafe {
        gemm::gemm(
            m,
            n,
            k,
            output.as_mut_ptr(),
            1,
            n as isize,
            accumulate,
            left.data.as_ptr(),
            lcs,
            lrs,
            right.data.as_ptr(),
            rcs,
            rrs,
            T::ONE,
            T::ONE,
            false,
            false,
            false,
            Parallelism::None,
        );
    }
}

/// Adds `row` to every row of `matrix`.
pub fn add_row<T: Real>(matrix: &mut [T], row: &[T]) {
    for values in matrix.chunks_exact_mut(row.len()) {
        add(values, row);
    }
}

/// `left += right`.
pub fn add<T: Real>(left: &mut [T], right: &[T]) {
    for (left, right) in left.iter_mut().zip(right) {
        *left += *right;
    }
}

/// `left += scale · right`.
pub fn add_scaled<T: Real>(left: &mut [T], scale: T, right: &[T]) {
    for (left, right) in left.iter_mut().zip(right) {
        *left += scale * *right;
    }
}

/// Sum of products in a fixed order.
pub fn dot<T: Real>(left: &[T], right: &[T]) -> T {
    let mut lanes = [T::default(); 8];
    let (blocks, tail) = left.as_chunks::<8>();
    let (right_blocks, right_tail) = right.as_chunks::<8>();
    for (a, b) in blocks.iter().zip(right_blocks) {
        for lane in 0..8 {
            lanes[lane] += a[lane] * b[lane];
        }
    }
    let mut sum = T::default();
    for lane in lanes {
        sum += lane;
    }
    for (a, b) in tail.iter().zip(right_tail) {
        sum += *a * *b;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_agree_with_the_definition_in_every_orientation() {
        let a: Vec<f64> = (0..6).map(|k| f64::from(k) - 2.0).collect();
        let b: Vec<f64> = (0..12).map(|k| f64::from(k * k) * 0.1).collect();
        let at = |m: &[f64], columns: usize, i: usize, j: usize| m[i * columns + j];
        let mut c = vec![1.0; 8];
        multiply(&mut c, Matrix::new(&a, 3), Matrix::new(&b, 4), true);
        let mut d = vec![0.0; 9];
        multiply(&mut d, Matrix::new(&a, 3).transpose(), Matrix::new(&a, 3), false);
        for i in 0..2 {
            for j in 0..4 {
                let want = 1.0 + (0..3).map(|k| at(&a, 3, i, k) * at(&b, 4, k, j)).sum::<f64>();
                assert!((at(&c, 4, i, j) - want).abs() < 1e-12);
            }
        }
        for i in 0..3 {
            for j in 0..3 {
                let want = (0..2).map(|k| at(&a, 3, k, i) * at(&a, 3, k, j)).sum::<f64>();
                assert!((at(&d, 3, i, j) - want).abs() < 1e-12);
            }
        }
    }
}
