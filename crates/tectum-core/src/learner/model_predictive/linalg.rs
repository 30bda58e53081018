//! Dense linear algebra in double precision with a fixed order of summation.
//!
//! Symmetric and lower triangular matrices of order `n` are packed by rows: row `r` has the `r + 1` numbers up to
//! the diagonal and begins at `r (r + 1) / 2`. Sums of products keep eight partial sums, whatever the width of the
//! machine's registers, and no multiplication is fused with an addition. So the bits are the same on every machine.

/// The number of partial sums.
const LANES: usize = 8;

/// The first number of row `row` in a packed triangle; also the length of a packed triangle of order `row`.
#[inline]
pub fn packed(row: usize) -> usize {
    row * (row + 1) / 2
}

/// The sum of the products of two rows of equal length.
#[inline]
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; LANES];
    let (a, a_rest) = a.as_chunks::<LANES>();
    let (b, b_rest) = b.as_chunks::<LANES>();
    for (a, b) in a.iter().zip(b) {
        for lane in 0..LANES {
            sums[lane] += a[lane] * b[lane];
        }
    }
    for (lane, (a, b)) in a_rest.iter().zip(b_rest).enumerate() {
        sums[lane] += a * b;
    }
    let [a, b, c, d, e, f, g, h] = sums;
    ((a + b) + (c + d)) + ((e + f) + (g + h))
}

/// Adds `factor` times `x` to `y`.
#[inline]
pub fn add_scaled(y: &mut [f64], factor: f64, x: &[f64]) {
    for (y, x) in y.iter_mut().zip(x) {
        *y += factor * x;
    }
}

/// Writes the product of a packed symmetric matrix and `x` to `out`.
pub fn multiply_symmetric(matrix: &[f64], x: &[f64], out: &mut [f64]) {
    for r in 0..x.len() {
        let row = &matrix[packed(r)..packed(r + 1)];
        add_scaled(&mut out[..r], x[r], &row[..r]);
        out[r] = dot(&row[..r], &x[..r]) + row[r] * x[r];
    }
}

/// Adds `factor` times `x xᵀ` to a packed symmetric matrix.
pub fn add_outer(matrix: &mut [f64], factor: f64, x: &[f64]) {
    for r in 0..x.len() {
        add_scaled(&mut matrix[packed(r)..packed(r + 1)], factor * x[r], &x[..=r]);
    }
}

/// Turns row `r` of a packed symmetric matrix into row `r` of its Cholesky factor `L`; the rows above are `L`'s
/// already. Returns false if the matrix is not positive definite.
#[must_use]
pub fn cholesky_row(matrix: &mut [f64], r: usize) -> bool {
    let (above, row) = matrix.split_at_mut(packed(r));
    for c in 0..r {
        let other = &above[packed(c)..packed(c + 1)];
        row[c] = (row[c] - dot(&row[..c], &other[..c])) / other[c];
    }
    let pivot = row[r] - dot(&row[..r], &row[..r]);
    row[r] = pivot.max(0.0).sqrt();
    pivot > 0.0
}

/// Cholesky factor `L` of a packed symmetric matrix of order `n`, in place.
#[must_use]
pub fn cholesky(matrix: &mut [f64], n: usize) -> bool {
    (0..n).all(|r| cholesky_row(matrix, r))
}

/// Solves `L x = b` in place.
pub fn solve_lower(lower: &[f64], x: &mut [f64]) {
    for r in 0..x.len() {
        let row = &lower[packed(r)..packed(r + 1)];
        x[r] = (x[r] - dot(&row[..r], &x[..r])) / row[r];
    }
}

/// Solves `Lᵀ x = b` in place.
pub fn solve_lower_transposed(lower: &[f64], x: &mut [f64]) {
    for r in (0..x.len()).rev() {
        let row = &lower[packed(r)..packed(r + 1)];
        x[r] /= row[r];
        let value = x[r];
        add_scaled(&mut x[..r], -value, &row[..r]);
    }
}

/// Turns row `r` of `L` into row `r` of its inverse; the rows above are the inverse's already. `scratch` has room
/// for a row.
pub fn invert_lower_row(lower: &mut [f64], r: usize, scratch: &mut [f64]) {
    let (above, row) = lower.split_at_mut(packed(r));
    let row = &mut row[..=r];
    let inverse = 1.0 / row[r];
    scratch[..r].fill(0.0);
    for k in 0..r {
        add_scaled(&mut scratch[..=k], row[k], &above[packed(k)..packed(k + 1)]);
    }
    for (to, sum) in row.iter_mut().zip(&scratch[..r]) {
        *to = -inverse * sum;
    }
    row[r] = inverse;
}

/// Turns row `r` of `L⁻¹` into row `r` of `factor L⁻ᵀ L⁻¹`, the inverse of the matrix times `factor`. Rows are done
/// in rising order; those below are `L⁻¹`'s still. `n` is the order of the matrix.
pub fn invert_row(lower: &mut [f64], n: usize, r: usize, factor: f64, scratch: &mut [f64]) {
    scratch[..=r].fill(0.0);
    for k in r..n {
        let row = &lower[packed(k)..packed(k + 1)];
        add_scaled(&mut scratch[..=r], factor * row[r], &row[..=r]);
    }
    lower[packed(r)..packed(r + 1)].copy_from_slice(&scratch[..=r]);
}

/// The inverse of a matrix from its Cholesky factor, in place.
pub fn invert(lower: &mut [f64], n: usize, scratch: &mut [f64]) {
    for r in 0..n {
        invert_lower_row(lower, r, scratch);
    }
    for r in 0..n {
        invert_row(lower, n, r, 1.0, scratch);
    }
}

/// Makes the full symmetric `matrix` of order `n` (rows of `n`) negative semidefinite: positive eigenvalues become
/// 0. Cyclic Jacobi rotations (Golub & Van Loan, "Matrix Computations", 8.5); `vectors` and `copy` have room for
/// `n * n` numbers. A matrix that has a Cholesky factor with the sign turned is left as it is.
pub fn clip_to_concave(matrix: &mut [f64], n: usize, copy: &mut [f64], vectors: &mut [f64]) {
    for r in 0..n {
        for c in 0..=r {
            copy[packed(r) + c] = -matrix[r * n + c];
        }
    }
    if cholesky(copy, n) {
        return;
    }
    copy[..n * n].copy_from_slice(&matrix[..n * n]);
    jacobi(copy, n, vectors);
    matrix[..n * n].fill(0.0);
    for k in 0..n {
        let value = copy[k * n + k];
        if value < 0.0 {
            let vector = &vectors[k * n..(k + 1) * n];
            for r in 0..n {
                add_scaled(&mut matrix[r * n..(r + 1) * n], value * vector[r], vector);
            }
        }
    }
}

/// Diagonalises the full symmetric `matrix`; row `k` of `vectors` becomes the eigenvector of entry `k, k`.
fn jacobi(matrix: &mut [f64], n: usize, vectors: &mut [f64]) {
    vectors[..n * n].fill(0.0);
    for k in 0..n {
        vectors[k * n + k] = 1.0;
    }
    let scale: f64 = matrix[..n * n].iter().map(|x| x * x).sum();
    for _ in 0..8 {
        let mut off = 0.0;
        for p in 0..n {
            for q in 0..p {
                off += matrix[p * n + q] * matrix[p * n + q];
            }
        }
        if off <= 1e-18 * scale {
            return;
        }
        let threshold = 1e-3 * off / (n * n) as f64;
        for p in 0..n {
            for q in 0..p {
                let value = matrix[p * n + q];
                if value * value > threshold {
                    rotate(matrix, vectors, n, p, q);
                }
            }
        }
    }
}

/// The Jacobi rotation that makes entry `p, q` zero.
fn rotate(matrix: &mut [f64], vectors: &mut [f64], n: usize, p: usize, q: usize) {
    let theta = (matrix[q * n + q] - matrix[p * n + p]) / (2.0 * matrix[p * n + q]);
    let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
    let t = if theta == 0.0 { 1.0 } else { t };
    let c = 1.0 / (t * t + 1.0).sqrt();
    let s = t * c;
    for k in 0..n {
        let (a, b) = (matrix[k * n + p], matrix[k * n + q]);
        matrix[k * n + p] = c * a - s * b;
        matrix[k * n + q] = s * a + c * b;
    }
    for rows in [matrix, vectors] {
        let (low, high) = rows.split_at_mut(p * n);
        let (row_q, row_p) = (&mut low[q * n..(q + 1) * n], &mut high[..n]);
        for (a, b) in row_p.iter_mut().zip(row_q) {
            (*a, *b) = (c * *a - s * *b, s * *a + c * *b);
        }
    }
}
