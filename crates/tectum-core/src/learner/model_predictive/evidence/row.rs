//! The kernel of one point with those before it, and the gradient of the evidence that these pairs give.
//!
//! Loops over points are `wide!` functions of slices, so that the compiler makes vectors of them.

use tectum_encoder::simd::{F32x8, Kernel, SimdPath};

use super::super::functions::exp;
use super::super::layout::{Layout, ScaleKind};
use super::super::linalg::{add_scaled, wide};

/// Scratch memory of the kernel of one point with those before it.
#[derive(Debug, Clone, Default)]
pub(super) struct Row {
    /// Inner product of each unit, by unit, then point.
    pub inner: Vec<f64>,
    /// `sin(w (x - x'))` of each angle.
    pub turned: Vec<f64>,
    /// Factor of each group.
    pub factors: Vec<f64>,
    /// Sum of all factors less 1.
    pub sum: Vec<f64>,
    /// The products of two of them.
    pub pairs: Vec<f64>,
    /// The products of three of them.
    pub triples: Vec<f64>,
    /// The products of four or more: the product of all factors less the rest.
    pub product: Vec<f64>,
    /// The smooth part.
    pub smooth: Vec<f64>,
    /// The whole kernel.
    pub kernel: Vec<f64>,
}

impl Row {
    /// The products of the first `n` points' factors, of `groups` groups.
    pub fn multiply(&mut self, n: usize, groups: usize, capacity: usize) {
        let Self { factors, sum, pairs, triples, product, .. } = self;
        let [sum, pairs, triples, product] = [sum, pairs, triples, product].map(|values| &mut values[..n]);
        sum.fill(0.0);
        pairs.fill(0.0);
        triples.fill(0.0);
        product.fill(1.0);
        for g in 0..groups {
            multiply_by(&factors[g * capacity..][..n], [&mut *sum, &mut *pairs, &mut *triples, &mut *product]);
        }
        for j in 0..n {
            product[j] -= 1.0 + sum[j] + pairs[j] + triples[j];
        }
    }

    /// Adds what angle `u` gives to the kernel and to the exponent of its smooth part, for its cosines and sines up to
    /// that of the row's point.
    pub fn add_angle(&mut self, u: usize, [c, s]: [&[f64]; 2], scales: [f64; 2]) {
        let (n, from) = (c.len(), u * self.product.len());
        let (inner, turned) = (&mut self.inner[from..][..n], &mut self.turned[from..][..n]);
        let (kernel, smooth) = (&mut self.kernel[..n], &mut self.smooth[..n]);
        add_angle(c, s, scales, [inner, turned, kernel, smooth]);
    }

    /// The same of number `u`, for its values.
    pub fn add_number(&mut self, u: usize, x: &[f64], scales: [f64; 3]) {
        let (n, from) = (x.len(), u * self.product.len());
        add_number(x, scales, [&mut self.inner[from..][..n], &mut self.kernel[..n], &mut self.smooth[..n]]);
    }

    /// Adds `v` times the inner products of unit `u` to the factor of its group.
    pub fn add_to_group(&mut self, (u, group): (usize, usize), v: f64, n: usize) {
        let capacity = self.product.len();
        add_scaled(&mut self.factors[group * capacity..][..n], v, &self.inner[u * capacity..][..n]);
    }

    /// Adds the products and the smooth part, with their amplitudes, to the kernel.
    pub fn sum_up(&mut self, n: usize, amplitudes: [f64; 4]) {
        let Self { pairs, triples, product, smooth, kernel, .. } = self;
        sum_up([&pairs[..n], &triples[..n], &product[..n]], amplitudes, &mut smooth[..n], &mut kernel[..n]);
    }

    /// Writes the slopes of the products by one of their `factors`, with the amplitudes of those of two, of three and
    /// of more, times `outer`.
    pub fn slopes_of_products(&self, factors: &[f64], [pairs, triples, more]: [f64; 3], outer: &[f64], to: &mut [f64]) {
        let products = [&self.sum, &self.pairs, &self.triples, &self.product].map(|values| &values[..factors.len()]);
        slopes_of_products(factors, products, [pairs, triples, more], outer, to);
    }

    /// Gradient by the frequency and the inverse squared length of angle `u`; see `gradient_row` for the arguments.
    pub fn circle_gradient(
        &self,
        u: usize,
        [outer, plain, x]: [&[f64]; 3],
        [linear, _, v, rho]: [f64; 4],
        scales: &[f64],
        gradient: &mut [f64],
    ) {
        let (n, from) = (x.len(), u * self.product.len());
        let (inner, turned) = (&self.inner[from..][..n], &self.turned[from..][..n]);
        let at = Layout::scale(u, ScaleKind::Frequency);
        let (mut smooth, mut frequency) = (0.0, 0.0);
        for j in 0..n {
            smooth += self.smooth[j] * (1.0 - inner[j]);
            let slope = linear * outer[j] + v * plain[j] + rho * self.smooth[j];
            frequency -= slope * turned[j] * (x[n - 1] - x[j]);
        }
        gradient[Layout::scale(u, ScaleKind::Smooth)] -= rho * smooth;
        gradient[at] += exp(scales[at]) * frequency;
    }

    /// Gradient by the square's variance and the inverse squared length of the number `u`.
    pub fn number_gradient(
        &self,
        u: usize,
        [outer, x]: [&[f64]; 2],
        [_, square, _, rho]: [f64; 4],
        gradient: &mut [f64],
    ) {
        let (n, from) = (x.len(), u * self.product.len());
        let inner = &self.inner[from..][..n];
        let (mut smooth, mut squares) = (0.0, 0.0);
        for j in 0..n {
            let apart = x[n - 1] - x[j];
            smooth += self.smooth[j] * apart * apart;
            squares += outer[j] * inner[j] * inner[j];
        }
        gradient[Layout::scale(u, ScaleKind::Smooth)] -= 0.5 * rho * smooth;
        gradient[Layout::scale(u, ScaleKind::Square)] += square * squares;
    }
}

wide! {
    multiply_by, multiply_by_on, MultiplyBy,
    plain_multiply_by(factors: &'a [f64], products: [&'a mut [f64]; 4]) -> ()
}

#[inline(always)]
fn plain_multiply_by(factors: &[f64], [sum, pairs, triples, product]: [&mut [f64]; 4]) {
    let n = factors.len();
    let (sum, pairs, triples, product) = (&mut sum[..n], &mut pairs[..n], &mut triples[..n], &mut product[..n]);
    for j in 0..n {
        let z = factors[j] - 1.0;
        triples[j] += pairs[j] * z;
        pairs[j] += sum[j] * z;
        sum[j] += z;
        product[j] *= factors[j];
    }
}

wide! {
    add_angle, add_angle_on, AddAngle,
    plain_add_angle(c: &'a [f64], s: &'a [f64], scales: [f64; 2], to: [&'a mut [f64]; 4]) -> ()
}

#[inline(always)]
fn plain_add_angle(c: &[f64], s: &[f64], [linear, rho]: [f64; 2], [inner, turned, kernel, smooth]: [&mut [f64]; 4]) {
    let n = c.len();
    let (s, inner, turned) = (&s[..n], &mut inner[..n], &mut turned[..n]);
    let (kernel, smooth) = (&mut kernel[..n], &mut smooth[..n]);
    let (here_c, here_s) = (c[n - 1], s[n - 1]);
    for j in 0..n {
        inner[j] = here_c * c[j] + here_s * s[j];
        turned[j] = here_s * c[j] - here_c * s[j];
        kernel[j] += linear * inner[j];
        smooth[j] += rho * (1.0 - inner[j]);
    }
}

wide! {
    add_number, add_number_on, AddNumber,
    plain_add_number(x: &'a [f64], scales: [f64; 3], to: [&'a mut [f64]; 3]) -> ()
}

#[inline(always)]
fn plain_add_number(x: &[f64], [linear, square, rho]: [f64; 3], [inner, kernel, smooth]: [&mut [f64]; 3]) {
    let n = x.len();
    let (inner, kernel, smooth) = (&mut inner[..n], &mut kernel[..n], &mut smooth[..n]);
    let here = x[n - 1];
    for j in 0..n {
        inner[j] = here * x[j];
        let apart = here - x[j];
        kernel[j] += inner[j] * (linear + square * inner[j]);
        smooth[j] += 0.5 * rho * apart * apart;
    }
}

wide! {
    sum_up, sum_up_on, SumUp,
    plain_sum_up(
        products: [&'a [f64]; 3], amplitudes: [f64; 4], smooth: &'a mut [f64], kernel: &'a mut [f64]
    ) -> ()
}

#[inline(always)]
fn plain_sum_up([pairs, triples, product]: [&[f64]; 3], amplitudes: [f64; 4], smooth: &mut [f64], kernel: &mut [f64]) {
    let n = pairs.len();
    let (triples, product, smooth, kernel) = (&triples[..n], &product[..n], &mut smooth[..n], &mut kernel[..n]);
    let [of_pairs, of_triples, of_more, of_smooth] = amplitudes;
    for j in 0..n {
        smooth[j] = of_smooth * exp(-smooth[j]);
        kernel[j] += of_pairs * pairs[j] + of_triples * triples[j] + of_more * product[j] + smooth[j];
    }
}

wide! {
    slopes_of_products, slopes_of_products_on, SlopesOfProducts,
    plain_slopes_of_products(
        factors: &'a [f64], products: [&'a [f64]; 4], amplitudes: [f64; 3], outer: &'a [f64], to: &'a mut [f64]
    ) -> ()
}

#[inline(always)]
fn plain_slopes_of_products(
    factors: &[f64],
    [sum, pairs, triples, product]: [&[f64]; 4],
    [of_pairs, of_triples, of_more]: [f64; 3],
    outer: &[f64],
    to: &mut [f64],
) {
    let n = factors.len();
    let (sum, pairs, triples, product) = (&sum[..n], &pairs[..n], &triples[..n], &product[..n]);
    let (outer, to) = (&outer[..n], &mut to[..n]);
    for j in 0..n {
        let factor = factors[j];
        let all = 1.0 + sum[j] + pairs[j] + triples[j] + product[j];
        // A factor is 0 only by chance; the others' product is then taken as 0.
        let others = if factor == 0.0 { 0.0 } else { all / factor };
        // Sums of the products of one and of two of the others.
        let z = factor - 1.0;
        let one = sum[j] - z;
        let two = pairs[j] - z * one;
        to[j] = outer[j] * (of_pairs * one + of_triples * two + of_more * (others - 1.0 - one - two));
    }
}
