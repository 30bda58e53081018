//! The kernel of one point with those before it, and the gradient of the evidence that these pairs give.

use super::super::functions::exp;
use super::super::layout::{Layout, ScaleKind};

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
            for (j, factor) in factors[g * capacity..][..n].iter().enumerate() {
                let z = factor - 1.0;
                triples[j] += pairs[j] * z;
                pairs[j] += sum[j] * z;
                sum[j] += z;
                product[j] *= factor;
            }
        }
        for j in 0..n {
            product[j] -= 1.0 + sum[j] + pairs[j] + triples[j];
        }
    }

    /// Writes the slopes of the products by one of their `factors`, with the amplitudes of those of two, of three and
    /// of more, times `outer`.
    pub fn slopes_of_products(&self, factors: &[f64], [pairs, triples, more]: [f64; 3], outer: &[f64], to: &mut [f64]) {
        for (j, factor) in factors.iter().enumerate() {
            let all = 1.0 + self.sum[j] + self.pairs[j] + self.triples[j] + self.product[j];
            // A factor is 0 only by chance; the others' product is then taken as 0.
            let others = if *factor == 0.0 { 0.0 } else { all / factor };
            // Sums of the products of one and of two of the others.
            let z = factor - 1.0;
            let one = self.sum[j] - z;
            let two = self.pairs[j] - z * one;
            to[j] = outer[j] * (pairs * one + triples * two + more * (others - 1.0 - one - two));
        }
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
