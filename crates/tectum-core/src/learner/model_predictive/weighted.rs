//! A model as a function of `q`, with the derivatives that the planner needs.
//!
//! For outputs `y_j(q) = w_jᵀ phi(q)`: values (O), the Jacobian `dy / dq` (O x D), and for the first output the Hessian
//! over chosen places of `q`. The first output is the model's mean; the others are how samples of the posterior differ
//! from it. Products are differentiated backwards through their tree; their Hessian is the forward derivative of that
//! (Griewank & Walther 2008).
//!
//! A plan asks for thousands of values with the same weights, and with the same values of those inputs that nothing
//! moves. So the function is made anew for every plan (`fold.rs`): constant inputs are put in, products that then
//! are the same become one, and what is smaller than the noise is left out.

mod curves;
mod fold;

use super::features::ModelFeatures;
use super::functions::{sin_cos, sines_and_cosines};
use super::layout::Layout;
use super::linalg::{add_scaled, dot};

/// No node.
const NONE: u32 = u32::MAX;

/// A unit whose input is not constant.
#[derive(Debug, Clone, Copy)]
struct MovingUnit {
    /// Its place in `q`.
    at: usize,
    /// The frequency of an angle, seen as cosine and sine; `None` for a number.
    frequency: Option<f64>,
    /// The first of its components.
    component: usize,
    /// Whether it is part of products.
    in_products: bool,
}

impl MovingUnit {
    fn components(&self) -> std::ops::Range<usize> {
        self.component..self.component + if self.frequency.is_some() { 2 } else { 1 }
    }
}

/// A product: a component times the product of its parent, which stands before it.
#[derive(Debug, Clone, Copy)]
struct Product {
    parent: u32,
    component: u32,
}

impl Product {
    fn parent(&self) -> Option<usize> {
        (self.parent != NONE).then_some(self.parent as usize)
    }
}

/// Most of each part.
#[derive(Debug, Clone, Copy)]
struct Sizes {
    outputs: usize,
    features: usize,
    components: usize,
    units: usize,
    pairs: usize,
    products: usize,
}

/// A model's weights, times the amplitudes of the features, and the function that follows from them.
#[derive(Debug, Clone)]
pub struct Weighted {
    sizes: Sizes,
    /// By output, then feature.
    weights: Vec<f64>,
    /// The function: constants by output, then weights by output and component, unit, pair, product.
    constants: Vec<f64>,
    linear: Vec<f64>,
    squares: Vec<f64>,
    cosine_weights: Vec<f64>,
    sine_weights: Vec<f64>,
    product_weights: Vec<f64>,
    units: Vec<MovingUnit>,
    components: usize,
    pairs: usize,
    products: Vec<Product>,
    /// Frequencies of the pairs, by component, then pair, and their phases where all components are 0.
    waves: Vec<f64>,
    first_phases: Vec<f64>,
    /// Values at the last point: components with their slopes, pairs, products.
    values: Vec<f64>,
    slopes: Vec<f64>,
    phases: Vec<f64>,
    cosines: Vec<f64>,
    sines: Vec<f64>,
    product_values: Vec<f64>,
    folding: fold::Folding,
    scratch: curves::CurveScratch,
}

impl Weighted {
    /// For `outputs` outputs.
    pub fn new(layout: &Layout, features: &ModelFeatures, outputs: usize) -> Self {
        let sizes = Sizes {
            outputs,
            features: features.len,
            components: layout.components,
            units: layout.units.len(),
            pairs: features.pairs,
            products: features.most_nodes,
        };
        let zeros = |len: usize| vec![0.0; len];
        Self {
            weights: zeros(outputs * features.len),
            constants: zeros(outputs),
            linear: zeros(outputs * sizes.components),
            squares: zeros(outputs * sizes.units),
            cosine_weights: zeros(outputs * sizes.pairs),
            sine_weights: zeros(outputs * sizes.pairs),
            product_weights: zeros(outputs * sizes.products),
            units: Vec::with_capacity(sizes.units),
            components: 0,
            pairs: 0,
            products: Vec::with_capacity(sizes.products),
            waves: zeros(sizes.components * sizes.pairs),
            first_phases: zeros(sizes.pairs),
            values: zeros(sizes.components),
            slopes: zeros(sizes.components),
            phases: zeros(sizes.pairs),
            cosines: zeros(sizes.pairs),
            sines: zeros(sizes.pairs),
            product_values: zeros(sizes.products),
            folding: fold::Folding::new(&sizes),
            scratch: curves::CurveScratch::new(&sizes, layout.width),
            sizes,
        }
    }

    /// Components, pairs and products of the function, which decide what a value takes.
    pub fn size(&self) -> [u64; 3] {
        [self.components as u64, self.pairs as u64, self.products.len() as u64]
    }

    /// Computes components, pairs and products at `q`.
    fn evaluate(&mut self, q: &[f64]) {
        for unit in &self.units {
            let (c, x) = (unit.component, q[unit.at]);
            match unit.frequency {
                Some(w) => {
                    let (sin, cos) = sin_cos(w * x);
                    (self.values[c], self.values[c + 1]) = (cos, sin);
                    (self.slopes[c], self.slopes[c + 1]) = (-w * sin, w * cos);
                }
                None => (self.values[c], self.slopes[c]) = (x, 1.0),
            }
        }
        let m = self.pairs;
        if m > 0 {
            let phases = &mut self.phases[..m];
            phases.copy_from_slice(&self.first_phases[..m]);
            for (value, waves) in self.values[..self.components].iter().zip(self.waves.chunks_exact(m)) {
                add_scaled(phases, *value, waves);
            }
            sines_and_cosines(phases, &mut self.sines[..m], &mut self.cosines[..m]);
        }
        for (k, product) in self.products.iter().enumerate() {
            let parent = product.parent().map_or(1.0, |p| self.product_values[p]);
            self.product_values[k] = parent * self.values[product.component as usize];
        }
    }

    /// The values of the first outputs at `q`.
    pub fn value(&mut self, q: &[f64], out: &mut [f64]) {
        self.evaluate(q);
        self.outputs_at_point(0, out);
    }

    /// The values of the outputs from `first` on, at the last point.
    pub fn outputs_at_point(&self, first: usize, out: &mut [f64]) {
        let (c, u, m, k) = (self.components, self.units.len(), self.pairs, self.products.len());
        for (j, y) in (first..).zip(out) {
            let mut sum = self.constants[j] + dot(&self.linear[j * self.sizes.components..][..c], &self.values[..c]);
            for (square, unit) in self.squares[j * self.sizes.units..][..u].iter().zip(&self.units) {
                sum += square * self.values[unit.component] * self.values[unit.component];
            }
            sum += dot(&self.cosine_weights[j * self.sizes.pairs..][..m], &self.cosines[..m]);
            sum += dot(&self.sine_weights[j * self.sizes.pairs..][..m], &self.sines[..m]);
            sum += dot(&self.product_weights[j * self.sizes.products..][..k], &self.product_values[..k]);
            *y = sum;
        }
    }
}
