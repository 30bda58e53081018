//! Small dense matrices for the reference controllers: products, solutions, and the nearest matrix without negative
//! eigenvalues.

/// A matrix by rows.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Matrix {
    rows: usize,
    columns: usize,
    values: Vec<f64>,
}

impl std::ops::Index<(usize, usize)> for Matrix {
    type Output = f64;

    fn index(&self, (row, column): (usize, usize)) -> &f64 {
        &self.values[row * self.columns + column]
    }
}

impl std::ops::IndexMut<(usize, usize)> for Matrix {
    fn index_mut(&mut self, (row, column): (usize, usize)) -> &mut f64 {
        &mut self.values[row * self.columns + column]
    }
}

impl Matrix {
    pub fn zero(rows: usize, columns: usize) -> Self {
        Self { rows, columns, values: vec![0.0; rows * columns] }
    }

    pub fn columns(&self) -> usize {
        self.columns
    }

    /// `self * other`.
    pub fn times(&self, other: &Self) -> Self {
        let mut product = Self::zero(self.rows, other.columns);
        for i in 0..self.rows {
            for k in 0..self.columns {
                let factor = self[(i, k)];
                for j in 0..other.columns {
                    product[(i, j)] += factor * other[(k, j)];
                }
            }
        }
        product
    }

    /// `self^T * other`.
    pub fn transposed_times(&self, other: &Self) -> Self {
        let mut product = Self::zero(self.columns, other.columns);
        for k in 0..self.rows {
            for i in 0..self.columns {
                let factor = self[(k, i)];
                for j in 0..other.columns {
                    product[(i, j)] += factor * other[(k, j)];
                }
            }
        }
        product
    }

    /// `self * vector`.
    pub fn apply(&self, vector: &[f64]) -> Vec<f64> {
        self.values.chunks(self.columns).map(|row| row.iter().zip(vector).map(|(a, b)| a * b).sum()).collect()
    }

    /// `self^T * vector`.
    pub fn apply_transposed(&self, vector: &[f64]) -> Vec<f64> {
        let mut product = vec![0.0; self.columns];
        for (row, factor) in self.values.chunks(self.columns).zip(vector) {
            product.iter_mut().zip(row).for_each(|(sum, value)| *sum += factor * value);
        }
        product
    }

    pub fn add(&mut self, other: &Self) {
        self.values.iter_mut().zip(&other.values).for_each(|(a, b)| *a += b);
    }

    /// The mean of the matrix and its transpose.
    pub fn make_symmetric(&mut self) {
        for i in 0..self.rows {
            for j in 0..i {
                let mean = 0.5 * (self[(i, j)] + self[(j, i)]);
                (self[(i, j)], self[(j, i)]) = (mean, mean);
            }
        }
    }

    /// Solves `self * x = right` for a square matrix, by elimination with row exchange; `None` for a singular one.
    pub fn solve(&self, right: &[f64]) -> Option<Vec<f64>> {
        let n = self.rows;
        let (mut a, mut x) = (self.clone(), right.to_vec());
        for column in 0..n {
            let pivot = (column..n).max_by(|&i, &j| a[(i, column)].abs().total_cmp(&a[(j, column)].abs()))?;
            if a[(pivot, column)].abs() < 1e-300 {
                return None;
            }
            for j in 0..n {
                a.values.swap(pivot * n + j, column * n + j);
            }
            x.swap(pivot, column);
            for row in column + 1..n {
                let factor = a[(row, column)] / a[(column, column)];
                for j in column..n {
                    let above = a[(column, j)];
                    a[(row, j)] -= factor * above;
                }
                x[row] -= factor * x[column];
            }
        }
        for row in (0..n).rev() {
            let known: f64 = (row + 1..n).map(|j| a[(row, j)] * x[j]).sum();
            x[row] = (x[row] - known) / a[(row, row)];
        }
        Some(x)
    }

    /// The nearest symmetric matrix whose eigenvalues are at least 0, by Jacobi rotations of this symmetric one.
    pub fn without_negative_eigenvalues(&self) -> Self {
        let n = self.rows;
        let mut a = self.clone();
        let mut vectors = Self::zero(n, n);
        (0..n).for_each(|i| vectors[(i, i)] = 1.0);
        for _ in 0..30 {
            let off: f64 = (0..n).flat_map(|i| (0..i).map(move |j| (i, j))).map(|at| a[at] * a[at]).sum();
            let on: f64 = (0..n).map(|i| a[(i, i)] * a[(i, i)]).sum();
            if off <= 1e-24 * on {
                break;
            }
            for p in 0..n {
                for q in p + 1..n {
                    rotate(&mut a, &mut vectors, p, q);
                }
            }
        }
        let mut result = Self::zero(n, n);
        for k in (0..n).filter(|&k| a[(k, k)] > 0.0) {
            for i in 0..n {
                for j in 0..n {
                    result[(i, j)] += a[(k, k)] * vectors[(i, k)] * vectors[(j, k)];
                }
            }
        }
        result
    }
}

/// One Jacobi rotation, which makes element (p, q) zero.
fn rotate(a: &mut Matrix, vectors: &mut Matrix, p: usize, q: usize) {
    if a[(p, q)] == 0.0 {
        return;
    }
    let ratio = (a[(q, q)] - a[(p, p)]) / (2.0 * a[(p, q)]);
    let tan = if ratio >= 0.0 { 1.0 } else { -1.0 } / (ratio.abs() + libm::sqrt(ratio * ratio + 1.0));
    let cos = 1.0 / libm::sqrt(tan * tan + 1.0);
    let sin = tan * cos;
    for k in 0..a.rows {
        let (x, y) = (a[(k, p)], a[(k, q)]);
        (a[(k, p)], a[(k, q)]) = (cos * x - sin * y, sin * x + cos * y);
    }
    for k in 0..a.rows {
        let (x, y) = (a[(p, k)], a[(q, k)]);
        (a[(p, k)], a[(q, k)]) = (cos * x - sin * y, sin * x + cos * y);
        let (x, y) = (vectors[(k, p)], vectors[(k, q)]);
        (vectors[(k, p)], vectors[(k, q)]) = (cos * x - sin * y, sin * x + cos * y);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn symmetric(n: usize) -> Matrix {
        let mut m = Matrix::zero(n, n);
        for i in 0..n {
            for j in 0..n {
                m[(i, j)] = ((i + 1) as f64 * (j + 2) as f64).sin() + ((j + 1) as f64 * (i + 2) as f64).sin();
            }
        }
        m
    }

    #[test]
    fn solutions_solve() {
        let m = symmetric(5);
        let right = [1.0, -2.0, 0.5, 3.0, -1.0];
        let back = m.apply(&m.solve(&right).unwrap());
        assert!(back.iter().zip(right).all(|(a, b)| (a - b).abs() < 1e-10), "{back:?}");
        assert_eq!(Matrix::zero(2, 2).solve(&[1.0, 1.0]), None);
    }

    #[test]
    fn negative_eigenvalues_go_and_others_stay() {
        // Eigenvalues 3 and -1.
        let mut m = Matrix::zero(2, 2);
        (m[(0, 0)], m[(1, 1)], m[(0, 1)], m[(1, 0)]) = (1.0, 1.0, 2.0, 2.0);
        let clipped = m.without_negative_eigenvalues();
        assert!(clipped.values.iter().all(|x| (x - 1.5).abs() < 1e-12), "{clipped:?}");
        let twice = symmetric(6).without_negative_eigenvalues();
        let again = twice.without_negative_eigenvalues();
        assert!(twice.values.iter().zip(&again.values).all(|(a, b)| (a - b).abs() < 1e-10));
        assert!((0..6).all(|i| twice[(i, i)] > -1e-12));
    }
}
