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

/// The mean reward of iLQR on the test, by arm: without a change, and after `block`, `shorten`, `mirror` and `payload`.
/// The test after a change has other targets. What iLQR reaches does not depend on a lag of up to 200 ms by more than 3
/// %.
const ILQR: [(&str, [f64; 5]); 4] = [
    ("arm", [-0.0231, -0.0381, -0.0319, -0.0322, -0.0322]),
    ("arm-relative", [-0.0107, -0.0151, -0.0123, -0.0123, -0.0123]),
    ("arm-stops", [-0.0280, -0.0644, -0.0521, -0.0448, -0.0448]),
    ("arm-relative-stops", [-0.0107, -0.0151, -0.0123, -0.0123, -0.0123]),
];
/// Mean cost of a tick's delay until a new target is seen: a tenth of the squared distance, 1.6 m^2, over 80 ticks.
const SEEN_LATE: f64 = 0.002;

/// The level of `task`, or of its changed plant.
pub(super) fn level(task: &Task, changed: bool) -> Level {
    let reward = |reward, unit, reason| Level { reward: Some(reward), end: None, unit, reason };
    match task.name.as_str() {
        "so101" => Level { reward: None, end: Some(0.03), unit: "m", reason: "3 cm: as a hand of this size needs it" },
        "pendulum" => reward(-2.0, "rad", "-400 per episode; iLQR reaches -348, energy swing-up -372"),
        "pendulum-random" => reward(-1.1, "rad", "-220 per episode from the test's starts; iLQR reaches -196"),
        "cart-pole" => reward(0.85, "rad", "swung up within two seconds, and balanced; iLQR reaches 0.885"),
        "reacher" => reward(-0.11, "m", "-5.5 per episode on the test's targets; iLQR reaches -5.0"),
        "furuta" => reward(0.85, "rad", "swung up within two seconds, and balanced; iLQR reaches 0.95"),
        "point-mass" => reward(-0.16, "m", "within 20 % of iLQR, -0.134"),
        _ => of_arm(task, changed),
    }
}

/// Within 10 % of iLQR for the paper's arm, within 20 % for the others and after a change.
fn of_arm(task: &Task, changed: bool) -> Level {
    let (arm, by_change) = ILQR
        .iter()
        .rev()
        .find(|(arm, _)| task.name.starts_with(arm))
        .map_or(("", ILQR[0].1), |(arm, all)| (*arm, *all));
    let changes = ["block", "shorten", "mirror", "payload"];
    let change = changes.iter().position(|change| changed && task.name.ends_with(change)).map_or(0, |i| i + 1);
    let is_papers = arm == "arm" && change == 0;
    let reference = by_change[change] * if is_papers { 1.1 } else { 1.2 };
    let delay = (task.timing.delay + task.timing.picture_delay) as f64;
    let reward = ((reference - SEEN_LATE * delay) * 1e4).round() / 1e4;
    let reason = match (is_papers, delay > 0.0) {
        (true, false) => "within 10 % of iLQR on the true model",
        (false, false) => "within 20 % of iLQR on the true model",
        (true, true) => "within 10 % of iLQR on the true model, and what a target costs that is seen late",
        (false, true) => "within 20 % of iLQR on the true model, and what a target costs that is seen late",
    };
    Level { reward: Some(reward), end: None, unit: "m", reason }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_task_has_a_level_with_a_reason() {
        for name in crate::plant::task::names() {
            let task = Task::named(&name).unwrap();
            for changed in [false, true] {
                let level = level(&task, changed);
                assert!(level.reward.is_some() != level.end.is_some() && !level.reason.is_empty(), "{name}");
            }
        }
        let of = |name: &str, changed| level(&Task::named(name).unwrap(), changed).reward.unwrap();
        assert_eq!([of("arm", false), of("arm-relative-stops-delay-2", false)], [-0.0254, -0.0168]);
        assert_eq!([of("arm-block", false), of("arm-block", true)], [-0.0254, -0.0457]);
    }
}
