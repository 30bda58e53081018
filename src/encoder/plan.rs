//! The encoder's tables: everything about the maps that does not depend on the inputs, worked out once.
//!
//! The kernel and its scalar twin read the same tables, so what is left to differ between them is arithmetic alone.
//! All that can be done in double precision is done here and rounded once.

use super::exponential::{FLOOR, VANISH};
use super::features::{Features, LANES};
use super::{Axis, Map};

/// Blocks that the kernel computes side by side: lines are padded to a multiple of these in the tables (not in the
/// features), so that there is one loop over groups and nothing left over.
pub(super) const GROUP: usize = 4;

/// Units of a group.
pub(super) const GROUP_UNITS: usize = GROUP * LANES;

/// A group of units of one line: what the kernel has to know besides the tables.
#[derive(Debug, Clone)]
pub(super) struct Group {
    /// Index of the input that the line encodes.
    pub input: usize,
    /// `sqrt(log2(e) / 2) / radius`: turns a distance into the root of the (negative) binary exponent.
    pub sharpness: f32,
}

/// One line of units: where it lies in the tables.
#[derive(Debug, Clone)]
pub(super) struct Line {
    /// Units, without pads.
    pub units: usize,
    /// First group.
    pub start: usize,
    /// Groups.
    pub groups: usize,
}

impl Line {
    /// Blocks that hold a unit.
    pub fn blocks(&self) -> usize {
        self.units.div_ceil(LANES)
    }
}

/// One map: a line, or the outer product of a slow and a fast one.
#[derive(Debug, Clone)]
pub(super) struct Shape {
    /// The slow axis; none if the map is a line.
    pub slow: Option<Line>,
    /// The fast axis: the one whose rows lie in memory, padded.
    pub fast: Line,
    /// Position of the map's first feature.
    pub start: usize,
}

impl Shape {
    /// Rows along the slow axis.
    pub fn rows(&self) -> usize {
        self.slow.as_ref().map_or(1, |slow| slow.units)
    }

    /// Padded length of a row.
    pub fn stride(&self) -> usize {
        self.fast.blocks() * LANES
    }
}

/// All maps.
#[derive(Debug, Clone)]
pub(super) struct Plan {
    /// The maps in the order of the features.
    pub shapes: Vec<Shape>,
    /// The groups of all lines, line after line.
    pub groups: Vec<Group>,
    /// Centres of the units, group after group, in the unit of the inputs; infinity in the pads.
    pub centres: Features,
    /// Upper limits of the binary exponents: [`FLOOR`] for a unit, [`VANISH`] for a pad.
    pub floors: Features,
    /// Whether the features are scaled to unit Euclidean norm.
    pub normalise: bool,
    /// Length of the features with the pads.
    pub len: usize,
}

impl Plan {
    /// Works out the tables.
    pub fn new(maps: &[Map], normalise: bool) -> Self {
        let mut groups = Vec::new();
        let (mut centres, mut floors) = (Vec::new(), Vec::new());
        let mut line = |axis: &Axis| {
            debug_assert!(axis.units >= 2 && axis.radius > 0.0 && axis.max > axis.min, "unchecked axis {axis:?}");
            let spacing = (axis.max - axis.min) / (axis.units - 1) as f64;
            centres.extend((0..axis.units).map(|unit| (axis.min + spacing * unit as f64) as f32));
            floors.resize(centres.len(), FLOOR);
            let line = Line { units: axis.units, start: groups.len(), groups: axis.units.div_ceil(GROUP_UNITS) };
            // The limits keep 0 * infinity (NaN) away from a unit that is hit exactly, and from the pads.
            let sharpness = ((std::f64::consts::LOG2_E / 2.0).sqrt() / axis.radius) as f32;
            let sharpness = sharpness.clamp(f32::MIN_POSITIVE, f32::MAX);
            groups.resize(line.start + line.groups, Group { input: axis.input, sharpness });
            centres.resize(groups.len() * GROUP_UNITS, f32::INFINITY);
            floors.resize(centres.len(), VANISH);
            line
        };

        let mut len = 0;
        let mut shapes = Vec::with_capacity(maps.len());
        for map in maps {
            let (slow, fast) = match map {
                Map::Line(axis) => (None, line(axis)),
                Map::Plane(slow, fast) => (Some(line(slow)), line(fast)),
            };
            let shape = Shape { slow, fast, start: len };
            len += shape.rows() * shape.stride();
            shapes.push(shape);
        }
        let (centres, floors) = (Features::from_slice(&centres), Features::from_slice(&floors));
        Self { shapes, groups, centres, floors, normalise, len }
    }
}
