//! What the models of dynamics and reward look at, and their first scales.

use super::config::InputRange;
use super::layout::{Layout, MOST_TERMS, Places, Priors, Terms};

/// First frequency of an input that may be an angle, for a range of [-1, 1].
const FREQUENCY: f64 = 2.5;

/// How the angles among the inputs are read: which of them (bits) are measured from the body before, as those of joints
/// with parallel axes are. Any other is the direction of a body, or turns about an axis of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AngleReading(u32);

impl AngleReading {
    /// Each angle as it is.
    pub const APART: Self = Self(0);

    /// Every angle that follows another one is measured from it: one chain of joints in a plane.
    pub fn chain(ranges: &[InputRange]) -> Self {
        let known: Vec<bool> = ranges.iter().map(|range| frequency(range).is_some()).collect();
        Self((1..ranges.len()).filter(|&i| known[i - 1] && known[i]).fold(0, |bits, i| bits | 1 << i))
    }

    /// The bits.
    pub fn bits(self) -> u32 {
        self.0
    }

    /// The reading with these bits, as far as `chain` has them.
    pub fn of_bits(bits: u32, chain: Self) -> Self {
        Self(bits & chain.0)
    }

    /// Another reading of input `i`.
    pub fn with_flipped(self, i: usize) -> Self {
        Self(self.0 ^ 1 << i)
    }

    /// The terms of angle `i`: itself, or with the angles right before it, at most [`MOST_TERMS`].
    fn terms(self, ranges: &[InputRange], i: usize) -> Terms {
        let mut terms = [(i, 0.0); MOST_TERMS];
        let mut len = 0;
        for at in (0..=i).rev().take(MOST_TERMS) {
            terms[len] = (at, frequency(&ranges[at]).unwrap_or(0.0));
            len += 1;
            if self.0 >> at & 1 == 0 {
                break;
            }
        }
        Terms::sum(&terms[..len])
    }
}

/// Adds the inputs as angles, with twice the angle where `doubled` is above 0 (as the inertia of linked bodies has it),
/// and then as numbers. Each input is a group of the products. What is known to be an angle is part of products as an
/// angle alone; what may be one, mostly as a number; what is known to be none, as a number alone.
fn inputs(layout: &mut Layout, ranges: &[InputRange], priors: Priors, wrapped: Priors, doubled: f64) {
    for (i, range) in ranges.iter().enumerate().filter(|(_, range)| !range.is_no_angle()) {
        let known = frequency(range);
        let doubtful = Priors { linear: 0.1 * priors.linear, product: 0.1 * priors.product, ..priors };
        match known {
            Some(_) => layout.angle_sum(AngleReading::APART.terms(ranges, i), Some(i), priors),
            None => layout.circle(i, FREQUENCY, true, Some(i), doubtful),
        }
        if let Some(frequency) = known.filter(|_| doubled > 0.0) {
            let of = |x: f64| doubled * x;
            let twice = Priors { linear: of(priors.linear), square: 0.0, product: of(priors.product), smooth: 0.0 };
            layout.circle(i, 2.0 * frequency, false, Some(i), twice);
        }
    }
    for (i, range) in ranges.iter().enumerate() {
        let known_angle = range.radians.is_some() && !range.is_no_angle();
        let number = Priors { product: if known_angle { 0.0 } else { priors.product }, ..priors };
        layout.number(i, Some(i), if range.wraps { wrapped } else { number });
    }
}

/// The frequency of an input that is known to be an angle, for a range of [-1, 1].
fn frequency(range: &InputRange) -> Option<f64> {
    let known = range.radians.filter(|_| !range.is_no_angle()).map(|radians| radians * 0.5 * (range.max - range.min));
    if range.wraps { Some(std::f64::consts::PI) } else { known }
}

/// Dynamics: everything but the angle of an input that comes round, which jumps.
pub fn dynamics_layout(places: Places, ranges: &[InputRange]) -> Layout {
    let (n, m) = (places.inputs, places.commands);
    let mut layout = Layout::new(places.len(), [1.0, 0.01, 0.01, 0.01, 0.03, 1e-4]);
    let priors = Priors { linear: 0.3, square: 0.0, product: 0.1, smooth: 0.3 };
    inputs(&mut layout, ranges, priors, Priors::default(), 0.1);
    for i in 0..n {
        layout.number(places.change(i), None, Priors { product: 0.0, ..priors });
    }
    for j in 0..m {
        let priors = Priors { linear: 3.0, square: 0.0, product: 0.1, smooth: 0.1 };
        layout.number(places.command(j, 0), Some(n + j), priors);
    }
    for ago in 1..=2 {
        for j in 0..m {
            let priors = Priors { linear: 0.3, square: 0.0, product: 0.0, smooth: 0.003 };
            layout.number(places.command(j, ago), None, priors);
        }
    }
    layout
}

/// Has a layout of rewards read angles in another way.
pub fn read_angles(layout: &mut Layout, ranges: &[InputRange], reading: AngleReading) {
    for unit in &mut layout.units[..layout.circles] {
        if frequency(&ranges[unit.at]).is_some() {
            unit.terms = reading.terms(ranges, unit.at);
        }
    }
}

/// Inputs that follow from others: inputs alone.
pub fn dependent_layout(places: Places, ranges: &[InputRange]) -> Layout {
    let mut layout = Layout::new(places.len(), [1.0, 0.3, 0.3, 0.3, 0.1, 1e-4]);
    let priors = Priors { linear: 0.3, square: 0.3, product: 0.3, smooth: 0.3 };
    inputs(&mut layout, ranges, priors, Priors::default(), 0.0);
    layout
}

/// Rewards: inputs, changes and commands of one tick. Angles are read apart from each other; see [`read_angles`].
pub fn reward_layout(places: Places, ranges: &[InputRange]) -> Layout {
    let (n, m) = (places.inputs, places.commands);
    let mut layout = Layout::new(places.len(), [1.0, 0.3, 0.3, 0.3, 0.3, 1e-4]);
    let priors = Priors { linear: 0.3, square: 0.3, product: 0.3, smooth: 0.3 };
    let wrapped = Priors { linear: 0.1, square: 0.1, product: 0.0, smooth: 0.0 };
    inputs(&mut layout, ranges, priors, wrapped, 0.0);
    for i in 0..n {
        layout.number(places.change(i), None, Priors { product: 0.0, ..priors });
    }
    for j in 0..m {
        let priors = Priors { linear: 0.1, square: 0.1, product: 0.0, smooth: 0.1 };
        layout.number(places.command(j, 0), None, priors);
    }
    layout
}
