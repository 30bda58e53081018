//! Checks of a plant in this process, without transport: what every run relies on.

use tectum::plant::Plant;
use tectum::scenario::Plan;
use tectum::state::{load, save, size};
use tectum::wire::Observation;

use tectum::runtime::PlantSide;

/// Requires of a plant what a run, its restarts and its replay rely on. It is run behind the gate of `plan`, with
/// commands that swing through their whole range, for `ticks` ticks:
///
/// - inputs and rewards are finite;
/// - every input stays within the range that the scenario states;
/// - a plant that is built again gives the same inputs and rewards, bit for bit;
/// - so does one that is built in the middle, with the state that the first had listed ([`Persist`]). A number that
///   the list lacks shows here, and not when a process is killed for the first time.
///
/// [`Persist`]: tectum::state::Persist
///
/// ```
/// use tectum::plant::{Outcome, Plant};
/// use tectum::state::{Persist, StateVisitor};
/// use tectum_testkit::{ScenarioFile, check_plant};
///
/// /// A point on a line that is to be at 0.
/// struct Point {
///     position: f32,
/// }
///
/// impl Persist for Point {
///     fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
///         visitor.number("position", &mut self.position);
///     }
/// }
///
/// impl Plant for Point {
///     fn sense(&mut self, _tick: u64, inputs: &mut [f32]) -> bool {
///         inputs[0] = self.position;
///         false
///     }
///
///     fn advance(&mut self, _tick: u64, applied: &[f32]) -> Outcome {
///         self.position = (self.position + 0.1 * applied[0]).clamp(-1.0, 1.0);
///         Outcome { reward: -self.position.abs(), ..Outcome::default() }
///     }
/// }
///
/// let scenario = r#"
///     name = "point"
///     ticks = 1000
///     plant.program = "point"
///     plant.inputs = [{ name = "position", unit = "m", min = -1.0, max = 1.0 }]
///     plant.outputs = [{ name = "speed", unit = "0.1 m a tick", min = -1.0, max = 1.0 }]
///     encoder.maps = [{ inputs = ["position"], radius = 0.2 }]
///     policy.sigma = 0.2
///     gate.max_command = 1.0
/// "#;
/// check_plant(&ScenarioFile::from_text(scenario).plan(), 1000, || Point { position: 0.5 });
/// ```
///
/// # Panics
///
/// With tick and name of the first value that is wrong.
#[track_caller]
pub fn check_plant<P: Plant>(plan: &Plan, ticks: u64, mut plant: impl FnMut() -> P) {
    let mut first = PlantSide::new(plant(), plan);
    let mut again = PlantSide::new(plant(), plan);
    let mut restored = PlantSide::new(plant(), plan);
    let (mut seen, mut other) = (Observation::default(), Observation::default());
    for tick in 0..ticks {
        if tick == ticks / 2 {
            let mut state = vec![0; size(&mut first)];
            save(&mut first, &mut state);
            restored = PlantSide::new(plant(), plan);
            assert!(load(&mut restored, &state), "a plant that is built again lists another number of values");
        }
        first.observe(tick, 0, 0, &mut seen);
        check_values(plan, &seen);
        again.observe(tick, 0, 0, &mut other);
        check_equal(plan, &seen, &other, "a plant that is built again");
        if tick >= ticks / 2 {
            restored.observe(tick, 0, 0, &mut other);
            check_equal(plan, &seen, &other, "a plant with restored state (does visit_state list all of it?)");
        }
        let command = command(plan, tick);
        for side in [&mut first, &mut again, &mut restored] {
            side.step(tick, Some(&command));
        }
    }
}

/// A command that swings through the whole range of every output, each with a period of its own.
fn command(plan: &Plan, tick: u64) -> tectum::wire::Command {
    let mut command = tectum::wire::Command::default();
    command.header.tick = tick;
    for (i, value) in command.drawn.iter_mut().take(plan.outputs.len()).enumerate() {
        let turns = tick as f64 / (41.0 + 12.0 * i as f64);
        let most = plan.scenario.gate.max_command.of(i);
        *value = (most * (std::f64::consts::TAU * turns).sin()) as f32;
    }
    command
}

#[track_caller]
fn check_values(plan: &Plan, seen: &Observation) {
    let tick = seen.header.tick;
    assert!(seen.reward.is_finite(), "the reward before tick {tick} is {}", seen.reward);
    for (input, value) in plan.inputs.iter().zip(seen.inputs) {
        let (name, min, max) = (&input.name, input.min, input.max);
        assert!(value.is_finite(), "input {name} at tick {tick} is {value}");
        // The ends of a range are double precision, the inputs are not.
        let inside = value >= min as f32 && value <= max as f32;
        assert!(inside, "input {name} at tick {tick} is {value}; the scenario states {min} to {max}");
    }
}

#[track_caller]
fn check_equal(plan: &Plan, seen: &Observation, other: &Observation, who: &str) {
    let tick = seen.header.tick;
    let same = |a: f32, b: f32| a.to_bits() == b.to_bits();
    for (i, input) in plan.inputs.iter().enumerate() {
        let (a, b) = (seen.inputs[i], other.inputs[i]);
        assert!(same(a, b), "{who} differs at tick {tick}: input {} is {b} instead of {a}", input.name);
    }
    let (a, b) = (seen.reward, other.reward);
    assert!(same(a, b), "{who} differs at tick {tick}: the reward is {b} instead of {a}");
}
