//! A model's mean as a function of `q`, with the derivatives that the planner needs.
//!
//! For outputs `y_j(q) = w_jᵀ phi(q)`: values (O), the Jacobian `dy / dq` (O x D), and for a single output the Hessian
//! over chosen places of `q`. Products are differentiated backwards through their tree; their Hessian is the forward
//! derivative of that ([`ProductCurves`]).

mod product_curves;

use super::features::{BasisValues, ModelFeatures, has_feature, parent};
use super::layout::Layout;
use super::linalg::{add_scaled, dot};
use super::regression::Regression;
pub use product_curves::ProductCurves;

/// A model's weights, times the amplitudes of the features.
#[derive(Debug, Clone)]
pub struct Weighted {
    outputs: usize,
    len: usize,
    /// By output, then feature.
    pub weights: Vec<f64>,
    /// Weights of the nodes of the products, by output, then node.
    nodes: Vec<f64>,
    /// Room for so many nodes in each output.
    most_nodes: usize,
    basis: BasisValues,
    // Scratch memory of derivatives.
    projected: Vec<f64>,
    slopes: Vec<f64>,
    curves: Vec<f64>,
    adjoint: Vec<f64>,
    by_component: Vec<f64>,
    row: Vec<f64>,
}

impl Weighted {
    /// For `outputs` outputs.
    pub fn new(layout: &Layout, features: &ModelFeatures, outputs: usize) -> Self {
        let (nodes, pairs) = (features.most_nodes, features.pairs);
        Self {
            outputs,
            len: features.len,
            weights: vec![0.0; outputs * features.len],
            nodes: vec![0.0; outputs * nodes],
            most_nodes: nodes,
            basis: BasisValues::new(layout, features),
            projected: vec![0.0; layout.width * pairs],
            slopes: vec![0.0; outputs * pairs],
            curves: vec![0.0; pairs],
            adjoint: vec![0.0; nodes],
            by_component: vec![0.0; outputs * layout.components],
            row: vec![0.0; pairs],
        }
    }

    /// Takes the weights `mean + part (sample - mean)` of a posterior.
    pub fn take(&mut self, layout: &Layout, features: &ModelFeatures, posterior: &Regression, part: f64) {
        for j in 0..self.outputs {
            let at = j * self.len;
            let part = part * posterior.scale(j).sqrt();
            for k in 0..self.len {
                let w = posterior.weights[at + k] + part * posterior.deviation[at + k];
                self.weights[at + k] = w * features.amplitudes[k];
            }
        }
        self.take_nodes(layout, features);
    }

    /// Takes how the samples but the first differ from the mean, each as an output. The posterior has one output.
    pub fn take_spread(&mut self, layout: &Layout, features: &ModelFeatures, posterior: &Regression) {
        let root = posterior.scale(0).sqrt();
        let samples = posterior.deviation.chunks_exact(self.len).skip(1);
        for (to, sample) in self.weights.chunks_exact_mut(self.len).zip(samples) {
            for ((to, w), amplitude) in to.iter_mut().zip(sample).zip(&features.amplitudes) {
                *to = root * w * amplitude;
            }
        }
        self.take_nodes(layout, features);
    }

    fn take_nodes(&mut self, layout: &Layout, features: &ModelFeatures) {
        let products = features.parts(layout).products;
        for (k, node) in features.nodes.iter().enumerate() {
            for j in 0..self.outputs {
                let weight = has_feature(node).map_or(0.0, |f| self.weights[j * self.len + products + f]);
                self.nodes[j * self.most_nodes + k] = weight;
            }
        }
    }

    /// The values of all outputs at `q`.
    pub fn value(&mut self, layout: &Layout, features: &ModelFeatures, q: &[f64], out: &mut [f64]) {
        self.basis.evaluate(layout, features, q);
        self.value_of(&self.basis, layout, features, out);
    }

    /// The values of all outputs, of these weights, at the last point of `other`, which has the same features.
    pub fn value_beside(&self, other: &Self, layout: &Layout, features: &ModelFeatures, out: &mut [f64]) {
        self.value_of(&other.basis, layout, features, out);
    }

    fn value_of(&self, basis: &BasisValues, layout: &Layout, features: &ModelFeatures, out: &mut [f64]) {
        let parts = features.parts(layout);
        let pairs = features.pairs;
        for (j, y) in out.iter_mut().enumerate() {
            let w = &self.weights[j * self.len..(j + 1) * self.len];
            let mut sum = w[0] + dot(&w[1..parts.squares], &basis.e);
            for (c, unit) in w[parts.squares..parts.waves].iter().zip(&layout.units) {
                sum += c * basis.e[unit.component] * basis.e[unit.component];
            }
            sum += dot(&w[parts.waves..parts.waves + pairs], &basis.cosines);
            sum += dot(&w[parts.waves + pairs..parts.products], &basis.sines);
            let used = features.nodes.len();
            *y = sum + dot(&self.nodes[j * self.most_nodes..][..used], &basis.nodes[..used]);
        }
    }

    /// Values and Jacobian (by output, then place of `q`) at `q`.
    pub fn jacobian(
        &mut self,
        layout: &Layout,
        features: &ModelFeatures,
        q: &[f64],
        out: &mut [f64],
        jacobian: &mut [f64],
    ) {
        self.value(layout, features, q, out);
        jacobian.fill(0.0);
        self.project(layout, features);
        self.wave_slopes(layout, features);
        self.component_slopes(layout, features);
        let (pairs, width) = (features.pairs, layout.width);
        for j in 0..self.outputs {
            let row = &mut jacobian[j * width..(j + 1) * width];
            for unit in &layout.units {
                for c in unit.component..unit.component + if unit.circle { 2 } else { 1 } {
                    let slope = self.by_component[j * layout.components + c] * self.basis.slopes[c];
                    for (at, factor) in unit.terms.each() {
                        row[*at] += factor * slope;
                    }
                }
            }
            let slopes = &self.slopes[j * pairs..(j + 1) * pairs];
            for (to, projected) in row.iter_mut().zip(self.projected.chunks_exact(pairs)) {
                *to += dot(slopes, projected);
            }
        }
    }

    /// For each place of `q`, the derivative of the phase of each wave.
    fn project(&mut self, layout: &Layout, features: &ModelFeatures) {
        let pairs = features.pairs;
        self.projected.fill(0.0);
        for unit in &layout.units {
            for (at, factor) in unit.terms.each() {
                let to = &mut self.projected[at * pairs..(at + 1) * pairs];
                for c in unit.component..unit.component + if unit.circle { 2 } else { 1 } {
                    add_scaled(to, factor * self.basis.slopes[c], &features.waves[c * pairs..(c + 1) * pairs]);
                }
            }
        }
    }

    /// The derivative of each output by the phase of each wave.
    fn wave_slopes(&mut self, layout: &Layout, features: &ModelFeatures) {
        let (parts, pairs) = (features.parts(layout), features.pairs);
        for j in 0..self.outputs {
            let w = &self.weights[j * self.len..(j + 1) * self.len];
            let (cosines, sines) = (&w[parts.waves..parts.waves + pairs], &w[parts.waves + pairs..parts.products]);
            for (k, to) in self.slopes[j * pairs..(j + 1) * pairs].iter_mut().enumerate() {
                *to = sines[k] * self.basis.cosines[k] - cosines[k] * self.basis.sines[k];
            }
        }
    }

    /// The derivative of each output by each component, the waves left out.
    fn component_slopes(&mut self, layout: &Layout, features: &ModelFeatures) {
        let (parts, outputs, components) = (features.parts(layout), self.outputs, layout.components);
        for j in 0..outputs {
            let w = &self.weights[j * self.len..(j + 1) * self.len];
            let to = &mut self.by_component[j * components..(j + 1) * components];
            to.copy_from_slice(&w[1..parts.squares]);
            for (c, unit) in w[parts.squares..parts.waves].iter().zip(&layout.units) {
                to[unit.component] += 2.0 * c * self.basis.e[unit.component];
            }
        }
        let used = features.nodes.len();
        for j in 0..outputs {
            let adjoint = &mut self.adjoint[..used];
            adjoint.copy_from_slice(&self.nodes[j * self.most_nodes..][..used]);
            let slopes = &mut self.by_component[j * components..(j + 1) * components];
            for (k, node) in features.nodes.iter().enumerate().rev() {
                let c = node.component as usize;
                match parent(node) {
                    Some(p) => {
                        slopes[c] += adjoint[k] * self.basis.nodes[p];
                        adjoint[p] += self.basis.e[c] * adjoint[k];
                    }
                    None => slopes[c] += adjoint[k],
                }
            }
        }
    }

    /// Value, gradient (by place of `q`) and Hessian of the single output at `q`. The Hessian is full, over `places`,
    /// in rows of `places.len()`.
    pub fn hessian(
        &mut self,
        (layout, features): (&Layout, &ModelFeatures),
        q: &[f64],
        (places, curves): (&[usize], &mut ProductCurves),
        gradient: &mut [f64],
        hessian: &mut [f64],
    ) -> f64 {
        let mut value = [0.0];
        self.jacobian(layout, features, q, &mut value, gradient);
        hessian.fill(0.0);
        self.wave_curves(layout, features, places, hessian);
        self.unit_curves(layout, features, places, hessian);
        curves.add(layout, &features.nodes, (&self.basis, &self.adjoint), places, hessian);
        value[0]
    }

    /// Second derivatives of the waves by two places.
    fn wave_curves(&mut self, layout: &Layout, features: &ModelFeatures, places: &[usize], hessian: &mut [f64]) {
        let (parts, pairs, n) = (features.parts(layout), features.pairs, places.len());
        let w = &self.weights;
        for k in 0..pairs {
            let (cosine, sine) = (w[parts.waves + k], w[parts.waves + pairs + k]);
            self.curves[k] = -(cosine * self.basis.cosines[k] + sine * self.basis.sines[k]);
        }
        for (r, &at) in places.iter().enumerate() {
            for (k, to) in self.row.iter_mut().enumerate() {
                *to = self.curves[k] * self.projected[at * pairs + k];
            }
            for (c, &other) in places[..=r].iter().enumerate() {
                let sum = dot(&self.row, &self.projected[other * pairs..(other + 1) * pairs]);
                hessian[r * n + c] = sum;
                hessian[c * n + r] = sum;
            }
        }
    }

    /// What the curvature of single units gives: squares, and that of cosines and sines.
    fn unit_curves(&mut self, layout: &Layout, features: &ModelFeatures, places: &[usize], hessian: &mut [f64]) {
        let (parts, pairs, n) = (features.parts(layout), features.pairs, places.len());
        for (u, unit) in layout.units.iter().enumerate() {
            let place = |at: usize| places.iter().position(|&other| other == at);
            let mut curve = 2.0 * self.weights[parts.squares + u];
            if unit.circle {
                let w = features.frequencies[u];
                curve = 0.0;
                for c in unit.component..unit.component + 2 {
                    let slope =
                        self.by_component[c] + dot(&self.slopes[..pairs], &features.waves[c * pairs..(c + 1) * pairs]);
                    curve -= w * w * self.basis.e[c] * slope;
                }
            }
            for (at, factor) in unit.terms.each() {
                let Some(r) = place(*at) else { continue };
                for (at, other) in unit.terms.each() {
                    let Some(c) = place(*at) else { continue };
                    hessian[r * n + c] += factor * other * curve;
                }
            }
        }
    }
}
