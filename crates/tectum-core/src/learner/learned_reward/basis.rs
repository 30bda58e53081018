//! One-dimensional bases over the inputs; the reward model consists of their products.
//!
//! There are two families. The Gaussian one is the paper's: a row of kernels whose radius is their spacing. The
//! smooth one is a Fourier series over an input that wraps and Legendre polynomials over an input that does not
//! (Konidaris, Osentoski & Thomas 2011, *Value Function Approximation in Reinforcement Learning using the
//! Fourier Basis*). Each function has a prior standard deviation. In the smooth family it decreases with the
//! order, so that the model prefers the smoothest reward that fits the data, and a few ticks at a few targets
//! determine it over the whole input box.

use std::f32::consts::{LOG2_E, PI};

use tectum_encoder::simd::F32x16;
use tectum_encoder::{exp2_negative, exp2_negative_lanes};

use super::lanes::{Lanes, divided, sine_and_cosine};
use crate::SignalConfig;
use crate::learner::ModelBasis;

/// A row of Gaussian kernels, whose values and slopes are computed together.
#[derive(Debug, Clone)]
pub(super) struct KernelRow {
    pub units: usize,
    centres: Vec<f32>,
    /// `1 / radius^2`.
    precision: f32,
}

impl KernelRow {
    /// `units` kernels with centres from `min` to `max`.
    pub fn new(units: usize, min: f64, max: f64, radius: f64) -> Self {
        let spacing = (max - min) / (units - 1) as f64;
        let centres = (0..units).map(|i| (min + spacing * i as f64) as f32).collect();
        Self { units, centres, precision: (1.0 / (radius * radius)) as f32 }
    }

    /// The kernels' values and their slopes at `x`.
    pub fn eval(&self, x: f32, values: &mut [f32], slopes: &mut [f32]) {
        let (values, slopes) = (&mut values[..self.units], &mut slopes[..self.units]);
        let (precision, exponent_scale) = (self.precision, 0.5 * LOG2_E * self.precision);
        for ((value, slope), centre) in values.iter_mut().zip(slopes).zip(&self.centres) {
            let distance = centre - x;
            let v = exp2_negative(exponent_scale * distance * distance, MAX_EXPONENT);
            *value = v;
            *slope = precision * distance * v;
        }
    }

    /// Writes the kernels' values at `x` to `values`, for sixteen rollouts. Returns the sum of their squares.
    #[inline(always)]
    pub fn eval_lanes<W: F32x16>(&self, x: W, values: &mut [Lanes]) -> W {
        let (exponent_scale, limit) = (W::splat(0.5 * LOG2_E * self.precision), W::splat(MAX_EXPONENT));
        let mut squares = W::splat(-0.0);
        for (value, centre) in values[..self.units].iter_mut().zip(&self.centres) {
            let distance = W::splat(*centre) - x;
            let v = exp2_negative_lanes((exponent_scale * distance * distance).min(limit));
            value.0 = v.store();
            squares = squares + v * v;
        }
        squares
    }

    /// The slope at `x` of the kernel of unit `unit`, whose value there is `value`.
    #[inline(always)]
    pub fn slope_lanes<W: F32x16>(&self, unit: usize, x: W, value: W) -> W {
        W::splat(self.precision) * (W::splat(self.centres[unit]) - x) * value
    }
}

/// No kernel is below 2 to minus this, so that none is subnormal.
const MAX_EXPONENT: f32 = 43.0;

/// A basis over one input.
#[derive(Debug, Clone)]
pub(super) enum Basis {
    /// Gaussian kernels.
    Kernels(KernelRow),
    /// `cos x, sin x, cos 2x, ..` up to the order, and `(x / pi)^2`, for which a Fourier series would need many
    /// terms.
    Waves(usize),
    /// Legendre polynomials from the first order on, over a range scaled to [-1, 1].
    Polynomials { order: usize, centre: f32, half: f32 },
}

impl Basis {
    /// The basis over `signal`, with `size` kernels or of order `size`.
    pub fn of(family: ModelBasis, size: usize, signal: &SignalConfig) -> Self {
        let (min, max) = (signal.min, signal.max);
        match family {
            ModelBasis::Maps => Self::Kernels(KernelRow::new(size, min, max, (max - min) / (size - 1) as f64)),
            ModelBasis::Smooth if signal.wraps() => Self::Waves(size),
            ModelBasis::Smooth => {
                let (centre, half) = (((min + max) / 2.0) as f32, ((max - min) / 2.0) as f32);
                Self::Polynomials { order: size, centre, half }
            }
        }
    }

    /// Number of functions.
    pub fn len(&self) -> usize {
        match self {
            Self::Kernels(row) => row.units,
            Self::Waves(order) => 2 * order + 1,
            Self::Polynomials { order, .. } => *order,
        }
    }

    /// The prior standard deviation of the weight of function `i`, with a factor `smoothness` per order above
    /// the first.
    pub fn spread(&self, i: usize, smoothness: f64) -> f64 {
        match self {
            Self::Kernels(_) => 1.0,
            Self::Waves(order) if i == 2 * order => smoothness,
            Self::Waves(_) => smoothness.powi((i / 2) as i32),
            Self::Polynomials { .. } => smoothness.powi(i as i32),
        }
    }

    /// The functions' values and slopes at `x`.
    pub fn eval(&self, x: f32, values: &mut [f32], slopes: &mut [f32]) {
        match self {
            Self::Kernels(row) => row.eval(x, values, slopes),
            Self::Waves(order) => {
                let (sin, cos) = libm::sincosf(x);
                let (mut s, mut c) = (0.0, 1.0);
                for k in 0..*order {
                    (s, c) = (s * cos + c * sin, c * cos - s * sin);
                    let n = (k + 1) as f32;
                    values[2 * k..][..2].copy_from_slice(&[c, s]);
                    slopes[2 * k..][..2].copy_from_slice(&[-n * s, n * c]);
                }
                values[2 * order] = x * x / (PI * PI);
                slopes[2 * order] = 2.0 * x / (PI * PI);
            }
            Self::Polynomials { order, centre, half } => {
                let z = (x - centre) / half;
                // Bonnet's recursion, and for the derivatives P'(n+1) = P'(n-1) + (2n + 1) P(n).
                let (mut p, mut slope) = ([1.0, z], [0.0, 1.0]);
                for i in 0..*order {
                    (values[i], slopes[i]) = (p[1], slope[1] / half);
                    let n = (i + 1) as f32;
                    p = [p[1], ((2.0 * n + 1.0) * z * p[1] - n * p[0]) / (n + 1.0)];
                    slope = [slope[1], slope[0] + (2.0 * n + 1.0) * p[0]];
                }
            }
        }
    }
}

impl Basis {
    /// [`eval`](Self::eval) of sixteen numbers side by side: the same bits.
    #[inline(always)]
    pub fn eval_lanes<W: F32x16>(&self, x: W, values: &mut [Lanes], slopes: &mut [Lanes]) {
        let (values, slopes) = (&mut values[..self.len()], &mut slopes[..self.len()]);
        match self {
            Self::Kernels(row) => {
                row.eval_lanes(x, values);
                for (unit, (value, slope)) in values.iter().zip(slopes).enumerate() {
                    slope.0 = row.slope_lanes(unit, x, W::load(&value.0)).store();
                }
            }
            Self::Waves(order) => {
                let [sine, cosine] = sine_and_cosine(x);
                let (mut s, mut c) = (W::splat(0.0), W::splat(1.0));
                for k in 0..*order {
                    (s, c) = (s * cosine + c * sine, c * cosine - s * sine);
                    let n = (k + 1) as f32;
                    (values[2 * k].0, values[2 * k + 1].0) = (c.store(), s.store());
                    slopes[2 * k].0 = (W::splat(-n) * s).store();
                    slopes[2 * k + 1].0 = (W::splat(n) * c).store();
                }
                values[2 * order].0 = divided(x * x, PI * PI).store();
                slopes[2 * order].0 = divided(W::splat(2.0) * x, PI * PI).store();
            }
            Self::Polynomials { order, centre, half } => {
                let z = divided(x - W::splat(*centre), *half);
                let (mut p, mut slope) = ([W::splat(1.0), z], [W::splat(0.0), W::splat(1.0)]);
                for i in 0..*order {
                    values[i].0 = p[1].store();
                    slopes[i].0 = divided(slope[1], *half).store();
                    let (n, odd) = (W::splat((i + 1) as f32), W::splat(2.0 * (i + 1) as f32 + 1.0));
                    p = [p[1], divided(odd * z * p[1] - n * p[0], (i + 1) as f32 + 1.0)];
                    slope = [slope[1], slope[0] + odd * p[0]];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_match_numerical_ones() {
        let bases = [
            Basis::Kernels(KernelRow::new(8, -3.0, 3.0, 0.9)),
            Basis::Waves(3),
            Basis::Polynomials { order: 4, centre: 0.5, half: 2.0 },
        ];
        for basis in bases {
            let n = basis.len();
            for x in [-2.5, -0.7, 0.1, 1.9] {
                let [mut low, mut high, mut at, mut slopes, mut none] = [(); 5].map(|()| vec![0.0; n]);
                basis.eval(x - 1e-2, &mut low, &mut none);
                basis.eval(x + 1e-2, &mut high, &mut none);
                basis.eval(x, &mut at, &mut slopes);
                for i in 0..n {
                    let numerical = (high[i] - low[i]) / 2e-2;
                    assert!((slopes[i] - numerical).abs() < 2e-3, "{basis:?} {i} at {x}: {} {numerical}", slopes[i]);
                }
            }
        }
    }

    #[test]
    fn the_exponential_is_accurate() {
        for y in [0.0, 0.3, 1.5, 20.0, 42.0_f32] {
            assert!((exp2_negative(y, MAX_EXPONENT) / (-y).exp2() - 1.0).abs() < 1e-6);
        }
    }
}
