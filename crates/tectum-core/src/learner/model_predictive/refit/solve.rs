//! The weights of a refit from the sums over all ticks: factor, noise, posterior.

use super::super::layout::NOISE;
use super::super::linalg::{
    cholesky_row, dot, invert_lower_row, invert_row, packed, solve_lower, solve_lower_transposed,
};
use super::super::model::normal;
use super::{Phase, Refit};
use crate::seed::Rng;

impl Refit {
    pub(super) fn factor(&mut self, len: usize) -> u64 {
        let (r, cost) = (self.at as usize, self.cost_of_row());
        let rows = packed(r)..packed(r + 1);
        let factor = &mut self.next.regression.covariance;
        factor[rows.clone()].copy_from_slice(&self.matrix[rows.clone()]);
        factor[rows.end - 1] += self.next.regression.lambda;
        self.at += 1;
        if !cholesky_row(factor, r) {
            // Rounding made it singular: more noise, from the beginning.
            self.next.regression.lambda = 10.0 * self.next.regression.lambda + 1e-12;
            self.at = 0;
        } else if self.at as usize == len {
            self.enter(if self.phase == Phase::Factor { Phase::Weigh } else { Phase::InvertLower });
            if self.phase == Phase::InvertLower {
                self.solve(len);
            }
        }
        cost
    }

    /// Weights, and the sums behind the scales.
    fn solve(&mut self, len: usize) {
        let regression = &mut self.next.regression;
        for j in 0..regression.outputs {
            let w = &mut regression.weights[j * len..(j + 1) * len];
            let b = &self.right[j * len..(j + 1) * len];
            w.copy_from_slice(b);
            solve_lower(&regression.covariance, w);
            solve_lower_transposed(&regression.covariance, w);
            regression.squares[j] = ((self.squares[j] - dot(w, b)) / regression.lambda).max(0.0);
        }
        regression.count = self.gathered;
    }

    /// Solves, and adapts the noise to the residuals.
    pub(super) fn weigh(&mut self, len: usize) -> u64 {
        self.solve(len);
        let floor = self.floor();
        let regression = &mut self.next.regression;
        let (mut total, mut counted) = (0.0, 0.0);
        for j in 0..regression.outputs {
            let w = &regression.weights[j * len..(j + 1) * len];
            if !regression.moves(j) {
                continue;
            }
            let residuals = (regression.squares[j] - dot(w, w)).max(0.0) * regression.lambda;
            total += libm::log(residuals / (regression.scale(j) * self.gathered) + 1e-12);
            counted += 1.0;
        }
        if counted > 0.0 {
            regression.lambda = libm::exp(total / counted).max(floor);
        }
        self.next.features.scales[NOISE] = self.evidence.scale_of_noise(regression.lambda);
        let cost = (3 * len * len * regression.outputs) as u64;
        self.enter(Phase::Again);
        cost
    }

    /// Operations of drawing the samples of the posterior, before the first row is inverted.
    pub(super) fn cost_of_samples(&self) -> u64 {
        let regression = &self.next.regression;
        if self.at > 0 { 0 } else { (regression.deviation.len() * regression.len) as u64 }
    }

    pub(super) fn invert_lower(&mut self, len: usize, rng: &mut Rng) -> u64 {
        let r = self.at as usize;
        let cost = self.cost_of_row() + self.cost_of_samples();
        let regression = &mut self.next.regression;
        if r == 0 {
            let root = regression.lambda.sqrt();
            regression.deviation.iter_mut().for_each(|w| *w = root * normal(rng));
            for deviation in regression.deviation.chunks_exact_mut(len) {
                solve_lower_transposed(&regression.covariance, deviation);
            }
        }
        invert_lower_row(&mut regression.covariance, r, &mut self.row);
        self.at += 1;
        if self.at as usize == len {
            self.enter(Phase::Invert);
        }
        cost
    }

    pub(super) fn invert(&mut self, len: usize) -> u64 {
        let r = self.at as usize;
        let regression = &mut self.next.regression;
        invert_row(&mut regression.covariance, len, r, regression.lambda, &mut self.row);
        self.at += 1;
        if self.at as usize == len {
            self.enter(Phase::CatchUp);
        }
        (2 * (len - r) * (r + 1)) as u64
    }
}
