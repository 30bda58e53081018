//! Derivatives of a model's function.

use super::super::linalg::{add_scaled, dot};
use super::{Sizes, Weighted};

/// Scratch memory of derivatives.
#[derive(Debug, Clone)]
pub(super) struct CurveScratch {
    /// Of the first output by each component: without the pairs, and in all.
    by_component: Vec<f64>,
    total: Vec<f64>,
    /// Derivative of an output by the phase of each pair.
    wave_slopes: Vec<f64>,
    /// Derivative of the phase of each pair by each place of `q`.
    projected: Vec<f64>,
    curves: Vec<f64>,
    row: Vec<f64>,
    adjoint: Vec<f64>,
    along: Vec<f64>,
    along_adjoint: Vec<f64>,
    turned: Vec<f64>,
}

impl CurveScratch {
    pub fn new(sizes: &Sizes, width: usize) -> Self {
        let zeros = |len: usize| vec![0.0; len];
        Self {
            by_component: zeros(sizes.components),
            total: zeros(sizes.components),
            wave_slopes: zeros(sizes.pairs),
            projected: zeros(width * sizes.pairs),
            curves: zeros(sizes.pairs),
            row: zeros(sizes.pairs),
            adjoint: zeros(sizes.products),
            along: zeros(sizes.products),
            along_adjoint: zeros(sizes.products),
            turned: zeros(sizes.components),
        }
    }
}

impl Weighted {
    /// Values of the first outputs and their Jacobian (by output, then place of `q`) at `q`.
    pub fn jacobian(&mut self, q: &[f64], out: &mut [f64], jacobian: &mut [f64]) {
        self.value(q, out);
        let width = jacobian.len() / out.len();
        for (j, row) in jacobian.chunks_exact_mut(width).enumerate() {
            self.gradient_at_point(j, row);
        }
    }

    /// Writes the gradient of output `j` at the last point.
    pub fn gradient_at_point(&mut self, j: usize, gradient: &mut [f64]) {
        let (m, n) = (self.pairs, self.components);
        self.component_slopes(j);
        let CurveScratch { by_component, total, wave_slopes, .. } = &mut self.scratch;
        total[..n].copy_from_slice(&by_component[..n]);
        if m > 0 {
            let from = j * self.sizes.pairs;
            let (cosine, sine) = (&self.cosine_weights[from..][..m], &self.sine_weights[from..][..m]);
            let slopes = &mut wave_slopes[..m];
            for k in 0..m {
                slopes[k] = sine[k] * self.cosines[k] - cosine[k] * self.sines[k];
            }
            for (to, waves) in total[..n].iter_mut().zip(self.waves.chunks_exact(m)) {
                *to += dot(slopes, waves);
            }
        }
        gradient.fill(0.0);
        for unit in &self.units {
            for c in unit.components() {
                gradient[unit.at] += total[c] * self.slopes[c];
            }
        }
    }

    /// The derivative of output `j` by each component, the pairs left out, and that by each product.
    fn component_slopes(&mut self, j: usize) {
        let (n, k) = (self.components, self.products.len());
        let CurveScratch { by_component, adjoint, .. } = &mut self.scratch;
        by_component[..n].copy_from_slice(&self.linear[j * self.sizes.components..][..n]);
        for (square, unit) in self.squares[j * self.sizes.units..].iter().zip(&self.units) {
            by_component[unit.component] += 2.0 * square * self.values[unit.component];
        }
        adjoint[..k].copy_from_slice(&self.product_weights[j * self.sizes.products..][..k]);
        for (k, product) in self.products.iter().enumerate().rev() {
            let c = product.component as usize;
            let above = product.parent();
            by_component[c] += adjoint[k] * above.map_or(1.0, |p| self.product_values[p]);
            if let Some(p) = above {
                adjoint[p] += self.values[c] * adjoint[k];
            }
        }
    }

    /// Value, gradient (by place of `q`) and Hessian of the first output at `q`. The Hessian is full, over `places`,
    /// in rows of `places.len()`.
    pub fn hessian(&mut self, q: &[f64], places: &[usize], gradient: &mut [f64], hessian: &mut [f64]) -> f64 {
        let mut value = [0.0];
        self.value(q, &mut value);
        self.gradient_at_point(0, gradient);
        hessian.fill(0.0);
        self.wave_curves(places, hessian);
        self.unit_curves(places, hessian);
        for (row, &at) in places.iter().enumerate() {
            if self.units.iter().any(|unit| unit.at == at && unit.in_products) {
                self.product_curves(at, places, &mut hessian[row * places.len()..][..places.len()]);
            }
        }
        value[0]
    }

    /// Second derivatives of the pairs by two places.
    fn wave_curves(&mut self, places: &[usize], hessian: &mut [f64]) {
        let (m, n) = (self.pairs, places.len());
        if m == 0 {
            return;
        }
        let CurveScratch { projected, curves, row, .. } = &mut self.scratch;
        let (curves, row) = (&mut curves[..m], &mut row[..m]);
        for k in 0..m {
            curves[k] = -(self.cosine_weights[k] * self.cosines[k] + self.sine_weights[k] * self.sines[k]);
        }
        for (r, &at) in places.iter().enumerate() {
            let to = &mut projected[r * m..(r + 1) * m];
            to.fill(0.0);
            for unit in self.units.iter().filter(|unit| unit.at == at) {
                for c in unit.components() {
                    add_scaled(to, self.slopes[c], &self.waves[c * m..(c + 1) * m]);
                }
            }
        }
        for r in 0..n {
            for k in 0..m {
                row[k] = curves[k] * projected[r * m + k];
            }
            for c in 0..=r {
                let sum = dot(row, &projected[c * m..(c + 1) * m]);
                hessian[r * n + c] = sum;
                hessian[c * n + r] = sum;
            }
        }
    }

    /// What the curvature of single units gives: squares, and that of cosines and sines.
    fn unit_curves(&mut self, places: &[usize], hessian: &mut [f64]) {
        let n = places.len();
        for (unit, square) in self.units.iter().zip(&self.squares) {
            let Some(r) = places.iter().position(|&at| at == unit.at) else { continue };
            match unit.frequency {
                Some(w) => {
                    let along = unit.components().map(|c| self.values[c] * self.scratch.total[c]).sum::<f64>();
                    hessian[r * n + r] -= w * w * along;
                }
                None => hessian[r * n + r] += 2.0 * square,
            }
        }
    }

    /// Adds one row of the products' Hessian: the derivative along place `at`.
    fn product_curves(&mut self, at: usize, places: &[usize], row: &mut [f64]) {
        let CurveScratch { adjoint, along, along_adjoint, turned, .. } = &mut self.scratch;
        // The slope of each component along the place.
        let mut moved = [0.0; 256];
        for unit in self.units.iter().filter(|unit| unit.at == at) {
            unit.components().for_each(|c| moved[c] = self.slopes[c]);
        }
        for (k, product) in self.products.iter().enumerate() {
            let c = product.component as usize;
            let (value, before) = product.parent().map_or((1.0, 0.0), |p| (self.product_values[p], along[p]));
            along[k] = before * self.values[c] + value * moved[c];
        }
        along_adjoint[..self.products.len()].fill(0.0);
        turned.fill(0.0);
        for (k, product) in self.products.iter().enumerate().rev() {
            let c = product.component as usize;
            let (down, change) = (adjoint[k], along_adjoint[k]);
            if let Some(p) = product.parent() {
                turned[c] += change * self.product_values[p] + down * along[p];
                along_adjoint[p] += change * self.values[c] + down * moved[c];
            } else {
                turned[c] += change;
            }
        }
        for unit in self.units.iter().filter(|unit| unit.in_products) {
            let Some(to) = places.iter().position(|&p| p == unit.at) else { continue };
            for c in unit.components() {
                row[to] += turned[c] * self.slopes[c];
            }
        }
    }
}
