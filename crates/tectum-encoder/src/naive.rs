//! Plain baselines for benches and tests: straightforward implementations against which the kernel's speed and
//! error are measured. A run does not use them.
//!
//! [`reference`](fn@reference) is the definition in double precision. [`NaiveEncoder`] is the first obvious
//! implementation: one standard `exp` per feature and a second pass for the norm. [`SeparableEncoder`] is the next
//! obvious one: one `exp` per unit of a line. All use the true order of the features, without padding.

use super::{Axis, Map};

/// Centres of the units of an axis.
fn centres(axis: &Axis) -> impl Iterator<Item = f64> + '_ {
    let spacing = (axis.max - axis.min) / (axis.units - 1) as f64;
    (0..axis.units).map(move |unit| axis.min + spacing * unit as f64)
}

/// The features in double precision, by the paper's definition.
pub fn reference(maps: &[Map], inputs: &[f64], normalise: bool) -> Vec<f64> {
    let line = |axis: &Axis| -> Vec<f64> {
        centres(axis).map(|c| (-(inputs[axis.input] - c).powi(2) / (2.0 * axis.radius * axis.radius)).exp()).collect()
    };
    let mut features = Vec::new();
    for map in maps {
        match map {
            Map::Line(axis) => features.extend(line(axis)),
            Map::Plane(slow, fast) => {
                let fast = line(fast);
                features.extend(line(slow).iter().flat_map(|s| fast.iter().map(move |f| s * f)));
            }
        }
    }
    if normalise {
        let norm = features.iter().map(|g| g * g).sum::<f64>().sqrt();
        features.iter_mut().for_each(|g| *g /= norm);
    }
    features
}

/// An axis in single precision: input, centres, and `-1 / (2 radius^2)`.
#[derive(Debug, Clone)]
struct AxisUnits {
    input: usize,
    centres: Vec<f32>,
    factor: f32,
}

impl AxisUnits {
    fn new(axis: &Axis) -> Self {
        let factor = -1.0 / (2.0 * axis.radius * axis.radius);
        Self { input: axis.input, centres: centres(axis).map(|c| c as f32).collect(), factor: factor as f32 }
    }

    /// Exponents of the activations of all units.
    fn exponents(&self, inputs: &[f32]) -> impl Iterator<Item = f32> + '_ {
        let x = inputs[self.input];
        self.centres.iter().map(move |c| (x - c) * (x - c) * self.factor)
    }
}

/// The axes of every map; the second one is the fast axis of a plane.
fn units(maps: &[Map]) -> Vec<(AxisUnits, Option<AxisUnits>)> {
    let units = |map: &Map| match map {
        Map::Line(axis) => (AxisUnits::new(axis), None),
        Map::Plane(slow, fast) => (AxisUnits::new(slow), Some(AxisUnits::new(fast))),
    };
    maps.iter().map(units).collect()
}

/// Scales to unit Euclidean norm.
fn to_unit_norm(features: &mut [f32]) {
    let norm = features.iter().map(|g| g * g).sum::<f32>().sqrt();
    features.iter_mut().for_each(|g| *g /= norm);
}

/// The textbook encoder: one standard `exp` per feature.
#[derive(Debug, Clone)]
pub struct NaiveEncoder {
    maps: Vec<(AxisUnits, Option<AxisUnits>)>,
    normalise: bool,
}

impl NaiveEncoder {
    /// An encoder for `maps`.
    pub fn new(maps: &[Map], normalise: bool) -> Self {
        Self { maps: units(maps), normalise }
    }

    /// Encodes `inputs` into `out`, which has one element per feature.
    pub fn encode(&self, inputs: &[f32], out: &mut [f32]) {
        let mut rest = out.iter_mut();
        for (first, second) in &self.maps {
            match second {
                None => first.exponents(inputs).zip(&mut rest).for_each(|(e, out)| *out = e.exp()),
                Some(fast) => {
                    for slow in first.exponents(inputs) {
                        fast.exponents(inputs).zip(&mut rest).for_each(|(e, out)| *out = (slow + e).exp());
                    }
                }
            }
        }
        if self.normalise {
            to_unit_norm(out);
        }
    }
}

/// An encoder that computes a plane as the outer product of two lines: one standard `exp` per unit of a line.
#[derive(Debug, Clone)]
pub struct SeparableEncoder {
    maps: Vec<(AxisUnits, Option<AxisUnits>)>,
    line: Vec<f32>,
    normalise: bool,
}

impl SeparableEncoder {
    /// An encoder for `maps`.
    pub fn new(maps: &[Map], normalise: bool) -> Self {
        let maps = units(maps);
        let longest = maps.iter().filter_map(|(_, fast)| fast.as_ref().map(|fast| fast.centres.len())).max();
        Self { maps, line: vec![0.0; longest.unwrap_or(0)], normalise }
    }

    /// Encodes `inputs` into `out`, which has one element per feature.
    pub fn encode(&mut self, inputs: &[f32], out: &mut [f32]) {
        let mut rest = &mut *out;
        for (first, second) in &self.maps {
            let stride = second.as_ref().map_or(1, |fast| fast.centres.len());
            let (here, after) = rest.split_at_mut(first.centres.len() * stride);
            rest = after;
            match second {
                None => first.exponents(inputs).zip(here).for_each(|(e, out)| *out = e.exp()),
                Some(fast) => {
                    let line = &mut self.line[..stride];
                    fast.exponents(inputs).zip(&mut *line).for_each(|(e, out)| *out = e.exp());
                    for (e, row) in first.exponents(inputs).zip(here.chunks_exact_mut(stride)) {
                        let slow = e.exp();
                        row.iter_mut().zip(&*line).for_each(|(out, fast)| *out = slow * fast);
                    }
                }
            }
        }
        if self.normalise {
            to_unit_norm(out);
        }
    }
}
