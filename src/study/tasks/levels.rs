//! The level of each task: what counts as learned, in the test without exploration noise, and why that much.

use super::test::TestScore;
use crate::plant::task::Task;

/// A level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Level {
    /// Least mean reward a tick.
    pub reward: Option<f64>,
    /// Largest error at the end of a trial.
    pub end: Option<f64>,
    /// Unit of the error.
    pub unit: &'static str,
    /// Where it comes from.
    pub reason: &'static str,
}

impl Level {
    /// Whether a test reached it. A number that is not finite did not.
    pub fn is_reached(&self, score: TestScore) -> bool {
        self.reward.is_none_or(|least| score.reward >= least) && self.end.is_none_or(|most| score.end <= most)
    }

    /// The level as text.
    pub fn words(&self) -> String {
        match (self.reward, self.end) {
            (Some(reward), _) => format!("reward {reward}"),
            (None, Some(end)) => format!("end {end} {}", self.unit),
            (None, None) => "none".to_owned(),
        }
    }
}

/// The level of `task`, or of its changed plant.
pub(super) fn level(task: &Task, _changed: bool) -> Level {
    let name = task.name.as_str();
    let reward = |reward, unit, reason| Level { reward: Some(reward), end: None, unit, reason };
    match name {
        "so101" => Level { reward: None, end: Some(0.03), unit: "m", reason: "end error of 3 cm" },
        "pendulum" => reward(-2.0, "rad", "-400 per 200 ticks"),
        "pendulum-random" => reward(-0.8, "rad", "-160 per 200 ticks"),
        "cart-pole" => reward(0.85, "rad", ""),
        "reacher" => reward(-0.1, "m", "-5 per 50 ticks"),
        "furuta" => reward(0.5, "rad", ""),
        "point-mass" => reward(-0.3, "m", ""),
        _ => reward(-0.035, "m", ""),
    }
}
