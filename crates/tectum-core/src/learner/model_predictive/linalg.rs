//! Dense linear algebra in double precision with a fixed order of summation.
//!
//! Symmetric and lower triangular matrices of order `n` are packed by rows: row `r` has the `r + 1` numbers up to
//! the diagonal and begins at `r (r + 1) / 2`. Sums of products keep eight partial sums, whatever the width of the
//! machine's registers, and no multiplication is fused with an addition. So the bits are the same on every machine.
//!
//! The loops are plain ones, compiled twice: for the instruction set of the build, and for AVX2, which the `wide!`
//! functions use where the machine has it ([`SimdPath`]).

use tectum_encoder::simd::{F32x8, Kernel, SimdPath};

/// The number of partial sums.
const LANES: usize = 8;

/// Rows shorter than this are not worth a choice between two loops.
const SHORT: usize = 24;

/// A function that runs a loop on the machine's best path, and its kernel. The loop has to be `#[inline(always)]`, like
/// all that it calls.
macro_rules! wide {
    (
        $(#[$doc:meta])*
        $name:ident, $on_path:ident, $kernel:ident, $plain:ident($($arg:ident: $ty:ty),+) -> $out:ty
    ) => {
        struct $kernel<'a>($($ty),+, std::marker::PhantomData<&'a ()>);

        impl Kernel for $kernel<'_> {
            type Output = $out;

            #[inline(always)]
            fn run<L: F32x8>(self) -> $out {
                let Self($($arg),+, _) = self;
                $plain($($arg),+)
            }
        }

        $(#[$doc])*
        #[inline]
        pub fn $name<'a>($($arg: $ty),+) -> $out {
            $on_path(SimdPath::best_narrow(), $($arg),+)
        }

        /// The same on a path of the machine.
        #[inline]
        pub fn $on_path<'a>(path: SimdPath, $($arg: $ty),+) -> $out {
            path.run($kernel::<'a>($($arg),+, std::marker::PhantomData))
        }
    };
}
pub(super) use wide;

/// The first number of row `row` in a packed triangle; also the length of a packed triangle of order `row`.
#[inline]
pub fn packed(row: usize) -> usize {
    row * (row + 1) / 2
}

/// The sum of the products of two rows of equal length.
#[inline]
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    if a.len() < SHORT { plain_dot(a, b) } else { wide_dot(a, b) }
}

/// Adds `factor` times `x` to `y`.
#[inline]
pub fn add_scaled(y: &mut [f64], factor: f64, x: &[f64]) {
    if x.len() < SHORT { plain_add_scaled(y, factor, x) } else { wide_add_scaled(y, factor, x) }
}

wide! { wide_dot, dot_on, Dot, plain_dot(a: &'a [f64], b: &'a [f64]) -> f64 }
wide! { wide_add_scaled, add_scaled_on, AddScaled, plain_add_scaled(y: &'a mut [f64], factor: f64, x: &'a [f64]) -> () }

#[inline(always)]
fn plain_dot(a: &[f64], b: &[f64]) -> f64 {
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

#[inline(always)]
fn plain_add_scaled(y: &mut [f64], factor: f64, x: &[f64]) {
    for (y, x) in y.iter_mut().zip(x) {
        *y += factor * x;
    }
}

wide! {
    /// Writes the product of a packed symmetric matrix and `x` to `out`.
    multiply_symmetric, multiply_symmetric_on, MultiplySymmetric,
    plain_multiply_symmetric(matrix: &'a [f64], x: &'a [f64], out: &'a mut [f64]) -> ()
}

#[inline(always)]
fn plain_multiply_symmetric(matrix: &[f64], x: &[f64], out: &mut [f64]) {
    for r in 0..x.len() {
        let row = &matrix[packed(r)..packed(r + 1)];
        plain_add_scaled(&mut out[..r], x[r], &row[..r]);
        out[r] = plain_dot(&row[..r], &x[..r]) + row[r] * x[r];
    }
}

wide! {
    /// Adds `factor` times `x xᵀ` to a packed symmetric matrix.
    add_outer, add_outer_on, AddOuter, plain_add_outer(matrix: &'a mut [f64], factor: f64, x: &'a [f64]) -> ()
}

#[inline(always)]
fn plain_add_outer(matrix: &mut [f64], factor: f64, x: &[f64]) {
    for r in 0..x.len() {
        plain_add_scaled(&mut matrix[packed(r)..packed(r + 1)], factor * x[r], &x[..=r]);
    }
}

wide! {
    /// Adds `Jᵀ V J` to `to` (w x w), for `J` (n x w) and `V` (n x n); `product` (n x w) is then `V J`. Zeros of `J`
    /// and `V`, of which there are many, are passed over.
    add_congruence, add_congruence_on, AddCongruence,
    plain_add_congruence(
        to: &'a mut [f64], jacobian: &'a [f64], inner: &'a [f64], product: &'a mut [f64], width: usize
    ) -> ()
}

#[inline(always)]
fn plain_add_congruence(to: &mut [f64], jacobian: &[f64], inner: &[f64], product: &mut [f64], width: usize) {
    let n = jacobian.len() / width;
    product.fill(0.0);
    for (product, inner) in product.chunks_exact_mut(width).zip(inner.chunks_exact(n)) {
        for (factor, row) in inner.iter().zip(jacobian.chunks_exact(width)) {
            if *factor != 0.0 {
                plain_add_scaled(product, *factor, row);
            }
        }
    }
    for (product, row) in product.chunks_exact(width).zip(jacobian.chunks_exact(width)) {
        for (factor, to) in row.iter().zip(to.chunks_exact_mut(width)) {
            if *factor != 0.0 {
                plain_add_scaled(to, *factor, product);
            }
        }
    }
}

wide! {
    /// Turns row `r` of a packed symmetric matrix into row `r` of its Cholesky factor `L`; the rows above are `L`'s
    /// already. Returns false if the matrix is not positive definite.
    #[must_use]
    cholesky_row, cholesky_row_on, CholeskyRow, plain_cholesky_row(matrix: &'a mut [f64], r: usize) -> bool
}

#[inline(always)]
fn plain_cholesky_row(matrix: &mut [f64], r: usize) -> bool {
    let (above, row) = matrix.split_at_mut(packed(r));
    for c in 0..r {
        let other = &above[packed(c)..packed(c + 1)];
        row[c] = (row[c] - plain_dot(&row[..c], &other[..c])) / other[c];
    }
    let pivot = row[r] - plain_dot(&row[..r], &row[..r]);
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

wide! {
    /// Turns row `r` of `L` into row `r` of its inverse; the rows above are the inverse's already. `scratch` has room
    /// for a row.
    invert_lower_row, invert_lower_row_on, InvertLowerRow,
    plain_invert_lower_row(lower: &'a mut [f64], r: usize, scratch: &'a mut [f64]) -> ()
}

#[inline(always)]
fn plain_invert_lower_row(lower: &mut [f64], r: usize, scratch: &mut [f64]) {
    let (above, row) = lower.split_at_mut(packed(r));
    let row = &mut row[..=r];
    let inverse = 1.0 / row[r];
    scratch[..r].fill(0.0);
    for k in 0..r {
        plain_add_scaled(&mut scratch[..=k], row[k], &above[packed(k)..packed(k + 1)]);
    }
    for (to, sum) in row.iter_mut().zip(&scratch[..r]) {
        *to = -inverse * sum;
    }
    row[r] = inverse;
}

wide! {
    /// Turns row `r` of `L⁻¹` into row `r` of `factor L⁻ᵀ L⁻¹`, the inverse of the matrix times `factor`. Rows are
    /// done in rising order; those below are `L⁻¹`'s still. `n` is the order of the matrix.
    invert_row, invert_row_on, InvertRow,
    plain_invert_row(lower: &'a mut [f64], n: usize, r: usize, factor: f64, scratch: &'a mut [f64]) -> ()
}

#[inline(always)]
fn plain_invert_row(lower: &mut [f64], n: usize, r: usize, factor: f64, scratch: &mut [f64]) {
    scratch[..=r].fill(0.0);
    for k in r..n {
        let row = &lower[packed(k)..packed(k + 1)];
        plain_add_scaled(&mut scratch[..=r], factor * row[r], &row[..=r]);
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

#[cfg(test)]
mod path_tests {
    use super::super::functions::sines_and_cosines_on;
    use super::super::model::normal;
    use super::*;
    use crate::seed::stream;

    /// The results of all loops on a path, as bits.
    fn results(path: SimdPath, n: usize, numbers: &[f64]) -> Vec<u64> {
        let (x, y) = (&numbers[..n], &numbers[n..2 * n]);
        let mut all = vec![dot_on(path, x, y)];
        let mut row = y.to_vec();
        add_scaled_on(path, &mut row, 0.3, x);
        all.extend(&row);
        // A positive definite matrix from some outer products.
        let mut matrix = vec![0.0; packed(n)];
        for r in 0..n {
            matrix[packed(r) + r] = 1.0;
        }
        for of in numbers.chunks_exact(n).take(5) {
            add_outer_on(path, &mut matrix, 0.7, of);
        }
        all.extend(&matrix);
        multiply_symmetric_on(path, &matrix, x, &mut row);
        all.extend(&row);
        assert!((0..n).all(|r| cholesky_row_on(path, &mut matrix, r)));
        all.extend(&matrix);
        (0..n).for_each(|r| invert_lower_row_on(path, &mut matrix, r, &mut row));
        (0..n).for_each(|r| invert_row_on(path, &mut matrix, n, r, 1.5, &mut row));
        all.extend(&matrix);
        let (mut sines, mut cosines) = (vec![0.0; n], vec![0.0; n]);
        sines_and_cosines_on(path, x, &mut sines, &mut cosines);
        all.extend(sines.iter().chain(&cosines));
        all.iter().map(|x| x.to_bits()).collect()
    }

    #[test]
    fn all_paths_give_the_same_bits() {
        let mut rng = stream(3, "paths");
        for n in (1..70).chain([160, 331]) {
            let numbers: Vec<f64> = (0..5 * n.max(2)).map(|_| 3.0 * normal(&mut rng)).collect();
            let expected = results(SimdPath::BASELINE, n, &numbers);
            for path in SimdPath::all() {
                assert!(results(path, n, &numbers) == expected, "{path}, order {n}");
            }
        }
    }
}
