//! Topographic maps: from inputs to features (paper section 3.3).
//!
//! A controller does not act on raw inputs. Every input, or pair of inputs, is laid out on a map of units with
//! Gaussian kernels, `exp(-(x - centre)^2 / (2 radius^2))`, and the activations of all maps, concatenated, are the
//! features that policy and learner see. An [`Encoder`] is built once from [`Map`]s and then fills [`Features`] tick
//! after tick, knowing neither clock nor file nor transport, and allocating nothing.
//!
//! An encoder may also pass inputs through as they are, *scalars*, behind the maps' features and never normalised: the
//! paper's "scalar" eye, with which it compares topographic coding (section 4.1), has no maps at all.
//!
//! # Layout
//!
//! Features lie in memory map after map; in a plane the first axis is slow. Every row along the fast axis is padded
//! to a multiple of 4 with features that are always exactly 0, so weights and traces laid out alike need no special
//! case. [`Encoder::positions`] leads from the true order, without pads, to places in memory.
//!
//! # Accuracy
//!
//! Against the same formula in double precision at the same `f32` inputs, a feature's absolute error is made of
//!
//! - the rounding of scaled input and scaled centre, half a unit in the last place each. In units of `1.18 radius`
//!   both are up to `r = 0.85 max|x| / radius`, and a kernel's steepest slope is 0.72 there, so this part is at most
//!   `0.72 r 2^-23`, and grows in proportion to range over radius: 4.6e-7 for the arm's angles (`r = 5.3`);
//! - the polynomial (9.5e-8), the rounding of the exponent (2e-7 where a feature is 0.4, less elsewhere) and of the
//!   operations after it, a few 1e-8 of the feature;
//! - when normalised, the rounding of the norm, another few 1e-8 of the feature, which by then is a good deal below 1.
//!
//! The arm's and the eye's features stay within 1e-6 by these bounds; tests see at most 4e-7. The first part is of the
//! size of what rounding an input to `f32` has done before, so a sharper kernel than `f32` inputs can feed is the only
//! one to suffer.
//!
//! No activation of a line falls below exp(-30), and so no feature of a plane below exp(-60), before normalising: far
//! from an input the exact value is smaller still, but subnormal numbers would cost the learner's loop up to twice its
//! time.
//!
//! # Two implementations
//!
//! [`Encoder::encode`] runs as many lanes at a time as the machine has ([`SimdPath`]); [`Encoder::encode_scalar`] is its twin in
//! plain `f32`, equal bit for bit on every path. [`naive`] holds plain baselines.

#![warn(missing_docs)]

mod exponential;
mod features;
mod kernel;
pub mod naive;
mod scalar;
pub mod simd;
mod tables;

use features::BLOCK;
pub use features::Features;
use tables::EncoderTables;

pub use simd::SimdPath;

/// One axis of a map: `units` Gaussian kernels, uniformly spaced from `min` to `max`, reading input number `input`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axis {
    /// Index of the input that the axis encodes.
    pub input: usize,
    /// Number of units along the axis; at least 2.
    pub units: usize,
    /// Centre of the first unit, in the input's unit.
    pub min: f64,
    /// Centre of the last unit, in the input's unit.
    pub max: f64,
    /// Radius (standard deviation) of the kernels, in the input's unit.
    pub radius: f64,
}

/// A topographic map over one or two inputs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Map {
    /// One axis.
    Line(Axis),
    /// The outer product of two axes; the first is the slow one in the feature order.
    Plane(Axis, Axis),
}

/// Encodes inputs into features.
#[derive(Debug, Clone)]
pub struct Encoder {
    plan: EncoderTables,
    /// Activations of all lines, between the passes; here so that a call allocates nothing.
    lines: Features,
    /// Inputs that are features themselves, behind the maps'.
    scalars: Vec<usize>,
    path: SimdPath,
}

impl Encoder {
    /// An encoder for `maps`, concatenated in this order; with `normalise`, features are scaled to unit Euclidean
    /// norm.
    ///
    /// The maps are taken as validated: finite numbers, at least 2 units, `radius > 0`, `max > min`.
    pub fn new(maps: &[Map], normalise: bool) -> Self {
        let plan = EncoderTables::new(maps, normalise);
        let lines = plan.centres.clone();
        Self { plan, lines, scalars: Vec::new(), path: SimdPath::best() }
    }

    /// The same encoder with the inputs of these numbers as further features, as they are.
    pub fn with_scalars(mut self, inputs: &[usize]) -> Self {
        self.scalars = inputs.to_vec();
        self
    }

    /// The same encoder on another path than the machine's best: the same features, bit for bit.
    pub fn on(self, path: SimdPath) -> Self {
        Self { path, ..self }
    }

    /// Number of true features, without pads.
    pub fn units(&self) -> usize {
        self.plan.places.iter().map(|place| place.rows * place.units).sum::<usize>() + self.scalars.len()
    }

    /// Length of the features in memory, pads included; a multiple of 4.
    pub fn len(&self) -> usize {
        self.plan.len + self.scalars.len().next_multiple_of(BLOCK)
    }

    /// Whether there are no features at all, for want of maps and scalars.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Place in memory of one unit: of map number `map`, `slow` along the first axis of a plane (0 for a line), `fast`
    /// along the last axis.
    ///
    /// # Panics
    ///
    /// If there is no such unit.
    pub fn index(&self, map: usize, slow: usize, fast: usize) -> usize {
        let place = &self.plan.places[map];
        assert!(slow < place.rows && fast < place.units, "no unit ({slow}, {fast}) in map {map}");
        place.start + slow * place.stride() + fast
    }

    /// Places in memory of all units, in the true order of the features: what leads from padded to plain and back.
    pub fn positions(&self) -> impl Iterator<Item = usize> + '_ {
        let maps = self.plan.places.iter().flat_map(|place| {
            (0..place.rows)
                .flat_map(move |row| (0..place.units).map(move |unit| place.start + row * place.stride() + unit))
        });
        maps.chain(self.plan.len..self.plan.len + self.scalars.len())
    }

    /// Memory for the features of one tick, all 0.
    pub fn features(&self) -> Features {
        Features::zeroed(self.len())
    }

    /// Encodes `inputs`, as the maps' axes number them, into `out`. All of it is written, pads (with 0) included.
    ///
    /// Inputs are to be finite; however large, they only push all units to the floor. A NaN does the same.
    ///
    /// # Panics
    ///
    /// If an axis reads an input that is not there, or `out` was made for an encoder of another length.
    pub fn encode(&mut self, inputs: &[f32], out: &mut Features) {
        assert_eq!(out.len(), self.len(), "the features were made for another encoder");
        let (plan, lines) = (&self.plan, &mut self.lines);
        self.path.run(kernel::Encode { plan, inputs, lines, out });
        self.pass_through(inputs, out);
    }

    /// Encodes with the scalar twin: the same features, bit for bit, and several times slower.
    ///
    /// # Panics
    ///
    /// As [`encode`](Self::encode).
    pub fn encode_scalar(&mut self, inputs: &[f32], out: &mut Features) {
        assert_eq!(out.len(), self.len(), "the features were made for another encoder");
        scalar::encode(&self.plan, inputs, &mut self.lines, out);
        self.pass_through(inputs, out);
    }

    /// Writes the scalars and their pads.
    fn pass_through(&self, inputs: &[f32], out: &mut Features) {
        let (scalars, pads) = out.as_mut_slice()[self.plan.len..].split_at_mut(self.scalars.len());
        for (out, &input) in scalars.iter_mut().zip(&self.scalars) {
            *out = inputs[input];
        }
        pads.fill(0.0);
    }
}

#[cfg(test)]
mod tests;
