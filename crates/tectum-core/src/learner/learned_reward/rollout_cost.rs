//! The cost of rollouts by the reward model, and its slopes, for sixteen rollouts side by side.
//!
//! The cost is the negative reward. What depends on the fixed inputs alone is computed once for a target: a constant,
//! and the coefficients of the moved inputs' functions. Each tick then needs the functions of the moved inputs and
//! their products.

use tectum_encoder::simd::F32x16;

use super::basis::Basis;
use super::lanes::Lanes;
use super::reward_model::{RewardModel, RewardTerms};

/// Functions whose slopes are summed at the same time.
const FUNCTIONS: usize = 4;

/// The reward model's weights in single precision, as rollouts need them.
#[derive(Debug, Clone)]
pub(super) struct RolloutCost {
    pub terms: RewardTerms,
    pub weights: Vec<f32>,
    /// Coefficients for the products of two moved inputs' functions: a symmetric matrix, row by row.
    pub products: Vec<f32>,
    /// The functions' values and slopes.
    values: Vec<Lanes>,
    slopes: Vec<Lanes>,
    /// Slopes of the cost along the moved inputs' functions.
    along: Vec<Lanes>,
}

impl RolloutCost {
    /// The cost of rollouts by `model`, with weights 0.
    pub fn of(model: &RewardModel) -> Self {
        let total = model.terms.bases.iter().map(Basis::len).sum::<usize>();
        let moved = total - model.terms.starts[model.terms.fixed];
        Self {
            terms: model.terms.clone(),
            weights: vec![0.0; model.weights().len()],
            products: vec![0.0; moved * moved],
            values: vec![Lanes::ZERO; total],
            slopes: vec![Lanes::ZERO; total],
            along: vec![Lanes::ZERO; moved],
        }
    }

    /// Takes over the weights of the model.
    pub fn load(&mut self, weights: &[f64]) {
        let (first, size) = (self.terms.starts[self.terms.fixed], self.moved_functions());
        for (single, w) in self.weights.iter_mut().zip(weights) {
            *single = *w as f32;
        }
        for &(i, j, start) in self.terms.pairs.iter().filter(|(i, _, _)| *i >= self.terms.fixed) {
            let columns = self.terms.bases[j].len();
            for (a, row) in self.weights[start..].chunks_exact(columns).take(self.terms.bases[i].len()).enumerate() {
                for (b, w) in row.iter().enumerate() {
                    let (a, b) = (self.terms.starts[i] - first + a, self.terms.starts[j] - first + b);
                    self.products[a * size + b] = -w;
                    self.products[b * size + a] = -w;
                }
            }
        }
    }

    /// Writes the coefficients of the moved inputs' functions to `linear`, given the fixed inputs. Returns the part of
    /// the cost that does not depend on the moved inputs.
    #[inline(always)]
    pub fn of_target<W: F32x16>(&mut self, inputs: &[Lanes], linear: &mut [Lanes]) -> W {
        let first = self.terms.starts[self.terms.fixed];
        for (input, x) in inputs.iter().enumerate().take(self.terms.fixed) {
            let start = self.terms.starts[input];
            self.terms.bases[input].eval_lanes(W::load(&x.0), &mut self.values[start..], &mut self.slopes[start..]);
        }
        let value = |at: usize| &self.values[at].0;
        let mut constant = W::splat(-self.weights[0]);
        match self.terms.singles {
            Some(singles) => {
                for (l, w) in linear.iter_mut().zip(&self.weights[singles + first..]) {
                    l.0 = W::splat(-w).store();
                }
                let mut sum = W::splat(-0.0);
                for (at, w) in self.weights[singles..][..first].iter().enumerate() {
                    sum = sum + W::load(value(at)) * W::splat(*w);
                }
                constant = constant - sum;
            }
            None => linear.fill(Lanes::ZERO),
        }
        for &(i, j, start) in self.terms.pairs.iter().filter(|(i, _, _)| *i < self.terms.fixed) {
            let columns = self.terms.bases[j].len();
            let rows = self.weights[start..].chunks_exact(columns).take(self.terms.bases[i].len()).enumerate();
            if j < self.terms.fixed {
                let mut sum = W::splat(-0.0);
                for (a, row) in rows {
                    let mut along = W::splat(-0.0);
                    for (b, w) in row.iter().enumerate() {
                        along = along + W::splat(*w) * W::load(value(self.terms.starts[j] + b));
                    }
                    sum = sum + W::load(value(self.terms.starts[i] + a)) * along;
                }
                constant = constant - sum;
                continue;
            }
            let linear = &mut linear[self.terms.starts[j] - first..][..columns];
            for (a, row) in rows {
                let v = W::load(value(self.terms.starts[i] + a));
                for (l, w) in linear.iter_mut().zip(row) {
                    l.0 = (W::load(&l.0) - v * W::splat(*w)).store();
                }
            }
        }
        constant
    }

    /// Writes the slopes of the cost along the moved inputs, at their values `inputs`, with `linear` from
    /// [`of_target`](Self::of_target). Returns the part of the cost that depends on the moved inputs.
    #[inline(always)]
    pub fn of_tick<W: F32x16>(&mut self, inputs: &[Lanes], linear: &[Lanes], slopes: &mut [Lanes]) -> W {
        let first = self.terms.starts[self.terms.fixed];
        let mut start = 0;
        for (basis, x) in self.terms.bases[self.terms.fixed..].iter().zip(inputs) {
            basis.eval_lanes(W::load(&x.0), &mut self.values[first + start..], &mut self.slopes[first + start..]);
            start += basis.len();
        }
        self.along_functions::<W>(linear);
        // The sums contain the terms of pairs twice and the linear terms once; adding `linear` makes it twice for all.
        let mut twice = W::splat(-0.0);
        let functions = self.values[first..].iter().zip(&self.slopes[first..]);
        let mut functions = self.along.iter().zip(linear).zip(functions);
        for (basis, slope) in self.terms.bases[self.terms.fixed..].iter().zip(slopes) {
            let mut sum = W::splat(-0.0);
            for ((along, linear), (value, slope)) in functions.by_ref().take(basis.len()) {
                let along = W::load(&along.0);
                sum = sum + along * W::load(&slope.0);
                twice = twice + (along + W::load(&linear.0)) * W::load(&value.0);
            }
            slope.0 = sum.store();
        }
        W::splat(0.5) * twice
    }

    /// The slopes of the cost along the moved inputs' functions.
    #[inline(always)]
    fn along_functions<W: F32x16>(&mut self, linear: &[Lanes]) {
        let (size, first) = (linear.len(), self.terms.starts[self.terms.fixed]);
        let values = &self.values[first..][..size];
        let (blocks, rest) = self.along.as_chunks_mut::<FUNCTIONS>();
        let (linear_blocks, linear_rest) = linear.as_chunks::<FUNCTIONS>();
        let (rows, rest_rows) = self.products.split_at(blocks.len() * FUNCTIONS * size);
        let rows = rows.chunks_exact((FUNCTIONS * size).max(1));
        for ((block, linear), rows) in blocks.iter_mut().zip(linear_blocks).zip(rows) {
            let mut sums = [W::splat(0.0); FUNCTIONS];
            for (sum, linear) in sums.iter_mut().zip(linear) {
                *sum = W::load(&linear.0);
            }
            for (a, value) in values.iter().enumerate() {
                let v = W::load(&value.0);
                for (k, sum) in sums.iter_mut().enumerate() {
                    *sum = *sum + v * W::splat(rows[k * size + a]);
                }
            }
            for (along, sum) in block.iter_mut().zip(sums) {
                along.0 = sum.store();
            }
        }
        for ((along, linear), row) in rest.iter_mut().zip(linear_rest).zip(rest_rows.chunks_exact(size.max(1))) {
            let mut sum = W::load(&linear.0);
            for (v, w) in values.iter().zip(row) {
                sum = sum + W::load(&v.0) * W::splat(*w);
            }
            along.0 = sum.store();
        }
    }

    /// The cost of a squared change of moved input `moved`. It is never negative: a reward for effort itself would
    /// let rollouts run away, and the model predicts one only where it knows too little.
    #[inline(always)]
    pub fn effort(&self, moved: usize) -> f32 {
        (-self.weights[self.terms.squares + moved]).max(0.0)
    }

    /// Number of functions of the moved inputs.
    pub fn moved_functions(&self) -> usize {
        self.values.len() - self.terms.starts[self.terms.fixed]
    }
}
