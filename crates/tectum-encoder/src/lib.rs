//! Topographic maps: encode inputs as features (Daucé & Dutech 2010, section 3.3).
//!
//! The policy does not act on raw inputs. Each input, or each pair of inputs, is encoded by a map of units with
//! Gaussian kernels, `exp(-(x - centre)^2 / (2 radius^2))`. The activations of all maps, concatenated, are the
//! features of policy and learner. An [`Encoder`] is built once from [`Map`]s and then fills [`Features`] every
//! tick. It uses no clock, no files and no transport, and it does not allocate once it is built.
//!
//! ```
//! use tectum_encoder::{Axis, Encoder, Map};
//!
//! // One input between -1 and 1, encoded by five units with centres at -1, -0.5, 0, 0.5 and 1.
//! let axis = Axis { input: 0, units: 5, min: -1.0, max: 1.0, radius: 0.5 };
//! let mut encoder = Encoder::new(&[Map::Line(axis)], false);
//! let mut features = encoder.features();
//! encoder.encode(&[0.5], &mut features);
//!
//! // The unit whose centre equals the input is fully active; its neighbour is one radius away.
//! let feature = |unit: usize| features.as_slice()[encoder.index(0, 0, unit)];
//! assert_eq!(feature(3), 1.0);
//! assert!((feature(4) - (-0.5_f32).exp()).abs() < 1e-6);
//! ```
//!
//! An encoder can also pass inputs through unchanged. These *scalars* follow the features of the maps and are
//! never normalised. The paper compares topographic coding with a "scalar" eye (section 4.1), which has scalars
//! and no maps.
//!
//! # Layout
//!
//! Features are stored map after map; in a plane the first axis is the slow one. Every row along the fast axis
//! is padded to a multiple of 4 with features that are always exactly 0, so weights and traces with the same
//! layout need no special case. [`Encoder::positions`] maps the true order, without padding, to positions in
//! memory.
//!
//! # Accuracy
//!
//! The absolute error of a feature, compared with the same formula in double precision at the same `f32`
//! inputs, is the sum of
//!
//! - the rounding of scaled input and scaled centre, half a unit in the last place each. In units of `1.18
//!   radius` both are at most `r = 0.85 max|x| / radius`, and the steepest slope of a kernel is 0.72 there.
//!   This part is therefore at most `0.72 r 2^-23`, proportional to range over radius: 4.6e-7 for the arm's
//!   angles (`r = 5.3`);
//! - the error of the polynomial (9.5e-8), the rounding of the exponent (2e-7 where a feature is 0.4, less
//!   elsewhere) and of the operations after it, a few 1e-8 of the feature;
//! - with normalisation, the rounding of the norm, another few 1e-8 of the feature, which is then well below 1.
//!
//! By these bounds the features of arm and eye are within 1e-6; tests find at most 4e-7. The first part is as
//! large as the effect of rounding an input to `f32`, so it matters only for kernels too narrow for `f32`
//! inputs.
//!
//! Before normalisation no activation of a line is below exp(-30), and no feature of a plane below exp(-60).
//! The exact value far from an input is smaller, but subnormal numbers would make the learner's loop take up to
//! twice as long.
//!
//! # Two implementations
//!
//! [`Encoder::encode`] uses the widest vectors of the machine ([`SimdPath`]). [`Encoder::encode_scalar`] does
//! the same operations in plain `f32` and gives the same bits on every path; it is the test oracle. [`naive`]
//! has plain baselines for benches and tests.

#![warn(missing_docs)]

mod exponential;
mod features;
mod held;
mod kernel;
#[doc(hidden)]
pub mod naive;
mod scalar;
pub mod simd;
mod tables;

#[doc(hidden)]
pub use exponential::{exp2_negative, exp2_negative_lanes};
use features::BLOCK;
pub use features::Features;
use held::HeldPlanes;
use tables::EncoderTables;

pub use simd::SimdPath;

/// One axis of a map: `units` Gaussian kernels with centres evenly spaced from `min` to `max`, over input
/// number `input`.
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
    tables: EncoderTables,
    /// The activations of all lines, so that encoding does not allocate.
    lines: Features,
    /// Which of them need not be computed again.
    held: HeldPlanes,
    /// Indices of the inputs that are passed through as features, after those of the maps.
    scalars: Vec<usize>,
    path: SimdPath,
}

impl Encoder {
    /// An encoder for `maps`, concatenated in this order; with `normalise`, features are scaled to unit Euclidean
    /// norm.
    ///
    /// The maps must be valid: finite numbers, at least 2 units, `radius > 0`, `max > min`. This is not checked.
    pub fn new(maps: &[Map], normalise: bool) -> Self {
        let tables = EncoderTables::new(maps, normalise);
        let lines = tables.centres.clone();
        let held = HeldPlanes::new(&tables);
        Self { tables, lines, held, scalars: Vec::new(), path: SimdPath::best() }
    }

    /// The same encoder with the inputs of these indices passed through as further features.
    pub fn with_scalars(mut self, inputs: &[usize]) -> Self {
        self.scalars = inputs.to_vec();
        self
    }

    /// The same encoder with another SIMD path than the machine's fastest: the same features, bit for bit.
    pub fn on(self, path: SimdPath) -> Self {
        Self { path, ..self }
    }

    /// Number of true features, without padding.
    pub fn units(&self) -> usize {
        self.tables.layouts.iter().map(|layout| layout.rows * layout.units).sum::<usize>() + self.scalars.len()
    }

    /// Number of features in memory, including padding; a multiple of 4.
    pub fn len(&self) -> usize {
        self.tables.len + self.scalars.len().next_multiple_of(BLOCK)
    }

    /// Whether there are no features: neither maps nor scalars.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Position in memory of one unit of map number `map`: unit `slow` along the first axis of a plane (0 for a
    /// line), unit `fast` along the last axis.
    ///
    /// # Panics
    ///
    /// If there is no such unit.
    pub fn index(&self, map: usize, slow: usize, fast: usize) -> usize {
        let layout = &self.tables.layouts[map];
        assert!(slow < layout.rows && fast < layout.units, "no unit ({slow}, {fast}) in map {map}");
        layout.start + slow * layout.stride() + fast
    }

    /// Positions in memory of all units, in the true order of the features: converts between padded and plain
    /// order.
    pub fn positions(&self) -> impl Iterator<Item = usize> + '_ {
        let maps = self.tables.layouts.iter().flat_map(|layout| {
            (0..layout.rows)
                .flat_map(move |row| (0..layout.units).map(move |unit| layout.start + row * layout.stride() + unit))
        });
        maps.chain(self.tables.len..self.tables.len + self.scalars.len())
    }

    /// Memory for the features of one tick, all 0.
    pub fn features(&self) -> Features {
        Features::zeroed(self.len())
    }

    /// Encodes `inputs` into `out`. Axes refer to inputs by index. All of `out` is written, including padding
    /// (with 0).
    ///
    /// Inputs should be finite. Very large inputs and NaN give all units their smallest value.
    ///
    /// # Panics
    ///
    /// If an axis refers to an input that does not exist, or `out` was made for an encoder with another number of
    /// features.
    pub fn encode(&mut self, inputs: &[f32], out: &mut Features) {
        assert_eq!(out.len(), self.len(), "the features were made for another encoder");
        let (tables, lines, held) = (&self.tables, &mut self.lines, &mut self.held);
        self.path.run(kernel::Encode { tables, inputs, lines, held, out });
        self.pass_through(inputs, out);
    }

    /// Encodes with the scalar implementation: the same features, bit for bit, several times slower. For tests.
    ///
    /// # Panics
    ///
    /// As [`encode`](Self::encode).
    pub fn encode_scalar(&mut self, inputs: &[f32], out: &mut Features) {
        assert_eq!(out.len(), self.len(), "the features were made for another encoder");
        self.held.forget();
        scalar::encode(&self.tables, inputs, &mut self.lines, out);
        self.pass_through(inputs, out);
    }

    /// Writes the scalars and their padding.
    fn pass_through(&self, inputs: &[f32], out: &mut Features) {
        let (scalars, pads) = out.as_mut_slice()[self.tables.len..].split_at_mut(self.scalars.len());
        for (out, &input) in scalars.iter_mut().zip(&self.scalars) {
            *out = inputs[input];
        }
        pads.fill(0.0);
    }
}

#[cfg(test)]
mod tests;
