//! Explicit features whose inner product is a layout's kernel: weights on them have the prior `N(0, 1)`.
//!
//! ```text
//! phi = [ sqrt b | sqrt a_i x_i | sqrt c_i x_i^2 | sqrt(f / M) (cos W e, sin W e) | sqrt(s v_i v_j ..) x_i x_j .. ]
//! ```
//!
//! where products of two have `p` in the place of `s`, and those of three `t`, with the components `e` of all units
//! and `M` random frequencies `W = Xi sqrt(rho)`, `Xi` normal and drawn once (random Fourier features, Rahimi & Recht
//! 2007), which only approximate their part of the kernel. Of the products, those of largest prior variance have a
//! feature; they are chosen anew when the scales change.

mod products;

use super::functions::{exp, sines_and_cosines};
use super::layout::{BIAS, Layout, SMOOTH, ScaleKind};
use crate::state::StateVisitor;
use products::ProductCandidate;

/// Most groups of a layout's products: inputs and commands.
const MAX_GROUPS: usize = crate::MAX_INPUTS + crate::MAX_OUTPUTS;

/// No feature belongs to this node.
const NONE: u32 = u32::MAX;

/// One product: a component times the product of its parent. A parent stands before its children.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Node {
    /// The parent, or `u32::MAX` for a component alone.
    pub parent: u32,
    /// The component.
    pub component: u32,
    /// Its feature, counted from the first product, or `u32::MAX`.
    pub feature: u32,
}

/// The features of a layout with certain scales.
#[derive(Debug, Clone)]
pub struct ModelFeatures {
    /// Number of features.
    pub len: usize,
    /// Random Fourier pairs `M`.
    pub pairs: usize,
    /// Most products.
    products: usize,
    /// Most nodes of their tree.
    pub most_nodes: usize,
    /// Logarithms of the scales.
    pub scales: Vec<f64>,
    /// Frequencies of the angles.
    pub frequencies: Vec<f64>,
    /// Amplitude of each feature.
    pub amplitudes: Vec<f64>,
    /// Mean square of each component, by which products are ranked.
    pub mean_squares: Vec<f64>,
    /// Frequencies of the Fourier pairs, by component, then pair.
    pub waves: Vec<f64>,
    draws: Vec<f64>,
    /// Scales and mean squares of the last build.
    built: Vec<f64>,
    built_squares: Vec<f64>,
    /// The products.
    pub nodes: Vec<Node>,
    candidates: Vec<ProductCandidate>,
    spare: Vec<ProductCandidate>,
}

/// Where the parts of the features begin.
#[derive(Debug, Clone, Copy)]
pub struct Parts {
    /// Squares.
    pub squares: usize,
    /// Cosines; the sines follow.
    pub waves: usize,
    /// Products.
    pub products: usize,
}

/// Scratch memory for the basis functions of one point.
#[derive(Debug, Clone)]
pub struct BasisValues {
    /// Components.
    pub e: Vec<f64>,
    /// Their slopes.
    pub slopes: Vec<f64>,
    /// Cosines of the pairs.
    pub cosines: Vec<f64>,
    /// Sines of the pairs.
    pub sines: Vec<f64>,
    phases: Vec<f64>,
    /// Values of the nodes.
    pub nodes: Vec<f64>,
}

impl BasisValues {
    /// For features of `layout`.
    pub fn new(layout: &Layout, features: &ModelFeatures) -> Self {
        Self {
            e: vec![0.0; layout.components],
            slopes: vec![0.0; layout.components],
            cosines: vec![0.0; features.pairs],
            sines: vec![0.0; features.pairs],
            phases: vec![0.0; features.pairs],
            nodes: vec![0.0; features.most_nodes],
        }
    }

    /// Computes components, slopes, waves and products at `q`.
    pub fn evaluate(&mut self, layout: &Layout, features: &ModelFeatures, q: &[f64]) {
        layout.components(&features.frequencies, q, &mut self.e, Some(&mut self.slopes));
        self.phases.fill(0.0);
        let m = features.pairs;
        for (c, e) in self.e.iter().enumerate() {
            super::linalg::add_scaled(&mut self.phases, *e, &features.waves[c * m..(c + 1) * m]);
        }
        sines_and_cosines(&self.phases, &mut self.sines, &mut self.cosines);
        for (k, node) in features.nodes.iter().enumerate() {
            let parent = if node.parent == NONE { 1.0 } else { self.nodes[node.parent as usize] };
            self.nodes[k] = parent * self.e[node.component as usize];
        }
    }
}

impl ModelFeatures {
    /// Features of `layout` with its first scales, `pairs` Fourier pairs and at most `products` products. `normal`
    /// draws from the normal distribution.
    pub fn new(layout: &Layout, pairs: usize, products: usize, mut normal: impl FnMut() -> f64) -> Self {
        let mean = |unit: &super::layout::Unit| if unit.circle { 0.5 } else { 1.0 / 3.0 };
        let mut mean_squares = Vec::new();
        for unit in &layout.units {
            mean_squares.resize(mean_squares.len() + if unit.circle { 2 } else { 1 }, mean(unit));
        }
        let len = 1 + layout.components + layout.units.len() + 2 * pairs + products;
        let mut features = Self {
            len,
            pairs,
            products,
            most_nodes: products * layout.groups.len().max(1),
            scales: layout.prior.clone(),
            frequencies: vec![0.0; layout.circles],
            amplitudes: vec![0.0; len],
            built: layout.prior.clone(),
            built_squares: mean_squares.clone(),
            mean_squares,
            waves: vec![0.0; layout.components * pairs],
            draws: orthogonal_draws(layout.components, pairs, &mut normal),
            nodes: Vec::new(),
            candidates: Vec::new(),
            spare: Vec::new(),
        };
        features.reserve(layout);
        features.build(layout);
        features
    }

    /// Takes the memory that any build needs; a clone has less.
    pub fn reserve(&mut self, layout: &Layout) {
        let beam = self.beam(layout);
        let components = |group: &Vec<usize>| group.iter().map(|&u| if layout.units[u].circle { 2 } else { 1 }).sum();
        let choices = 1 + layout.groups.iter().map(components).max().unwrap_or(0_usize);
        self.nodes.reserve(self.most_nodes - self.nodes.len());
        self.candidates.reserve(choices * beam);
        self.spare.reserve(choices * beam);
    }

    /// Where the parts begin.
    pub fn parts(&self, layout: &Layout) -> Parts {
        let squares = 1 + layout.components;
        let waves = squares + layout.units.len();
        Parts { squares, waves, products: waves + 2 * self.pairs }
    }

    /// Makes the features of `scales` and mean squares.
    pub fn build(&mut self, layout: &Layout) {
        self.built.copy_from_slice(&self.scales);
        self.built_squares.copy_from_slice(&self.mean_squares);
        let scale = |u: usize, s: ScaleKind| {
            if layout.units[u].scales[s as usize] { exp(self.scales[Layout::scale(u, s)]) } else { 0.0 }
        };
        for u in 0..layout.circles {
            self.frequencies[u] = exp(self.scales[Layout::scale(u, ScaleKind::Frequency)]);
        }
        let parts = self.parts(layout);
        self.amplitudes.fill(0.0);
        self.amplitudes[0] = exp(self.scales[BIAS]).sqrt();
        for (u, unit) in layout.units.iter().enumerate() {
            let linear = scale(u, ScaleKind::Linear).sqrt();
            let rho = scale(u, ScaleKind::Smooth).sqrt();
            let components = if unit.circle { 2 } else { 1 };
            for c in unit.component..unit.component + components {
                self.amplitudes[1 + c] = linear;
                for k in c * self.pairs..(c + 1) * self.pairs {
                    self.waves[k] = self.draws[k] * rho;
                }
            }
            self.amplitudes[parts.squares + u] = scale(u, ScaleKind::Square).sqrt();
        }
        let smooth = (exp(self.scales[SMOOTH]) / self.pairs.max(1) as f64).sqrt();
        self.amplitudes[parts.waves..parts.products].fill(smooth);
        self.choose_products(layout);
    }

    /// Writes the features at `q` to `phi`.
    pub fn evaluate(&self, layout: &Layout, q: &[f64], basis: &mut BasisValues, phi: &mut [f64]) {
        basis.evaluate(layout, self, q);
        let parts = self.parts(layout);
        phi[0] = 1.0;
        phi[1..parts.squares].copy_from_slice(&basis.e);
        for (to, unit) in phi[parts.squares..parts.waves].iter_mut().zip(&layout.units) {
            let x = basis.e[unit.component];
            *to = x * x;
        }
        phi[parts.waves..parts.waves + self.pairs].copy_from_slice(&basis.cosines);
        phi[parts.waves + self.pairs..parts.products].copy_from_slice(&basis.sines);
        phi[parts.products..].fill(0.0);
        for (node, value) in self.nodes.iter().zip(&basis.nodes) {
            if node.feature != NONE {
                phi[parts.products + node.feature as usize] = *value;
            }
        }
        for (x, amplitude) in phi.iter_mut().zip(&self.amplitudes) {
            *x *= amplitude;
        }
    }

    /// Passes on scales and mean squares, from which the rest follows.
    pub fn visit_scales(&mut self, layout: &Layout, visitor: &mut dyn StateVisitor) {
        visitor.numbers("scales", &mut self.scales);
        visitor.numbers("mean_squares", &mut self.mean_squares);
        if self.built != self.scales || self.built_squares != self.mean_squares {
            self.build(layout);
        }
    }
}

/// Normal directions by component, then pair, orthogonal to each other in blocks of as many pairs as there are
/// components (orthogonal random features, Yu et al. 2016): a better approximation with as many features.
fn orthogonal_draws(components: usize, pairs: usize, normal: &mut impl FnMut() -> f64) -> Vec<f64> {
    let mut draws = vec![0.0; components * pairs];
    let mut block: Vec<Vec<f64>> = Vec::new();
    for k in 0..pairs {
        if k % components == 0 {
            block.clear();
        }
        let mut direction: Vec<f64> = (0..components).map(|_| normal()).collect();
        for other in &block {
            let along = super::linalg::dot(&direction, other);
            super::linalg::add_scaled(&mut direction, -along, other);
        }
        let norm = super::linalg::dot(&direction, &direction).sqrt().max(1e-12);
        direction.iter_mut().for_each(|x| *x /= norm);
        let length = (0..components).map(|_| normal()).map(|x| x * x).sum::<f64>().sqrt();
        for (c, x) in direction.iter().enumerate() {
            draws[c * pairs + k] = length * x;
        }
        block.push(direction);
    }
    draws
}

/// Whether a product has a feature.
pub fn has_feature(node: &Node) -> Option<usize> {
    (node.feature != NONE).then_some(node.feature as usize)
}

/// The parent of a node, if it has one.
pub fn parent(node: &Node) -> Option<usize> {
    (node.parent != NONE).then_some(node.parent as usize)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learner::model_predictive::layout::Priors;

    #[test]
    fn all_products_of_a_small_layout_have_their_features() {
        let mut layout = Layout::new(3, [1.0, 0.9, 0.5, 0.4, 0.1, 1e-3]);
        let priors = Priors { linear: 0.3, square: 0.2, product: 0.7, smooth: 0.2 };
        layout.circle(0, 2.0, true, Some(0), priors);
        layout.number(1, Some(1), priors);
        layout.number(2, Some(2), priors);
        let features = ModelFeatures::new(&layout, 4, 20, || 0.3);
        // (1 + 2)(1 + 1)(1 + 1) = 12 products, of which 1 + 4 have less than two factors.
        assert_eq!(features.nodes.iter().filter(|n| has_feature(n).is_some()).count(), 7);
        let mut basis = BasisValues::new(&layout, &features);
        let (mut a, mut b) = (vec![0.0; features.len], vec![0.0; features.len]);
        let (q, r) = ([0.3, -0.8, 0.5], [-0.6, 0.2, 0.9]);
        features.evaluate(&layout, &q, &mut basis, &mut a);
        features.evaluate(&layout, &r, &mut basis, &mut b);
        let from = features.parts(&layout).products;
        let product: f64 = a[from..].iter().zip(&b[from..]).map(|(a, b)| a * b).sum();
        let x = [libm::cos(2.0 * 0.9), -0.16, 0.45];
        let pairs = 0.49 * (x[0] * x[1] + x[0] * x[2] + x[1] * x[2]);
        let expected = 0.9 * pairs + 0.5 * 0.343 * x.iter().product::<f64>();
        assert!((product - expected).abs() < 1e-9, "{product} {expected}");
    }
}
