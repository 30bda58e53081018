//! The function that is left of a model once constant inputs are put in and what is negligible is left out.

use super::super::features::{ModelFeatures, has_feature, parent};
use super::super::functions::sin_cos;
use super::super::layout::Layout;
use super::super::regression::Regression;
use super::{MovingUnit, NONE, Product, Sizes, Weighted};

/// What is left out of a function changes it by no more than this part of the noise's standard deviation.
const NEGLIGIBLE: f64 = 0.01;

/// Scratch memory.
#[derive(Debug, Clone)]
pub(super) struct Folding {
    /// The new place of each component, or `NONE` for a constant one.
    places: Vec<u32>,
    /// Values of the constant components.
    constants: Vec<f64>,
    /// The product and the factor to which each product of the model comes.
    folded: Vec<(u32, f64)>,
    /// The product of each product (0 for none, and then one more) with each component.
    children: Vec<u32>,
    /// Magnitude and number of the pairs and products.
    magnitudes: Vec<(f64, u32)>,
    /// Whether each feature is left out.
    left_out: Vec<bool>,
}

impl Folding {
    pub fn new(sizes: &Sizes) -> Self {
        Self {
            places: vec![NONE; sizes.components],
            constants: vec![0.0; sizes.components],
            folded: vec![(NONE, 0.0); sizes.products],
            children: vec![NONE; (sizes.products + 1) * sizes.components],
            magnitudes: Vec::with_capacity(sizes.features),
            left_out: vec![false; sizes.features],
        }
    }
}

impl Weighted {
    /// Takes the weights `mean + part (sample - mean)` of a posterior of one output, and those of what its further
    /// samples differ from the mean. The inputs `held` (bits) have the values that they have in `q`.
    pub fn take(
        &mut self,
        layout: &Layout,
        features: &ModelFeatures,
        posterior: &Regression,
        part: f64,
        (q, held): (&[f64], u32),
    ) {
        let len = self.sizes.features;
        let root = posterior.scale(0).sqrt();
        for (j, to) in self.weights.chunks_exact_mut(len).enumerate() {
            let deviation = &posterior.deviation[j * len..(j + 1) * len];
            let (mean, part) = if j == 0 { (1.0, part * root) } else { (0.0, root) };
            for k in 0..len {
                to[k] = (mean * posterior.weights[k] + part * deviation[k]) * features.amplitudes[k];
            }
        }
        self.leave_out(layout, features, NEGLIGIBLE * posterior.lambda.sqrt() * root);
        self.fold_units(layout, features, q, held);
        self.fold_waves(layout, features);
        self.fold_products(features, features.parts(layout).products);
    }

    /// Finds the pairs and products which together add no more than `negligible`, the least ones first.
    fn leave_out(&mut self, layout: &Layout, features: &ModelFeatures, negligible: f64) {
        let parts = features.parts(layout);
        let Self { weights, folding, .. } = self;
        let len = features.len;
        let size = |k: usize| weights.chunks_exact(len).fold(0.0, |most: f64, w| most.max(w[k].abs()));
        let Folding { magnitudes, left_out, .. } = folding;
        magnitudes.clear();
        for k in 0..features.pairs {
            let (cosine, sine) = (parts.waves + k, parts.waves + features.pairs + k);
            magnitudes.push((size(cosine) + size(sine), cosine as u32));
        }
        magnitudes.extend((parts.products..len).map(|k| (size(k), k as u32)));
        magnitudes.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        left_out.fill(false);
        let mut sum = 0.0;
        for (size, k) in magnitudes {
            sum += *size;
            if sum > negligible {
                break;
            }
            left_out[*k as usize] = true;
        }
    }

    /// Constants, and the weights of moving units.
    fn fold_units(&mut self, layout: &Layout, features: &ModelFeatures, q: &[f64], held: u32) {
        let (parts, len) = (features.parts(layout), self.sizes.features);
        for (constant, w) in self.constants.iter_mut().zip(self.weights.chunks_exact(len)) {
            *constant = w[0];
        }
        self.units.clear();
        self.components = 0;
        for (u, unit) in layout.units.iter().enumerate() {
            let frequency = unit.circle.then(|| features.frequencies[u]);
            let is_held = unit.at < 32 && held & (1 << unit.at) != 0;
            let moving =
                MovingUnit { at: unit.at, frequency, component: self.components, in_products: unit.group.is_some() };
            let (sin, cos) = frequency.map_or((0.0, q[unit.at]), |w| sin_cos(w * q[unit.at]));
            for (c, value) in (unit.component..).zip([cos, sin]).take(moving.components().len()) {
                self.folding.constants[c] = value;
                self.folding.places[c] = if is_held { NONE } else { self.components as u32 };
                for (j, w) in self.weights.chunks_exact(len).enumerate() {
                    if is_held {
                        self.constants[j] += w[1 + c] * value;
                    } else {
                        self.linear[j * self.sizes.components + self.components] = w[1 + c];
                    }
                }
                self.components += usize::from(!is_held);
            }
            for (j, w) in self.weights.chunks_exact(len).enumerate() {
                let square = w[parts.squares + u];
                if is_held {
                    self.constants[j] += square * cos * cos;
                } else {
                    self.squares[j * self.sizes.units + self.units.len()] = square;
                }
            }
            if !is_held {
                self.units.push(moving);
            }
        }
    }

    /// Weights, frequencies and first phases of the pairs that count.
    fn fold_waves(&mut self, layout: &Layout, features: &ModelFeatures) {
        let parts = features.parts(layout);
        let left_out = &self.folding.left_out[parts.waves..];
        self.pairs = left_out[..features.pairs].iter().filter(|left_out| !**left_out).count();
        let (len, most) = (self.sizes.features, self.sizes.pairs);
        for (to, k) in (0..features.pairs).filter(|k| !left_out[*k]).enumerate() {
            for (j, w) in self.weights.chunks_exact(len).enumerate() {
                self.cosine_weights[j * most + to] = w[parts.waves + k];
                self.sine_weights[j * most + to] = w[parts.waves + features.pairs + k];
            }
            let mut phase = 0.0;
            for c in 0..layout.components {
                let wave = features.waves[c * features.pairs + k];
                match self.folding.places[c] {
                    NONE => phase += wave * self.folding.constants[c],
                    place => self.waves[place as usize * self.pairs + to] = wave,
                }
            }
            self.first_phases[to] = phase;
        }
    }

    /// The products of moving components, and their weights.
    fn fold_products(&mut self, features: &ModelFeatures, first: usize) {
        let (len, most, components) = (self.sizes.features, self.sizes.products, self.components);
        self.products.clear();
        self.folding.children[..components].fill(NONE);
        for (k, node) in features.nodes.iter().enumerate() {
            let (above, mut factor) = parent(node).map_or((NONE, 1.0), |p| self.folding.folded[p]);
            let c = node.component as usize;
            let folded = match self.folding.places[c] {
                NONE => {
                    factor *= self.folding.constants[c];
                    above
                }
                place => self.child(above, place),
            };
            self.folding.folded[k] = (folded, factor);
            let Some(feature) = has_feature(node).filter(|f| !self.folding.left_out[first + f]) else { continue };
            for (j, w) in self.weights.chunks_exact(len).enumerate() {
                let weight = factor * w[first + feature];
                match folded {
                    NONE => self.constants[j] += weight,
                    folded => self.product_weights[j * most + folded as usize] += weight,
                }
            }
        }
    }

    /// The product of the product `above` and a component, which is added if it is not there yet.
    fn child(&mut self, above: u32, component: u32) -> u32 {
        let (row, components) = (above.wrapping_add(1) as usize, self.components);
        let at = row * components + component as usize;
        if self.folding.children[at] == NONE {
            let new = self.products.len() as u32;
            self.folding.children[at] = new;
            self.folding.children[(new as usize + 1) * components..][..components].fill(NONE);
            self.products.push(Product { parent: above, component });
            for j in 0..self.sizes.outputs {
                self.product_weights[j * self.sizes.products + new as usize] = 0.0;
            }
        }
        self.folding.children[at]
    }
}
