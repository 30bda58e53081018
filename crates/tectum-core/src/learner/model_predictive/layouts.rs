//! What the models of dynamics and reward look at, and their first scales.

use super::config::InputRange;
use super::layout::{Layout, Places, Priors};

/// First frequency of an input that may be an angle, for a range of [-1, 1].
const FREQUENCY: f64 = 2.5;

/// Adds the inputs as angles, with twice the angle where `doubled` is above 0 (as the inertia of linked bodies has it),
/// and then as numbers. Each input is a group of the products. What is known to be an angle is part of products as an
/// angle alone; what may be one, mostly as a number.
fn inputs(layout: &mut Layout, ranges: &[InputRange], priors: Priors, wrapped: Priors, doubled: f64) {
    for (i, range) in ranges.iter().enumerate() {
        let known = range.radians.map(|radians| radians * 0.5 * (range.max - range.min));
        let known = if range.wraps { Some(std::f64::consts::PI) } else { known };
        let doubtful = Priors { linear: 0.1 * priors.linear, product: 0.1 * priors.product, ..priors };
        let own = if known.is_some() { priors } else { doubtful };
        layout.circle(i, known.unwrap_or(FREQUENCY), known.is_none(), Some(i), own);
        if let Some(frequency) = known.filter(|_| doubled > 0.0) {
            let of = |x: f64| doubled * x;
            let twice = Priors { linear: of(own.linear), square: 0.0, product: of(own.product), smooth: 0.0 };
            layout.circle(i, 2.0 * frequency, false, Some(i), twice);
        }
    }
    for (i, range) in ranges.iter().enumerate() {
        let number = Priors { product: if range.radians.is_some() { 0.0 } else { priors.product }, ..priors };
        layout.number(i, Some(i), if range.wraps { wrapped } else { number });
    }
}

/// Dynamics: everything but the angle of an input that comes round, which jumps.
pub fn dynamics_layout(places: Places, ranges: &[InputRange]) -> Layout {
    let (n, m) = (places.inputs, places.commands);
    let mut layout = Layout::new(places.len(), [1.0, 0.01, 0.03, 1e-4]);
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

/// Rewards: inputs, changes and commands of one tick.
pub fn reward_layout(places: Places, ranges: &[InputRange]) -> Layout {
    let (n, m) = (places.inputs, places.commands);
    let mut layout = Layout::new(places.len(), [1.0, 0.3, 0.3, 1e-4]);
    let priors = Priors { linear: 0.3, square: 0.3, product: 0.3, smooth: 0.3 };
    inputs(&mut layout, ranges, priors, Priors { linear: 0.1, square: 0.1, product: 0.0, smooth: 0.0 }, 0.0);
    for i in 0..n {
        layout.number(places.change(i), None, Priors { product: 0.0, ..priors });
    }
    for j in 0..m {
        let priors = Priors { linear: 0.1, square: 0.1, product: 0.0, smooth: 0.1 };
        layout.number(places.command(j, 0), None, priors);
    }
    layout
}
