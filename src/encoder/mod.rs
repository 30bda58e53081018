//! Topographic maps: from inputs to features (paper section 3.3).

mod exponential;
mod features;
mod kernel;
pub mod naive;
mod plan;
mod scalar;

pub use features::Features;
use plan::Plan;

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
    plan: Plan,
    /// Every line's activations, between the two passes; here so that a call allocates nothing.
    lines: Features,
    /// Every group's sums of squares, by lanes.
    squares: Features,
}

impl Encoder {
    /// An encoder for `maps`, concatenated in this order; with `normalise`, features have unit Euclidean norm.
    pub fn new(maps: &[Map], normalise: bool) -> Self {
        let plan = Plan::new(maps, normalise);
        let lines = plan.centres.clone();
        let squares = Features::zeroed(plan.groups.len() * features::LANES);
        Self { plan, lines, squares }
    }

    /// Number of true features, without pads.
    pub fn units(&self) -> usize {
        self.plan.shapes.iter().map(|shape| shape.rows() * shape.fast.units).sum()
    }

    /// Length of the features in memory, pads included.
    #[allow(clippy::len_without_is_empty)]
    pub fn len(&self) -> usize {
        self.plan.len
    }

    /// Where the true features stand in the padded layout, in the true feature order.
    pub fn order(&self) -> impl Iterator<Item = usize> + '_ {
        self.plan.shapes.iter().flat_map(|shape| {
            let stride = shape.stride();
            (0..shape.rows()).flat_map(move |row| (0..shape.fast.units).map(move |i| shape.start + row * stride + i))
        })
    }

    /// Memory for the features of one tick, all 0.
    pub fn features(&self) -> Features {
        Features::zeroed(self.plan.len)
    }

    /// Encodes.
    pub fn encode(&mut self, inputs: &[f32], out: &mut Features) {
        assert_eq!(out.len(), self.plan.len, "features of another encoder");
        kernel::encode(&self.plan, inputs, &mut self.lines, &mut self.squares, out);
    }

    /// Encodes with the scalar twin.
    pub fn encode_scalar(&mut self, inputs: &[f32], out: &mut Features) {
        assert_eq!(out.len(), self.plan.len, "features of another encoder");
        scalar::encode(&self.plan, inputs, &mut self.lines, out);
    }
}
