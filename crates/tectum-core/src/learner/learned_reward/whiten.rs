//! Even ground for descent: the coordinates in which the features of a line of kernels are uncorrelated.
//!
//! Neighbouring kernels overlap so much that a line of 16 says hardly more than eight numbers, and the slope along their
//! weights runs down a ravine. Steps are therefore taken in the coordinates of the kernels' second-moment matrix over the
//! line's range, `E[k k^T] = Q L Q^T`, scaled to unit variance: the natural gradient (Amari 1998) of a linear policy whose
//! inputs are spread evenly. A plane's matrix is the Kronecker product of its lines' (as in K-FAC, Martens & Grosse 2015),
//! so that a plane of 16 x 16 costs two products of 16 x 16 matrices.

/// Most sweeps of Jacobi's method; it needs less than ten.
const SWEEPS: usize = 30;
/// Points of the line over which the mean is taken, for every unit.
const POINTS: usize = 4;

/// From the kernels of one line to uncorrelated coordinates.
#[derive(Debug, Clone)]
pub(super) struct Whitening {
    units: usize,
    /// `Q (L + ridge)^(-1/2)`, row by row: a row a kernel, a column a coordinate.
    matrix: Vec<f32>,
    /// The same the other way round.
    transposed: Vec<f32>,
}

impl Whitening {
    /// Of `units` kernels with the values `eval` gives between `min` and `max`; `ridge` is in units of the mean variance.
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

    /// Slopes along weights, rows of `units`, to slopes along coordinates.
    pub fn rows_to(&self, from: &[f32], to: &mut [f32]) {
        rows(&self.matrix, self.units, from, to);
    }

    /// Steps in coordinates to steps of weights.
    pub fn rows_back(&self, from: &[f32], to: &mut [f32]) {
        rows(&self.transposed, self.units, from, to);
    }

    /// The same for the columns of a matrix of `units` rows.
    pub fn columns_to(&self, from: &[f32], to: &mut [f32]) {
        columns(&self.transposed, self.units, from, to);
    }

    /// And back.
    pub fn columns_back(&self, from: &[f32], to: &mut [f32]) {
        columns(&self.matrix, self.units, from, to);
    }
}

/// `to = from matrix`.
fn rows(matrix: &[f32], n: usize, from: &[f32], to: &mut [f32]) {
    for (from, to) in from.chunks_exact(n).zip(to.chunks_exact_mut(n)) {
        to.fill(0.0);
        for (row, f) in matrix.chunks_exact(n).zip(from) {
            super::add(to, row, *f);
        }
    }
}

/// `to = matrix from`.
fn columns(matrix: &[f32], n: usize, from: &[f32], to: &mut [f32]) {
    let width = from.len() / n;
    for (row, to) in matrix.chunks_exact(n).zip(to.chunks_exact_mut(width)) {
        to.fill(0.0);
        for (from, m) in from.chunks_exact(width).zip(row) {
            super::add(to, from, *m);
        }
    }
}

/// Eigenvalues and eigenvectors (columns) of a symmetric matrix, by Jacobi's method.
fn eigen(mut a: Vec<f64>, n: usize) -> (Vec<f64>, Vec<f64>) {
    let mut vectors = vec![0.0; n * n];
    vectors.iter_mut().step_by(n + 1).for_each(|v| *v = 1.0);
    let size: f64 = a.iter().map(|x| x * x).sum();
    for _ in 0..SWEEPS {
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

    const KERNELS: usize = 12;

    fn eval(x: f32, values: &mut [f32]) {
        for (i, v) in values.iter_mut().enumerate() {
            let distance = x - i as f32 / 3.0;
            *v = (-0.5 * distance * distance).exp();
        }
    }

    #[test]
    fn coordinates_are_uncorrelated_and_none_is_larger_than_one() {
        let whitening = Whitening::of(KERNELS, 0.0, 4.0, 1e-3, eval);
        let points = KERNELS * POINTS;
        let mut moments = [0.0; KERNELS * KERNELS];
        for point in 0..points {
            let (mut values, mut z) = ([0.0; KERNELS], [0.0; KERNELS]);
            eval(4.0 * (point as f32 + 0.5) / points as f32, &mut values);
            whitening.rows_to(&values, &mut z);
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
    fn steps_go_down_the_slope() {
        // Back after to is a product of a matrix with its transpose: the slope along a step is never negative. A plane's
        // columns are treated as its rows.
        let whitening = Whitening::of(KERNELS, 0.0, 4.0, 1e-3, eval);
        let mut slope = [0.0_f32; KERNELS * KERNELS];
        slope.iter_mut().enumerate().for_each(|(i, s)| *s = ((i * i) % 17) as f32 - 8.0);
        let [mut a, mut b] = [[0.0; KERNELS * KERNELS]; 2];
        whitening.rows_to(&slope, &mut a);
        whitening.columns_to(&a, &mut b);
        let squares: f32 = b.iter().map(|x| x * x).sum();
        whitening.rows_back(&b, &mut a);
        whitening.columns_back(&a, &mut b);
        let along: f32 = slope.iter().zip(&b).map(|(s, x)| s * x).sum();
        assert!((along / squares - 1.0).abs() < 1e-3, "{along} {squares}");
    }
}
