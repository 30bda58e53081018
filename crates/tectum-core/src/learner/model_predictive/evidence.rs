//! Marginal likelihood of the scales on a few points, with its gradient, and Adam steps on it.
//!
//! For points `q_1 .. q_N`, outputs `y_j` (N each) and `A = K + lambda I`, `lambda = (floor + noise) tr K / N`, the
//! logarithm of the evidence, with the scale `s_j = y_jᵀ A⁻¹ y_j / N` of each output at its optimum, is (Rasmussen &
//! Williams 2006, 5.4.1)
//!
//! ```text
//! L = sum_j (-1/2 log |A| - N/2 log s_j) + const
//! dL/dK = 1/2 sum_j (alpha_j alpha_jᵀ / s_j - A⁻¹),      alpha_j = A⁻¹ y_j
//! ```
//!
//! The logarithms of the scales have the prior `N(log p_0, width^2)`. Steps are Adam's (Kingma & Ba 2015).

#[cfg(test)]
mod check;
mod row;

use super::functions::{exp, sines_and_cosines};
use super::layout::{BIAS, Layout, NOISE, PAIRS, PRODUCTS, SMOOTH, ScaleKind, TRIPLES};
use super::linalg::{add_scaled, cholesky, dot, invert, packed, solve_lower, solve_lower_transposed};
use crate::state::{Persist, StateVisitor};
use row::Row;

/// Evidence of a layout's scales on at most `capacity` points.
#[derive(Debug, Clone)]
pub struct Evidence {
    /// Number of points in use.
    pub len: usize,
    capacity: usize,
    outputs: usize,
    /// Values of each place of `q`, by place, then point.
    values: Vec<f64>,
    /// Outputs, by output, then point.
    targets: Vec<f64>,
    /// By which factor the noise of each point is larger.
    noisier: Vec<f64>,
    /// Logarithms of the scales.
    pub scales: Vec<f64>,
    first: Vec<f64>,
    second: Vec<f64>,
    steps: u64,
    /// Scales before the last step, which had an evidence.
    good: Vec<f64>,
    /// Mean prior variance of the points.
    pub amplitude: f64,
    floor: f64,
    // Scratch memory.
    matrix: Vec<f64>,
    gradient: Vec<f64>,
    alpha: Vec<f64>,
    row: Row,
    cosines: Vec<f64>,
    sines: Vec<f64>,
    plain: Vec<f64>,
    outer: Vec<f64>,
}

impl Evidence {
    /// For at most `capacity` points and `outputs` outputs, with the layout's first scales.
    pub fn new(layout: &Layout, capacity: usize, outputs: usize) -> Self {
        let scales = layout.prior.len();
        let row = Row {
            inner: vec![0.0; layout.units.len() * capacity],
            turned: vec![0.0; layout.circles * capacity],
            factors: vec![0.0; layout.groups.len() * capacity],
            sum: vec![0.0; capacity],
            pairs: vec![0.0; capacity],
            triples: vec![0.0; capacity],
            product: vec![0.0; capacity],
            smooth: vec![0.0; capacity],
            kernel: vec![0.0; capacity],
        };
        Self {
            len: 0,
            capacity,
            outputs,
            values: vec![0.0; layout.width * capacity],
            targets: vec![0.0; outputs * capacity],
            noisier: vec![1.0; capacity],
            scales: layout.prior.clone(),
            first: vec![0.0; scales],
            second: vec![0.0; scales],
            steps: 0,
            good: layout.prior.clone(),
            amplitude: 1.0,
            floor: 0.0,
            matrix: vec![0.0; packed(capacity)],
            gradient: vec![0.0; scales],
            alpha: vec![0.0; outputs * capacity],
            row,
            cosines: vec![0.0; layout.circles * capacity],
            sines: vec![0.0; layout.circles * capacity],
            plain: vec![0.0; capacity],
            outer: vec![0.0; capacity],
        }
    }

    /// Forgets the points and the memory of Adam, and begins at `scales`.
    pub fn restart(&mut self, scales: &[f64]) {
        self.len = 0;
        self.scales.copy_from_slice(scales);
        self.first.fill(0.0);
        self.second.fill(0.0);
        self.steps = 0;
        self.good.copy_from_slice(scales);
    }

    /// Adds a point: `q`, its outputs, and by which factor its noise is larger than that of others.
    pub fn push(&mut self, q: &[f64], targets: &[f64], noisier: f64) {
        self.noisier[self.len] = noisier;
        for (place, value) in q.iter().enumerate() {
            self.values[place * self.capacity + self.len] = *value;
        }
        for (output, value) in targets.iter().enumerate() {
            self.targets[output * self.capacity + self.len] = *value;
        }
        self.len += 1;
    }

    /// By which factor the noise of a point is larger.
    pub fn noisier(&self, point: usize) -> f64 {
        self.noisier[point]
    }

    /// Sets that factor.
    pub fn set_noisier(&mut self, point: usize, noisier: f64) {
        self.noisier[point] = noisier;
    }

    /// Writes the `q` of a point.
    pub fn point(&self, point: usize, q: &mut [f64]) {
        for (place, to) in q.iter_mut().enumerate() {
            *to = self.values[place * self.capacity + point];
        }
    }

    /// The noise `lambda`: a part of the mean prior variance of the points, so that a common factor of all
    /// amplitudes is without effect on the evidence.
    pub fn noise(&self) -> f64 {
        (self.floor + exp(self.scales[NOISE])) * self.amplitude
    }

    /// The scale that gives the noise `lambda`.
    pub fn scale_of_noise(&self, lambda: f64) -> f64 {
        libm::log((lambda / self.amplitude - self.floor).max(self.floor))
    }

    /// Operations of one step.
    pub fn cost(&self, layout: &Layout) -> u64 {
        let n = self.len as u64;
        // Pairs, in loops of half of the points on average.
        n * (n + 16) / 2 * (14 * layout.units.len() as u64 + 60 + 3 * self.outputs as u64) + n * n * n
    }

    /// The log evidence with the prior of the scales; its gradient is then in `gradient`. `None` if the matrix is
    /// not positive definite.
    fn evaluate(&mut self, layout: &Layout, width: f64, floor: f64) -> Option<f64> {
        let (n, capacity) = (self.len, self.capacity);
        self.floor = floor;
        self.angles(layout);
        let mut total = 0.0;
        for i in 0..n {
            self.kernel_row(layout, i);
            let row = &mut self.matrix[packed(i)..packed(i + 1)];
            row.copy_from_slice(&self.row.kernel[..=i]);
            total += row[i];
        }
        self.amplitude = total / n as f64;
        for i in 0..n {
            self.matrix[packed(i) + i] += self.noise() * self.noisier[i];
        }
        if !cholesky(&mut self.matrix, n) {
            return None;
        }
        let (mut evidence, counted) = self.weigh_outputs();
        invert(&mut self.matrix, n, &mut self.plain);
        self.gradient.fill(0.0);
        // The trace of dL/dK: the noise depends on the diagonal.
        let mut trace = 0.0;
        for i in 0..n {
            trace -= 0.5 * self.noisier[i] * f64::from(counted) * self.matrix[packed(i) + i];
            for j in 0..self.outputs {
                trace += 0.5 * self.noisier[i] * self.alpha[j * capacity + i] * self.alpha[j * capacity + i];
            }
        }
        self.gradient[NOISE] = exp(self.scales[NOISE]) * self.amplitude * trace;
        let diagonal = (floor + exp(self.scales[NOISE])) * trace / n as f64;
        for i in 0..n {
            self.gradient_row(layout, i, f64::from(counted), diagonal);
        }
        for (k, g) in self.gradient.iter_mut().enumerate() {
            let from = (self.scales[k] - layout.prior[k]) / width;
            evidence -= 0.5 * from * from;
            *g = if layout.learned[k] { *g - from / width } else { 0.0 };
        }
        Some(evidence)
    }

    /// The evidence of the outputs, from the Cholesky factor, and how many of them count. `alpha` is then `alpha_j`
    /// over the root of `s_j`.
    fn weigh_outputs(&mut self) -> (f64, u32) {
        let (n, capacity) = (self.len, self.capacity);
        let mut log_determinant = 0.0;
        for i in 0..n {
            log_determinant += 2.0 * libm::log(self.matrix[packed(i) + i]);
        }
        let mut evidence = 0.0;
        let mut counted = 0_u32;
        for j in 0..self.outputs {
            let targets = &self.targets[j * capacity..j * capacity + n];
            let alpha = &mut self.alpha[j * capacity..j * capacity + n];
            alpha.copy_from_slice(targets);
            solve_lower(&self.matrix, alpha);
            solve_lower_transposed(&self.matrix, alpha);
            let scale = dot(targets, alpha) / n as f64;
            if dot(targets, targets) < 1e-9 * n as f64 || scale <= 0.0 {
                // An output that never changes says nothing about the scales.
                alpha.fill(0.0);
                continue;
            }
            evidence -= 0.5 * (log_determinant + n as f64 * libm::log(scale));
            let root = 1.0 / scale.sqrt();
            alpha.iter_mut().for_each(|a| *a *= root);
            counted += 1;
        }
        (evidence, counted)
    }

    /// Cosines and sines of all angles and points.
    fn angles(&mut self, layout: &Layout) {
        let (n, capacity) = (self.len, self.capacity);
        for (u, unit) in layout.units[..layout.circles].iter().enumerate() {
            let w = exp(self.scales[Layout::scale(u, ScaleKind::Frequency)]);
            self.plain[..n].fill(0.0);
            for (at, factor) in unit.terms.each() {
                let factor = w * factor;
                for (to, x) in self.plain.iter_mut().zip(&self.values[at * capacity..][..n]) {
                    *to += factor * x;
                }
            }
            let at = u * capacity..u * capacity + n;
            sines_and_cosines(&self.plain[..n], &mut self.sines[at.clone()], &mut self.cosines[at]);
        }
    }

    /// The kernel of point `i` with the points up to itself.
    fn kernel_row(&mut self, layout: &Layout, i: usize) {
        let (n, capacity) = (i + 1, self.capacity);
        let Self { row, scales, values, cosines, sines, .. } = self;
        let bias = exp(scales[BIAS]);
        row.kernel[..n].fill(bias);
        row.smooth[..n].fill(0.0);
        for g in 0..layout.groups.len() {
            row.factors[g * capacity..][..n].fill(1.0);
        }
        for (u, unit) in layout.units.iter().enumerate() {
            let scale = |s| if unit.scales[s as usize] { exp(scales[Layout::scale(u, s)]) } else { 0.0 };
            let (linear, square, rho) = (scale(ScaleKind::Linear), scale(ScaleKind::Square), scale(ScaleKind::Smooth));
            if unit.circle {
                row.add_angle(u, [&*cosines, &*sines].map(|x| &x[u * capacity..][..n]), [linear, rho]);
            } else {
                row.add_number(u, &values[unit.at * capacity..][..n], [linear, square, rho]);
            }
            if let Some(group) = unit.group {
                row.add_to_group((u, group), scale(ScaleKind::Product), n);
            }
        }
        row.multiply(n, layout.groups.len(), capacity);
        row.sum_up(n, [PAIRS, TRIPLES, PRODUCTS, SMOOTH].map(|k| exp(scales[k])));
    }

    /// Adds to the gradient what the pairs of point `i` with the points up to itself give.
    fn gradient_row(&mut self, layout: &Layout, i: usize, counted: f64, diagonal: f64) {
        let (n, capacity) = (i + 1, self.capacity);
        // dL/dK of the pairs; off the diagonal each pair counts twice.
        for (to, inverse) in self.outer.iter_mut().zip(&self.matrix[packed(i)..packed(n)]) {
            *to = -counted * inverse;
        }
        for j in 0..self.outputs {
            let alpha = &self.alpha[j * capacity..][..n];
            add_scaled(&mut self.outer[..n], alpha[i], alpha);
        }
        self.outer[i] = 0.5 * self.outer[i] + diagonal;
        self.kernel_row(layout, i);
        let Self { row, scales, values, gradient, outer, plain, .. } = self;
        let outer = &outer[..n];
        let [pairs, triples, products] = [PAIRS, TRIPLES, PRODUCTS].map(|k| exp(scales[k]));
        gradient[BIAS] += exp(scales[BIAS]) * outer.iter().sum::<f64>();
        gradient[SMOOTH] += dot(outer, &row.smooth[..n]);
        for j in 0..n {
            gradient[PAIRS] += outer[j] * pairs * row.pairs[j];
            gradient[TRIPLES] += outer[j] * triples * row.triples[j];
            gradient[PRODUCTS] += outer[j] * products * row.product[j];
            row.smooth[j] *= outer[j];
        }
        for (u, unit) in layout.units.iter().enumerate() {
            let inner = &row.inner[u * capacity..][..n];
            let scale = |s| if unit.scales[s as usize] { exp(scales[Layout::scale(u, s)]) } else { 0.0 };
            let (linear, square, rho) = (scale(ScaleKind::Linear), scale(ScaleKind::Square), scale(ScaleKind::Smooth));
            let along_inner = dot(outer, inner);
            gradient[Layout::scale(u, ScaleKind::Linear)] += linear * along_inner;
            let v = scale(ScaleKind::Product);
            if let Some(group) = unit.group {
                let factors = &row.factors[group * capacity..][..n];
                row.slopes_of_products(factors, [pairs, triples, products], outer, plain);
                gradient[Layout::scale(u, ScaleKind::Product)] += v * dot(&plain[..n], inner);
            } else {
                plain[..n].fill(0.0);
            }
            let x = &values[unit.at * capacity..][..n];
            let scaled = [linear, square, v, rho];
            if unit.circle {
                row.circle_gradient(u, [outer, &plain[..n], x], scaled, scales, gradient);
            } else {
                row.number_gradient(u, [outer, x], scaled, gradient);
            }
        }
    }

    /// One step of Adam uphill, of size `step` in the logarithms. Returns the log evidence before it.
    pub fn step(&mut self, layout: &Layout, width: f64, step: f64, noise_floor: f64) -> Option<f64> {
        let Some(evidence) = self.evaluate(layout, width, noise_floor) else {
            // Scales that make the matrix singular: back to those before.
            self.scales.copy_from_slice(&self.good);
            return None;
        };
        self.good.copy_from_slice(&self.scales);
        self.steps += 1;
        let (decay_first, decay_second) = (0.8_f64, 0.95_f64);
        let correct = |decay: f64| 1.0 - libm::pow(decay, self.steps as f64);
        let (first_total, second_total) = (correct(decay_first), correct(decay_second));
        for k in 0..self.scales.len() {
            let g = self.gradient[k];
            self.first[k] = decay_first * self.first[k] + (1.0 - decay_first) * g;
            self.second[k] = decay_second * self.second[k] + (1.0 - decay_second) * g * g;
            let size = (self.second[k] / second_total).sqrt() + 1e-8;
            self.scales[k] += step * self.first[k] / first_total / size;
        }
        Some(evidence)
    }
}

impl Persist for Evidence {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        let mut len = self.len as u64;
        visitor.number("points", &mut len);
        self.len = (len as usize).min(self.capacity);
        visitor.numbers("values", &mut self.values);
        visitor.numbers("targets", &mut self.targets);
        visitor.numbers("noisier", &mut self.noisier);
        visitor.numbers("scales", &mut self.scales);
        visitor.numbers("first", &mut self.first);
        visitor.numbers("second", &mut self.second);
        visitor.number("steps", &mut self.steps);
        visitor.numbers("good", &mut self.good);
        visitor.number("amplitude", &mut self.amplitude);
        visitor.number("floor", &mut self.floor);
    }
}
