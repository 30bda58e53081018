//! Topographic maps: from inputs to features (paper section 3.3).

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
