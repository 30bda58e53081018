//! The tasks on which learners are measured: a plant with its settings, by name.
//!
//! A task of the arm is one of five arms, and at most one difficulty: `arm-relative-stops-delay-1` is the arm with
//! relative angles and stops, and everything one tick late. The other plants are tasks by themselves.

use super::{
    Angles, ArmConfig, BlockConfig, BodyConfig, CartPoleConfig, FurutaConfig, MirrorAxis, MirrorConfig, PayloadConfig,
    PendulumConfig, PointMassConfig, ReacherConfig, ShortenConfig, SimulatedPlant, So101Config, Start, TimingConfig,
};

/// Tick of the change, in tasks where the arm changes in mid run.
pub const CHANGE_TICK: u64 = 1200;
/// Stops of the arms that have them, rad.
pub const STOPS: [f64; 2] = [-2.0, 2.0];

/// A task.
#[derive(Debug, Clone, PartialEq)]
pub struct Task {
    /// Its name.
    pub name: String,
    /// What it is, in a sentence.
    pub about: String,
    /// Period of a tick, ms.
    pub period_ms: f64,
    /// The plant.
    pub body: BodyConfig,
    /// How late it is.
    pub timing: TimingConfig,
    /// Largest command in magnitude, on every output.
    pub max_command: f64,
    /// Standard deviation of the exploration noise, in units of the command.
    pub sigma: f64,
    /// Usual length of a run, ticks.
    pub ticks: u64,
    /// The tick in which the plant changes, if it does.
    pub change: Option<u64>,
}

/// The arms.
const ARMS: [(&str, &str); 5] = [
    ("arm", "the paper's arm: four joints with absolute angles"),
    ("arm-relative", "the arm with each angle measured from the segment before"),
    ("arm-stops", "the arm with joints that stop at 2 rad"),
    ("arm-relative-stops", "the arm with relative angles and stops at 2 rad"),
    (
        "arm-relative-hidden-stops",
        "the arm with relative angles and stops at 2 rad, of which the inputs' ranges say nothing",
    ),
];

/// The difficulties, each a suffix to the name of an arm.
const DIFFICULTIES: [(&str, &str); 15] = [
    ("delay-1", "inputs and reward come one tick late"),
    ("delay-2", "inputs and reward come two ticks late"),
    ("delay-3", "inputs and reward come three ticks late"),
    ("reward-delay-1", "the reward comes one tick late"),
    ("reward-delay-2", "the reward comes two ticks late"),
    ("reward-delay-3", "the reward comes three ticks late"),
    ("picture-delay-1", "the target is seen one tick late"),
    ("picture-delay-2", "the target is seen two ticks late"),
    ("picture-delay-3", "the target is seen three ticks late"),
    ("lag-100", "joints follow their commands with a time constant of 100 ms"),
    ("lag-200", "joints follow their commands with a time constant of 200 ms"),
    ("block", "joint 3 stands still from tick 1200 on"),
    ("shorten", "segment 2 loses 0.2 m in tick 1200"),
    ("mirror", "the target's x is seen with the opposite sign from tick 1200 on"),
    ("payload", "the end-effector carries 0.1 kg from tick 1200 on"),
];

/// The other tasks.
const OTHERS: [(&str, &str); 7] = [
    ("so101", "the SO-101's five joints, with stops and a lag of 100 ms; targets in three dimensions"),
    ("pendulum", "Pendulum-v1, from hanging at the start of every 200 ticks"),
    ("pendulum-random", "Pendulum-v1 as published: a random start every 200 ticks"),
    ("cart-pole", "dm_control's cart-pole swing-up, from hanging at the start of every 200 ticks of 50 ms"),
    ("reacher", "Reacher-v5: two joints driven by torques, 50 ticks of 20 ms an episode"),
    ("furuta", "a Furuta pendulum, from hanging at the start of every 500 ticks of 20 ms"),
    ("point-mass", "a mass on a plane, pushed towards targets that jump"),
];

/// The tasks that are measured when none is named.
pub const USUAL: [&str; 19] = [
    "arm",
    "arm-relative",
    "arm-stops",
    "arm-relative-stops",
    "arm-relative-hidden-stops",
    "arm-relative-stops-delay-1",
    "arm-relative-stops-delay-2",
    "arm-relative-stops-reward-delay-1",
    "arm-relative-stops-picture-delay-1",
    "arm-relative-stops-lag-100",
    "arm-relative-stops-lag-200",
    "arm-relative-stops-block",
    "so101",
    "pendulum",
    "pendulum-random",
    "cart-pole",
    "reacher",
    "furuta",
    "point-mass",
];

/// The names of all tasks.
pub fn names() -> Vec<String> {
    let mut names = Vec::new();
    for (arm, _) in ARMS {
        names.push(arm.to_owned());
        names.extend(DIFFICULTIES.iter().map(|(difficulty, _)| format!("{arm}-{difficulty}")));
    }
    names.extend(OTHERS.iter().map(|(name, _)| (*name).to_owned()));
    names
}

impl Task {
    /// The task of this name.
    pub fn named(name: &str) -> Option<Self> {
        if let Some((_, about)) = OTHERS.iter().find(|(other, _)| *other == name) {
            return Some(other(name, about));
        }
        ARMS.iter().rev().find_map(|(arm, about)| {
            let rest = name.strip_prefix(arm)?;
            let difficulty = match rest.strip_prefix('-') {
                None if rest.is_empty() => None,
                None => return None,
                Some(suffix) => Some(*DIFFICULTIES.iter().find(|(difficulty, _)| *difficulty == suffix)?),
            };
            Some(of_arm(name, arm, about, difficulty))
        })
    }

    /// The plant of a run with `seed`.
    pub fn plant(&self, seed: u64) -> SimulatedPlant {
        SimulatedPlant::new(&self.body, &self.timing, self.period_ms / 1000.0, seed)
    }
}

/// The task of an arm with a difficulty.
fn of_arm(name: &str, arm: &str, about: &str, difficulty: Option<(&str, &str)>) -> Task {
    let mut config = ArmConfig::default();
    if arm.contains("relative") {
        config.angles = Angles::Relative;
    }
    if arm.contains("stops") {
        config.limits = vec![STOPS; config.lengths.len()];
        config.hidden_limits = arm.contains("hidden");
    }
    let mut timing = TimingConfig::default();
    let number = |suffix: &str| suffix.rsplit('-').next().and_then(|last| last.parse().ok()).unwrap_or(0);
    let suffix = difficulty.map_or("", |(suffix, _)| suffix);
    let mut change = Some(CHANGE_TICK);
    match suffix {
        "block" => config.block.push(BlockConfig { joint: 3, tick: CHANGE_TICK, angle: 0.0 }),
        "shorten" => config.shorten.push(ShortenConfig { segment: 2, tick: CHANGE_TICK, length: 0.3 }),
        "mirror" => config.mirror.push(MirrorConfig { axis: MirrorAxis::X, tick: CHANGE_TICK }),
        "payload" => config.payload.push(PayloadConfig { tick: CHANGE_TICK, mass: 0.1, droop: 0.5 }),
        _ => {
            change = None;
            match suffix.rsplit_once('-').map_or("", |(kind, _)| kind) {
                "delay" => timing.delay = number(suffix),
                "reward-delay" => timing.reward_delay = number(suffix),
                "picture-delay" => timing.picture_delay = number(suffix),
                "lag" => timing.lag_ms = number(suffix) as f64,
                _ => {}
            }
        }
    }
    let about = difficulty.map_or(about.to_owned(), |(_, more)| format!("{about}; {more}"));
    Task {
        name: name.to_owned(),
        about,
        period_ms: 50.0,
        body: BodyConfig::Arm(config),
        timing,
        max_command: 0.05,
        sigma: 0.001,
        ticks: if change.is_some() { 2 * CHANGE_TICK } else { 2400 },
        change,
    }
}

/// A task that is not the arm's.
fn other(name: &str, about: &str) -> Task {
    let task = |period_ms: f64, body: BodyConfig, sigma: f64, ticks: u64| Task {
        name: name.to_owned(),
        about: about.to_owned(),
        period_ms,
        body,
        timing: TimingConfig::default(),
        max_command: 1.0,
        sigma,
        ticks,
        change: None,
    };
    match name {
        "so101" => Task {
            timing: TimingConfig { lag_ms: 100.0, ..TimingConfig::default() },
            ..task(50.0, BodyConfig::So101(So101Config::default()), 0.1, 3600)
        },
        "pendulum" => {
            let config = PendulumConfig { start: Start::Hanging, ..PendulumConfig::default() };
            task(50.0, BodyConfig::Pendulum(config), 0.2, 2400)
        }
        "pendulum-random" => task(50.0, BodyConfig::Pendulum(PendulumConfig::default()), 0.2, 2400),
        "cart-pole" => task(50.0, BodyConfig::CartPole(CartPoleConfig::default()), 0.2, 2400),
        "reacher" => task(20.0, BodyConfig::Reacher(ReacherConfig::default()), 0.05, 6000),
        "furuta" => task(20.0, BodyConfig::Furuta(FurutaConfig::default()), 0.1, 6000),
        _ => task(50.0, BodyConfig::PointMass(PointMassConfig::default()), 0.1, 1200),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_is_a_task_with_inputs_outputs_and_finite_rewards() {
        use crate::plant::Plant as _;
        use crate::{MAX_INPUTS, MAX_OUTPUTS};
        for name in names().iter().map(String::as_str).chain(USUAL) {
            let task = Task::named(name).unwrap_or_else(|| panic!("{name}"));
            assert_eq!(task.name, name);
            let signals = task.body.signals();
            assert!(signals.inputs.len() <= MAX_INPUTS && signals.outputs.len() <= MAX_OUTPUTS);
            let mut plant = task.plant(1);
            let mut inputs = [f32::NAN; MAX_INPUTS];
            for tick in 0..1300 {
                plant.sense(tick, &mut inputs);
                assert!(inputs[..signals.inputs.len()].iter().all(|input| input.is_finite()), "{name} {inputs:?}");
                let command = [0.7 * task.max_command as f32; MAX_OUTPUTS];
                let outcome = plant.advance(tick, &command[..signals.outputs.len()]);
                assert!(outcome.reward.is_finite() && outcome.measures.iter().all(|m| m.is_finite()), "{name}");
            }
        }
        for name in ["", "arms", "arm-", "arm-stop", "arm-relative-delay-4", "pendulum-delay-1"] {
            assert_eq!(Task::named(name), None, "{name}");
        }
    }

    /// Whatever has a memory and does not list it shows here, to the last bit.
    #[test]
    fn every_plant_goes_on_from_a_saved_state() {
        use crate::plant::Plant as _;
        use crate::state::{load, save, size};
        use crate::{MAX_INPUTS, MAX_OUTPUTS};
        for name in names() {
            let task = Task::named(&name).unwrap();
            let outputs = task.body.signals().outputs.len();
            let run = |plant: &mut SimulatedPlant, ticks: std::ops::Range<u64>| {
                let mut seen = Vec::new();
                for tick in ticks {
                    let mut inputs = [0.0; MAX_INPUTS];
                    let fresh = plant.sense(tick, &mut inputs);
                    let command = std::array::from_fn::<f32, MAX_OUTPUTS, _>(|i| {
                        task.max_command as f32 * libm::sinf((tick + 3 * i as u64) as f32)
                    });
                    seen.push((fresh, plant.truncated(), inputs, plant.advance(tick, &command[..outputs])));
                }
                seen
            };
            let mut whole = task.plant(5);
            run(&mut whole, 0..203);
            let mut bytes = vec![0; size(&mut whole)];
            save(&mut whole, &mut bytes);
            let mut back = task.plant(5);
            assert!(load(&mut back, &bytes), "{name}");
            assert_eq!(run(&mut back, 203..500), run(&mut whole, 203..500), "{name}");
        }
    }
}
