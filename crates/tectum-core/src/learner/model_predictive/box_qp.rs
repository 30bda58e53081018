//! A small quadratic program with limits, by projected Newton steps (Tassa, Mansard & Todorov 2014, algorithm 1).
//!
//! ```text
//! minimise 1/2 xᵀ H x + gᵀ x   with   low <= x <= high
//! ```

use super::linalg::{cholesky, packed, solve_lower, solve_lower_transposed};
use crate::MAX_OUTPUTS;

/// The solution, and which coordinates are not at a limit.
#[derive(Debug, Clone, Copy)]
pub struct Solution {
    /// `x`.
    pub x: [f64; MAX_OUTPUTS],
    /// Which coordinates are free.
    pub free: [bool; MAX_OUTPUTS],
    /// Cholesky factor of the free part of `H`, packed, and its order.
    pub factor: [f64; MAX_OUTPUTS * (MAX_OUTPUTS + 1) / 2],
    /// Number of free coordinates.
    pub order: usize,
}

/// Solves for `n` coordinates from `start`; `H` has rows of `n`. `None` if the free part is not positive definite.
pub fn solve(h: &[f64], g: &[f64], low: &[f64], high: &[f64], start: &[f64]) -> Option<Solution> {
    let n = g.len();
    let mut s = Solution {
        x: [0.0; MAX_OUTPUTS],
        free: [true; MAX_OUTPUTS],
        factor: [0.0; MAX_OUTPUTS * (MAX_OUTPUTS + 1) / 2],
        order: n,
    };
    for i in 0..n {
        s.x[i] = start[i].clamp(low[i], high[i]);
    }
    for _ in 0..12 {
        let mut gradient = [0.0; MAX_OUTPUTS];
        for i in 0..n {
            gradient[i] = g[i] + (0..n).map(|j| h[i * n + j] * s.x[j]).sum::<f64>();
            s.free[i] = !((s.x[i] <= low[i] && gradient[i] > 0.0) || (s.x[i] >= high[i] && gradient[i] < 0.0));
        }
        if !factor_free(h, n, &mut s) {
            return None;
        }
        if s.order == 0 {
            return Some(s);
        }
        // Newton step of the free coordinates.
        let mut step = [0.0; MAX_OUTPUTS];
        for (at, i) in (0..n).filter(|&i| s.free[i]).enumerate() {
            step[at] = -gradient[i];
        }
        solve_lower(&s.factor, &mut step[..s.order]);
        solve_lower_transposed(&s.factor, &mut step[..s.order]);
        let value = |x: &[f64; MAX_OUTPUTS]| {
            (0..n).map(|i| x[i] * (g[i] + 0.5 * (0..n).map(|j| h[i * n + j] * x[j]).sum::<f64>())).sum::<f64>()
        };
        let before = value(&s.x);
        let mut size = 1.0;
        let mut moved = 0.0;
        for _ in 0..8 {
            let mut x = s.x;
            for (at, i) in (0..n).filter(|&i| s.free[i]).enumerate() {
                x[i] = (x[i] + size * step[at]).clamp(low[i], high[i]);
            }
            if value(&x) < before {
                moved = (0..n).map(|i| (x[i] - s.x[i]).abs()).fold(0.0, f64::max);
                s.x = x;
                break;
            }
            size *= 0.4;
        }
        if moved < 1e-9 {
            break;
        }
    }
    Some(s)
}

/// Factors the free part of `H`.
fn factor_free(h: &[f64], n: usize, s: &mut Solution) -> bool {
    s.order = 0;
    for i in (0..n).filter(|&i| s.free[i]) {
        for (at, j) in (0..=i).filter(|&j| s.free[j]).enumerate() {
            s.factor[packed(s.order) + at] = h[i * n + j];
        }
        s.order += 1;
    }
    cholesky(&mut s.factor, s.order)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solutions_fulfil_the_conditions_of_optimality() {
        let h = [2.0, 0.5, 0.3, 0.5, 1.0, -0.2, 0.3, -0.2, 1.5];
        for g in [[1.0, -3.0, 0.2], [-5.0, 4.0, 3.0], [0.1, 0.1, -0.1]] {
            let s = solve(&h, &g, &[-1.0; 3], &[1.0, 0.5, 1.0], &[0.0; 3]).unwrap();
            for i in 0..3 {
                let slope = g[i] + (0..3).map(|j| h[i * 3 + j] * s.x[j]).sum::<f64>();
                let high = [1.0, 0.5, 1.0][i];
                assert!(
                    slope.abs() < 1e-8 || (s.x[i] == -1.0 && slope > 0.0) || (s.x[i] == high && slope < 0.0),
                    "{i}: {slope} at {}",
                    s.x[i]
                );
            }
        }
    }
}
