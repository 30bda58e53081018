//! Tests of the learner as a whole, on a small plant: a position that follows its command, and a target that jumps.

use rand::RngExt as _;

use super::{InputRange, ModelPredictive, ModelPredictiveConfig, ModelPredictiveSpec, Observed, TickFlags};
use crate::seed::{Rng, stream};
use crate::state::{load, save, size};

/// The plant, and what the learner saw of it last.
#[derive(Clone)]
struct Reach {
    rng: Rng,
    position: f64,
    target: f64,
    tick: u64,
    reward: f64,
    applied: f64,
    /// What a command of 1 moves.
    gain: f64,
    /// Where the position stops, on both sides.
    stop: f64,
    /// Factors of inputs, commands and rewards.
    units: [f64; 3],
}

impl Reach {
    fn new(units: [f64; 3]) -> Self {
        Self {
            rng: stream(7, "targets"),
            position: 0.0,
            target: 0.0,
            tick: 0,
            reward: 0.0,
            applied: 0.0,
            gain: 0.4,
            stop: 1.0,
            units,
        }
    }

    /// One tick, with `change` applied to the reward that is reported. Returns the command and the true reward.
    fn tick(&mut self, agent: &mut ModelPredictive, change: impl FnOnce(u64, f64) -> f64) -> (f64, f64) {
        let new_target = self.tick.is_multiple_of(20);
        if new_target {
            self.target = self.rng.random_range(-0.9..0.9);
        }
        let inputs = [self.target, self.position].map(|x| x * self.units[0]);
        let reward = change(self.tick, self.reward * self.units[2]);
        let flags = TickFlags { new_target, ..TickFlags::default() };
        let mut command = [0.0];
        agent.act(&Observed { inputs: &inputs, reward, applied: &[self.applied], flags }, &mut command);
        self.applied = command[0];
        agent.improve();
        let u = command[0] / self.units[1];
        self.position = (self.position + self.gain * u).clamp(-self.stop, self.stop);
        let apart = self.position - self.target;
        self.reward = -(apart * apart + 0.02 * u * u);
        self.tick += 1;
        (command[0], self.reward)
    }
}

fn agent(units: [f64; 3]) -> ModelPredictive {
    seeded(units, 3)
}

fn seeded(units: [f64; 3], seed: u64) -> ModelPredictive {
    let range = InputRange { min: -units[0], max: units[0], wraps: false, radians: None };
    ModelPredictive::new(&ModelPredictiveSpec {
        inputs: vec![range; 2],
        limits: vec![units[1]],
        steps: vec![f64::INFINITY],
        sigma: vec![0.02 * units[1]],
        seed,
        config: ModelPredictiveConfig {
            horizon: 8,
            memory: 400,
            points: 40,
            reward_features: 150,
            dynamics_features: 150,
            refit_operations: 2.0,
            ..ModelPredictiveConfig::default()
        },
    })
}

/// Mean reward of the ticks from `first` to `last`.
fn mean(rewards: &[f64], first: usize, last: usize) -> f64 {
    rewards[first..last].iter().sum::<f64>() / (last - first) as f64
}

fn run(units: [f64; 3], ticks: usize, mut change: impl FnMut(u64, f64) -> f64) -> (Vec<f64>, ModelPredictive) {
    let (mut plant, mut agent) = (Reach::new(units), agent(units));
    let rewards = (0..ticks).map(|_| plant.tick(&mut agent, &mut change).1).collect();
    (rewards, agent)
}

#[test]
fn it_learns_to_reach() {
    // Each target has twenty ticks, and moves take less than ten. Standing still in the middle gives -0.27. The sixth
    // or seventh may come too early for a few: of 32 seeds 5 targets of 160 were missed, two of them the tenth (9, one
    // of them the tenth, before operations had prices).
    let (mut missed, mut all) = (Vec::new(), 0.0);
    for seed in 1..=8 {
        let (mut plant, mut agent) = (Reach::new([1.0; 3]), seeded([1.0; 3], seed));
        let rewards: Vec<f64> = (0..200).map(|_| plant.tick(&mut agent, |_, r| r).1).collect();
        all += mean(&rewards, 60, 200) / 8.0;
        for target in 5..10 {
            let settled = mean(&rewards, 20 * target + 10, 20 * target + 20);
            if settled <= -0.004 {
                missed.push((seed, target, settled));
            }
        }
    }
    assert!(missed.len() <= 4 && missed.iter().filter(|missed| missed.1 > 6).count() <= 1, "{missed:?}");
    assert!(all > -0.1, "{all}");
}

#[test]
fn rivals_are_rare_where_the_plan_is_near_the_best_until_a_target_jumps() {
    let (mut plant, mut agent) = (Reach::new([1.0; 3]), agent([1.0; 3]));
    let mut operations = |plant: &mut Reach| (plant.tick(&mut agent, |_, r| r), agent.columns()[7]).1;
    for _ in 0..300 {
        operations(&mut plant);
    }
    let mut standing: Vec<f64> = (0..100).map(|_| (plant.tick = 1, operations(&mut plant)).1).collect();
    let at_rest = standing.split_off(60);
    let lowest = at_rest.iter().copied().fold(f64::INFINITY, f64::min);
    let with_rival = at_rest.iter().filter(|&&spent| spent > 2.0 * lowest).count();
    assert!((4..=12).contains(&with_rival), "{with_rival} of 40 ticks at rest: {at_rest:?}");
    plant.tick = 0;
    let jumped: Vec<f64> = (0..4).map(|_| operations(&mut plant)).collect();
    assert!(jumped.iter().all(|&spent| spent > 2.0 * lowest), "{jumped:?}, at rest {lowest}");
}

#[test]
fn it_finds_out_how_late_rewards_come() {
    // A target may be missed while the reward is new.
    let mut missed = Vec::new();
    for seed in 1..=4 {
        let (mut plant, mut agent) = (Reach::new([1.0; 3]), seeded([1.0; 3], seed));
        let mut late = [0.0; 2];
        let mut change = |_: u64, r: f64| {
            let [second, first] = late;
            late = [r, second];
            first
        };
        let rewards: Vec<f64> = (0..200).map(|_| plant.tick(&mut agent, &mut change).1).collect();
        assert_eq!(agent.reward_lateness(), 2, "seed {seed}");
        for last in [120, 200] {
            let settled = mean(&rewards, last - 10, last);
            if settled < -0.004 {
                missed.push((seed, last, settled));
            }
        }
    }
    assert!(missed.len() <= 1 && missed.iter().all(|missed| missed.1 == 120), "{missed:?}");
    let (_, agent) = run([1.0; 3], 120, |_, r| r);
    assert_eq!(agent.reward_lateness(), 0);
}

#[test]
fn units_are_without_effect() {
    // A power of two scales without rounding, so that every bit is the same.
    let units = [1024.0, 4096.0, 0.125];
    let (mut plain, mut scaled) = (Reach::new([1.0; 3]), Reach::new(units));
    let (mut a, mut b) = (agent([1.0; 3]), agent(units));
    for tick in 0..120 {
        let command = plain.tick(&mut a, |_, r| r).0;
        let other = scaled.tick(&mut b, |_, r| r).0;
        // Rewards are centred and scaled by sums whose rounding depends on the unit.
        assert!((command - other / units[1]).abs() < 1e-6, "tick {tick}: {command} {}", other / units[1]);
    }
    // A thousand is rounded, which changes when each of the first targets is reached; later ones are all reached.
    let (rewards, _) = run([1.0; 3], 400, |_, r| r);
    let (others, _) = run([1000.0, 1000.0, 1000.0], 400, |_, r| r);
    let (a, b) = (mean(&rewards, 200, 400), mean(&others, 200, 400));
    assert!((a - b).abs() < 0.1 * a.abs(), "{a} {b}");
}

#[test]
fn a_restored_learner_goes_on_as_the_other() {
    let mut rng = stream(11, "test");
    let (mut plant, mut original) = (Reach::new([1.0; 3]), agent([1.0; 3]));
    for _ in 0..6 {
        for _ in 0..rng.random_range(5..40) {
            plant.tick(&mut original, |_, r| r);
        }
        let mut bytes = vec![0; size(&mut original)];
        save(&mut original, &mut bytes).unwrap();
        let mut restored = agent([1.0; 3]);
        assert!(load(&mut restored, &bytes));
        let mut twin = plant.clone();
        for _ in 0..15 {
            let (a, b) = (plant.tick(&mut original, |_, r| r).0, twin.tick(&mut restored, |_, r| r).0);
            assert_eq!(a.to_bits(), b.to_bits(), "tick {}", plant.tick);
        }
        let mut other = vec![0; size(&mut restored)];
        bytes.resize(size(&mut original), 0);
        save(&mut original, &mut bytes).unwrap();
        save(&mut restored, &mut other).unwrap();
        assert!(bytes == other, "states differ at tick {}", plant.tick);
    }
}

#[test]
fn a_wild_reward_and_unusable_inputs_do_no_harm() {
    let (rewards, _) = run([1.0; 3], 260, |_, r| r);
    let (disturbed, agent) = run([1.0; 3], 260, |tick, r| if tick == 120 { -1000.0 } else { r });
    assert!(agent.counts.reward_outliers > 0);
    let (a, b) = (mean(&rewards, 140, 260), mean(&disturbed, 140, 260));
    assert!((a - b).abs() < 0.25 * a.abs(), "{a} {b}");
    let (lost, _) = run([1.0; 3], 260, |tick, r| if (120..170).contains(&tick) { f64::NAN } else { r });
    assert!(lost.iter().all(|r| r.is_finite()));
    assert!((a - mean(&lost, 140, 260)).abs() < 0.25 * a.abs());
}

#[test]
fn what_a_joint_did_before_it_blocked_no_longer_teaches() {
    let (mut plant, mut agent) = (Reach::new([1.0; 3]), agent([1.0; 3]));
    for tick in 0..200 {
        plant.gain = if tick < 120 { 0.4 } else { 0.0 };
        plant.tick(&mut agent, |_, r| r);
    }
    assert!(agent.counts.alarms > 0);
    assert_eq!(agent.counts.worlds, 1);
}

#[test]
fn a_target_that_jumps_is_answered_in_the_same_tick() {
    // The plan for that tick was made for the old target, and asks for nothing: the gains answer. The optimum goes 0.9
    // of the way at once.
    let (mut plant, mut agent) = (Reach::new([1.0; 3]), agent([1.0; 3]));
    let mut parts = Vec::new();
    for tick in 0..400 {
        let before = plant.position;
        plant.tick(&mut agent, |_, r| r);
        if tick >= 200 && tick % 20 == 0 {
            parts.push(plant.gain * agent.mean()[0] / (plant.target - before));
        }
    }
    parts.sort_by(f64::total_cmp);
    assert!(parts[1] > 0.3 && parts[8] < 1.2, "{parts:?}");
}

#[test]
fn a_command_that_moves_nothing_rests() {
    // It is tried while the reward is new, and rests then.
    let driven = [1, 2, 3].map(mean_of_an_idle_command);
    assert!(driven.iter().all(|driven| *driven < 0.1), "{driven:?}");
}

/// Mean magnitude, without noise, of a command that moves nothing, beside one that moves the position; from tick 140.
fn mean_of_an_idle_command(seed: u64) -> f64 {
    let range = InputRange { min: -1.0, max: 1.0, wraps: false, radians: None };
    let mut agent = ModelPredictive::new(&ModelPredictiveSpec {
        inputs: vec![range; 2],
        limits: vec![1.0; 2],
        steps: vec![f64::INFINITY; 2],
        sigma: vec![0.02; 2],
        seed,
        config: ModelPredictiveConfig { horizon: 8, reward_features: 150, ..ModelPredictiveConfig::default() },
    });
    let mut plant = Reach::new([1.0; 3]);
    let (mut applied, mut driven) = ([0.0; 2], 0.0);
    for tick in 0..240 {
        let new_target = tick % 20 == 0;
        if new_target {
            plant.target = plant.rng.random_range(-0.9..0.9);
        }
        let flags = TickFlags { new_target, ..TickFlags::default() };
        let inputs = [plant.target, plant.position];
        let mut command = [0.0; 2];
        agent.act(&Observed { inputs: &inputs, reward: plant.reward, applied: &applied, flags }, &mut command);
        applied = command;
        agent.improve();
        plant.position = (plant.position + plant.gain * command[0]).clamp(-1.0, 1.0);
        plant.reward = -(plant.position - plant.target).powi(2) - 0.02 * command[0] * command[0];
        driven += if tick >= 140 { agent.mean()[1].abs() / 100.0 } else { 0.0 };
    }
    driven
}

#[test]
fn a_new_episode_is_answered_from_a_plan_of_its_own() {
    let (mut plant, mut agent) = (Reach::new([1.0; 3]), agent([1.0; 3]));
    for _ in 0..160 {
        plant.tick(&mut agent, |_, r| r);
    }
    agent.freeze();
    // A plan for a long way: its command is at the limit, where it has no gains.
    let mut answer = |position: f64, truncated: bool| {
        let flags = TickFlags { truncated, ..TickFlags::default() };
        let mut command = [0.0];
        agent.act(&Observed { inputs: &[0.8, position], reward: 0.0, applied: &[0.0], flags }, &mut command);
        agent.improve();
        command[0]
    };
    (0..3).for_each(|_| _ = answer(-0.9, false));
    assert!(answer(-0.9, false) > 0.9);
    // The episode that follows begins at the target.
    let first = answer(0.8, true);
    assert!(first.abs() < 0.1, "{first}");
}

#[test]
fn a_reward_is_learned_with_the_inputs_that_it_came_of() {
    // The gain changes twice, and the position jumps twice: single changes that no model foresees, and two in a row
    // that are believed after all. What is stored with a reward that teaches is what it came of, to the last digit or
    // so.
    let (mut plant, mut agent) = (Reach::new([1.0; 3]), agent([1.0; 3]));
    for tick in 0..300 {
        plant.gain = if (100..180).contains(&tick) { -0.4 } else { 0.4 };
        if tick == 250 {
            plant.position = -plant.position;
        }
        if tick == 230 {
            plant.position -= 0.8 * plant.position.signum();
        }
        plant.tick(&mut agent, |_, r| r);
    }
    let counts = agent.counts;
    assert!(counts.input_outliers > 3, "{counts:?}");
    let mut taught = 0;
    for tick in agent.memory.first..agent.memory.stored {
        let point = agent.memory.rewarded_point(tick, 0, true).unwrap();
        let apart = point[1] - point[0];
        let apart = [agent.memory.reward(tick), -(apart * apart + 0.02 * point[6] * point[6])];
        if agent.memory.is_rewarded(tick) {
            taught += 1;
            assert!((apart[0] - apart[1]).abs() < 1e-9, "tick {tick}: {apart:?}");
        }
    }
    assert!(taught > 150, "{taught}");
}

#[test]
fn commands_change_by_no_more_than_the_gate_lets_through() {
    let range = InputRange { min: -1.0, max: 1.0, wraps: false, radians: None };
    let mut agent = ModelPredictive::new(&ModelPredictiveSpec {
        inputs: vec![range; 2],
        limits: vec![2.0],
        steps: vec![0.2],
        sigma: vec![0.1],
        seed: 3,
        config: ModelPredictiveConfig { horizon: 8, reward_features: 150, ..ModelPredictiveConfig::default() },
    });
    let (mut plant, mut before, mut largest) = (Reach::new([1.0, 2.0, 1.0]), 0.0_f64, 0.0_f64);
    for _ in 0..160 {
        let (command, _) = plant.tick(&mut agent, |_, r| r);
        assert!((command - before).abs() <= 0.2, "{before} {command}");
        (before, largest) = (command, largest.max((command - before).abs()));
    }
    assert!(largest > 0.199 && agent.counts.plans > 80, "the limit matters here: {largest}");
}

#[test]
fn stops_that_nobody_declared_are_learned_and_kept() {
    let (mut plant, mut agent) = (Reach { stop: 0.5, ..Reach::new([1.0; 3]) }, agent([1.0; 3]));
    for _ in 0..400 {
        plant.tick(&mut agent, |_, r| r);
    }
    assert_eq!((agent.counts.ends, agent.counts.alarms), (2, 0), "{:?}", agent.counts);
    // A restored learner knows the same ends.
    let mut bytes = vec![0; size(&mut agent)];
    save(&mut agent, &mut bytes);
    let mut back = self::agent([1.0; 3]);
    assert!(load(&mut back, &bytes));
    let mut other = plant.clone();
    for _ in 0..40 {
        assert_eq!(plant.tick(&mut agent, |_, r| r), other.tick(&mut back, |_, r| r));
    }
}
