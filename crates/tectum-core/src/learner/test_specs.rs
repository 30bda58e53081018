//! A learner specification for this crate's tests: the paper's arm, with the values of `scenarios/arm.toml`.

use std::f64::consts::PI;

use tectum_encoder::{Axis, Map};

use super::{LearnerConfig, LearnerSpec};
use crate::{MAX_OUTPUTS, SignalConfig};

/// Two target coordinates and four joint angles, on a plane and four lines of sixteen units.
pub(crate) fn arm() -> LearnerSpec {
    let signal = |name: &str, unit: &str, range: f64| SignalConfig {
        name: name.to_owned(),
        unit: unit.to_owned(),
        min: -range,
        max: range,
        wraps: None,
    };
    let mut inputs = vec![signal("target_x", "m", 1.0), signal("target_y", "m", 1.0)];
    inputs.extend((1..=4).map(|joint| signal(&format!("theta_{joint}"), "rad", PI)));
    let axis = |input: usize, range: f64| Axis { input, units: 16, min: -range, max: range, radius: 0.5 };
    let mut maps = vec![Map::Plane(axis(0, 1.0), axis(1, 1.0))];
    maps.extend((2..6).map(|input| Map::Line(axis(input, PI))));
    LearnerSpec {
        moved: (1..=4).map(|joint| format!("theta_{joint}")).collect(),
        inputs,
        outputs: 4,
        maps,
        normalise: true,
        sigma: 0.003,
        max_command: [0.05; MAX_OUTPUTS],
        max_step: [f32::INFINITY; MAX_OUTPUTS],
        seed: 1,
        learner: LearnerConfig::default(),
    }
}
