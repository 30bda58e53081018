//! Whitening: coordinates in which the features of a line of kernels are uncorrelated.
//!
//! Neighbouring kernels overlap so much that 16 kernels of a line carry little more information than eight
//! numbers, and gradient descent along their weights is badly conditioned. Steps are therefore taken in the
//! eigenvector coordinates of the kernels' second-moment matrix over the line's range, `E[k k^T] = Q L Q^T`,
//! scaled to unit variance. This is the natural gradient (Amari 1998) of a linear policy with evenly
//! distributed inputs. The matrix of a plane is the Kronecker product of those of its lines (as in K-FAC,
//! Martens & Grosse 2015), so a plane of 16 x 16 units costs two products of 16 x 16 matrices.

use tectum_encoder::simd::{F32x16, WIDE_LANES};

/// Rows that are multiplied at the same time.
const ROWS: usize = 4;
/// Maximum number of sweeps of Jacobi's method; it needs fewer than ten.
const MAX_SWEEPS: usize = 30;
/// Number of points per unit over which the mean is taken.
const POINTS: usize = 4;

/// The transformation from the kernels of one line to uncorrelated coordinates.
#[derive(Debug, Clone)]
pub(super) struct Whitening {
    units: usize,
    /// `Q (L + ridge)^(-1/2)`, row by row: one row per kernel, one column per coordinate.
    matrix: Vec<f32>,
    /// The transposed matrix.
    transposed: Vec<f32>,
}

impl Whitening {
    /// The transformation of `units` kernels whose values `eval` computes between `min` and `max`; `ridge` is
    /// in units of the mean variance.
    pub fn of(units: usize, min: f32, max: f32, ridge: f64, mut eval: impl FnMut(f32, &mut [f32])) -> Self {
        let n = units;
        let points = POINTS * n;
        let mut values = vec![0.0; n];
        let mut moments = vec![0.0; n * n];
        for point in 0..points {
            eval(min + (max - min) * (point as f32 + 0.5) / points as f32, &mut values);
            for (row, a) in moments.chunks_exact_mut(n).zip(&values) {
                for (m, b) in row.iter_mut().zip(&values) {
                    *m += f64::from(a * b) / points as f64;
                }
            }
        }
        let trace: f64 = moments.iter().step_by(n + 1).sum();
        let (spreads, vectors) = eigen(moments, n);
        let ridge = ridge * trace / n as f64;
        let scales: Vec<_> = spreads.iter().map(|s| 1.0 / (s.max(0.0) + ridge).sqrt()).collect();
        let mut matrix = vec![0.0; n * n];
        let mut transposed = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..n {
                let entry = (vectors[i * n + j] * scales[j]) as f32;
                (matrix[i * n + j], transposed[j * n + i]) = (entry, entry);
            }
        }
        Self { units, matrix, transposed }
    }

    /// Transforms slopes along weights, in rows of `units`, to slopes along coordinates.
    #[inline(always)]
    pub fn whiten_rows<W: F32x16>(&self, from: &[f32], to: &mut [f32]) {
        multiply::<W>(from, &self.matrix, self.units, to);
    }

    /// Transforms steps in coordinates to steps of weights, in rows of `units`.
    #[inline(always)]
    pub fn unwhiten_rows<W: F32x16>(&self, from: &[f32], to: &mut [f32]) {
        multiply::<W>(from, &self.transposed, self.units, to);
    }

    /// [`whiten_rows`](Self::whiten_rows) for the columns of a matrix of `units` rows.
    #[inline(always)]
    pub fn whiten_columns<W: F32x16>(&self, from: &[f32], to: &mut [f32]) {
        multiply::<W>(&self.transposed, from, self.units, to);
    }

    /// [`unwhiten_rows`](Self::unwhiten_rows) for the columns of a matrix of `units` rows.
    #[inline(always)]
    pub fn unwhiten_columns<W: F32x16>(&self, from: &[f32], to: &mut [f32]) {
        multiply::<W>(&self.matrix, from, self.units, to);
    }
}

/// The matrix product `to = a b`, where `a` has rows of `n` numbers and `b` has `n` rows. Each sum has the order of
/// `b`'s rows.
#[inline(always)]
fn multiply<W: F32x16>(a: &[f32], b: &[f32], n: usize, to: &mut [f32]) {
    let width = b.len() / n;
    let whole = a.len() / (ROWS * n) * ROWS;
    let (a, a_rest) = a.split_at(whole * n);
    let (to, to_rest) = to.split_at_mut(whole * width);
    for (a, to) in a.chunks_exact(ROWS * n).zip(to.chunks_exact_mut(ROWS * width)) {
        multiply_rows::<W, ROWS>(a, b, n, to);
    }
    for (a, to) in a_rest.chunks_exact(n).zip(to_rest.chunks_exact_mut(width)) {
        multiply_rows::<W, 1>(a, b, n, to);
    }
}

/// [`multiply`] for `N` rows of `a`.
#[inline(always)]
fn multiply_rows<W: F32x16, const N: usize>(a: &[f32], b: &[f32], n: usize, to: &mut [f32]) {
    let width = b.len() / n;
    let blocks = width / WIDE_LANES;
    for at in 0..blocks {
        let mut sums = [W::splat(0.0); N];
        for (k, row) in b.chunks_exact(width).enumerate() {
            let row = W::load(&row.as_chunks().0[at]);
            for (i, sum) in sums.iter_mut().enumerate() {
                *sum = *sum + W::splat(a[i * n + k]) * row;
            }
        }
        for (to, sum) in to.chunks_exact_mut(width).zip(sums) {
            to.as_chunks_mut().0[at] = sum.store();
        }
    }
    let from = blocks * WIDE_LANES;
    for (a, to) in a.chunks_exact(n).zip(to.chunks_exact_mut(width)) {
        to[from..].fill(0.0);
        for (row, factor) in b.chunks_exact(width).zip(a) {
            for (to, x) in to[from..].iter_mut().zip(&row[from..]) {
                *to += factor * x;
            }
        }
    }
}

/// Eigenvalues and eigenvectors (columns) of a symmetric matrix, by Jacobi's method.
fn eigen(mut a: Vec<f64>, n: usize) -> (Vec<f64>, Vec<f64>) {
    let mut vectors = vec![0.0; n * n];
    vectors.iter_mut().step_by(n + 1).for_each(|v| *v = 1.0);
    let size: f64 = a.iter().map(|x| x * x).sum();
    for _ in 0..MAX_SWEEPS {
        let rest: f64 =
            (0..n).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| a[i * n + j] * a[i * n + j]).sum();
        if rest <= 1e-28 * size {
            break;
        }
        for p in 0..n {
            for q in p + 1..n {
                let off = a[p * n + q];
                if off == 0.0 {
                    continue;
                }
                let theta = (a[q * n + q] - a[p * n + p]) / (2.0 * off);
                let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
                let c = 1.0 / (t * t + 1.0).sqrt();
                let s = t * c;
                for k in 0..n {
                    let (x, y) = (a[k * n + p], a[k * n + q]);
                    (a[k * n + p], a[k * n + q]) = (c * x - s * y, s * x + c * y);
                }
                for k in 0..n {
                    let (x, y) = (a[p * n + k], a[q * n + k]);
                    (a[p * n + k], a[q * n + k]) = (c * x - s * y, s * x + c * y);
                    let (x, y) = (vectors[k * n + p], vectors[k * n + q]);
                    (vectors[k * n + p], vectors[k * n + q]) = (c * x - s * y, s * x + c * y);
                }
            }
        }
    }
    ((0..n).map(|i| a[i * n + i]).collect(), vectors)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tectum_encoder::simd::{F32x8, Kernel, SimdPath};

    const KERNELS: usize = 20;
    const RANGE: f32 = KERNELS as f32 / 3.0;

    /// [`multiply`] as a kernel.
    struct Product<'a>(&'a [f32], &'a [f32], &'a mut [f32]);

    impl Kernel for Product<'_> {
        type Output = ();
        const IS_WIDE: bool = true;

        fn run<L: F32x8>(self) {
            multiply::<L::Wide>(self.0, self.1, KERNELS, self.2);
        }
    }

    /// The product of two matrices, one of which has `KERNELS` rows and columns.
    fn product(a: &[f32], b: &[f32], to: &mut [f32]) {
        for path in SimdPath::all() {
            let mut again = vec![0.0; to.len()];
            path.run(Product(a, b, &mut again));
            to.copy_from_slice(&again);
            let columns = b.len() / KERNELS;
            for (i, x) in again.iter().enumerate() {
                let (row, column) = (i / columns, i % columns);
                let terms = (0..KERNELS).map(|k| a[row * KERNELS + k] * b[k * columns + column]);
                assert_eq!(x.to_bits(), terms.fold(0.0, |sum: f32, term| sum + term).to_bits(), "{path}");
            }
        }
    }

    fn eval(x: f32, values: &mut [f32]) {
        for (i, v) in values.iter_mut().enumerate() {
            let distance = x - i as f32 / 3.0;
            *v = (-0.5 * distance * distance).exp();
        }
    }

    #[test]
    fn coordinates_are_uncorrelated_with_variances_of_at_most_one() {
        let whitening = Whitening::of(KERNELS, 0.0, RANGE, 1e-3, eval);
        let points = KERNELS * POINTS;
        let mut moments = [0.0; KERNELS * KERNELS];
        for point in 0..points {
            let (mut values, mut z) = ([0.0; KERNELS], [0.0; KERNELS]);
            eval(RANGE * (point as f32 + 0.5) / points as f32, &mut values);
            product(&values, &whitening.matrix, &mut z);
            for (m, (a, b)) in moments.iter_mut().zip(z.iter().flat_map(|a| z.iter().map(move |b| (a, b)))) {
                *m += a * b / points as f32;
            }
        }
        let mut largest = 0.0_f32;
        for i in 0..KERNELS {
            for j in 0..i {
                assert!(moments[i * KERNELS + j].abs() < 1e-3, "{i} {j}: {}", moments[i * KERNELS + j]);
            }
            largest = largest.max(moments[i * KERNELS + i]);
        }
        assert!((0.95..1.001).contains(&largest), "{largest}");
    }

    #[test]
    fn steps_descend_the_slope() {
        // Whitening followed by unwhitening multiplies by a matrix and its transpose, so the slope along a step
        // is never negative. Columns are transformed like rows.
        let whitening = Whitening::of(KERNELS, 0.0, RANGE, 1e-3, eval);
        let mut slope = [0.0_f32; KERNELS * KERNELS];
        slope.iter_mut().enumerate().for_each(|(i, s)| *s = ((i * i) % 17) as f32 - 8.0);
        let [mut a, mut b] = [[0.0; KERNELS * KERNELS]; 2];
        product(&slope, &whitening.matrix, &mut a);
        product(&whitening.transposed, &a, &mut b);
        let squares: f32 = b.iter().map(|x| x * x).sum();
        product(&b, &whitening.transposed, &mut a);
        product(&whitening.matrix, &a, &mut b);
        let along: f32 = slope.iter().zip(&b).map(|(s, x)| s * x).sum();
        assert!((along / squares - 1.0).abs() < 1e-3, "{along} {squares}");
    }
}
