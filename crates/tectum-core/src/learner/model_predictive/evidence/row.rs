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
    /// The product of all factors.
    pub product: Vec<f64>,
    /// The smooth part.
    pub smooth: Vec<f64>,
    /// The whole kernel.
    pub kernel: Vec<f64>,
    pub scratch: Vec<f64>,
}

impl Row {
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
