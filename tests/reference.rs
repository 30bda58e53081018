//! Compares the learner with double-precision reference runs: with given targets, stimuli and noise it must reach the
//! same angles, rewards and weights. (`encoder_reference.rs` tests the encoders.)
//!
//! Tolerances. Single precision rounds to 2^-24 = 6e-8 of a value. An angle (up to 3.1 rad) is summed with one
//! rounding of at most 1.2e-7 a tick. Over 400 ticks that is a random walk of 400 such steps, 2.4e-6. This error
//! determines the errors of the end-effector (four segments of 0.5 m, so at most twice that, in m) and of the reward.
//! The tolerances are 4e-6 rad, 8e-6 m and 4e-6 of the reward's size. Commands are below 0.1; their tolerance is
//! 1e-7. Errors and rewards of the eye are below 2 and are computed through a logarithm; their tolerance is 1e-6.
//! Weights are sums of some hundred small steps of random sign; their tolerance is 1e-5 of the largest weight. The
//! errors found are printed; they are five to ten times smaller than the tolerances.

use std::path::Path;

use serde_json::Value;
use tectum::encoder::{Encoder, Features};
use tectum::learner::PaperRule;
use tectum::plant::{Arm, Eye, Plant, Stimulus};
use tectum::policy::{LinearPolicy, Outputs};
use tectum::scenario::{BlockConfig, Retina, Scenario};

fn load(name: &str) -> Value {
    let path = Path::new("tests/reference").join(name);
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

fn outputs(value: &Value) -> Outputs {
    let mut outputs = [0.0; 8];
    for (o, x) in outputs.iter_mut().zip(numbers(value)) {
        *o = x as f32;
    }
    outputs
}

/// The largest error so far.
#[derive(Default)]
struct LargestError(f64);

impl LargestError {
    #[track_caller]
    fn check(&mut self, actual: f32, expected: f64, tolerance: f64, what: &str) {
        let error = (f64::from(actual) - expected).abs();
        assert!(error <= tolerance, "{what}: {actual} against {expected}, off by {error:e}");
        self.0 = self.0.max(error);
    }
}

/// Encoder, policy and learning rule of a scenario.
struct Learner {
    encoder: Encoder,
    features: Features,
    policy: LinearPolicy,
    rule: PaperRule,
}

impl Learner {
    fn new(scenario: Scenario) -> Self {
        let plan = scenario.plan().unwrap();
        let encoder = Encoder::new(&plan.maps, plan.scenario.encoder.normalise);
        let (len, outputs) = (encoder.len(), plan.outputs.len());
        let table = &plan.scenario.learner;
        Self {
            features: encoder.features(),
            policy: LinearPolicy::new(len, encoder.positions().collect(), outputs),
            rule: PaperRule::new(len, outputs, table.beta as f32, table.alpha_over_variance as f32),
            encoder,
        }
    }

    fn command(&mut self, inputs: &[f32], noise: &Outputs) -> Outputs {
        self.encoder.encode(inputs, &mut self.features);
        let mut drawn = self.policy.mean(self.features.as_slice());
        for (u, n) in drawn.iter_mut().zip(noise) {
            *u += n;
        }
        drawn
    }

    fn learn(&mut self, noise: &Outputs, reward: f32) {
        self.rule.step(&mut self.policy, self.features.as_slice(), noise, reward);
    }

    #[track_caller]
    fn check_weights(&self, expected: &Value) {
        let rows: Vec<Vec<f64>> = expected.as_array().unwrap().iter().map(numbers).collect();
        let largest = rows.iter().flatten().fold(0.0_f64, |m, w| m.max(w.abs()));
        let mut error = LargestError::default();
        for (output, row) in rows.iter().enumerate() {
            assert_eq!(row.len(), self.policy.features());
            for (feature, &w) in row.iter().enumerate() {
                error.check(self.policy.weight(output, feature), w, 1e-5 * largest, "weight");
            }
        }
        println!("weights: off by at most {:e} of the largest, {largest:e}", error.0 / largest);
    }
}

#[test]
fn the_arm_learns_as_the_reference_does() {
    let run = load("arm_run.json");
    let mut scenario = Scenario::find("paper").unwrap();
    let arm = scenario.plant.arm.as_mut().unwrap();
    arm.targets =
        run["targets_every_80_ticks"].as_array().unwrap().iter().map(|t| numbers(t).try_into().unwrap()).collect();
    arm.block = vec![BlockConfig { joint: 3, tick: run["block_joint_3_at"].as_u64().unwrap(), angle: 0.0 }];
    for (key, value) in [
        ("sigma", scenario.policy.sigma),
        ("alpha_over_variance", scenario.learner.alpha_over_variance),
        ("beta", scenario.learner.beta),
    ] {
        assert_eq!(run[key].as_f64(), Some(value), "{key}");
    }
    let mut arm = Arm::new(scenario.plant.arm.as_ref().unwrap(), 0.05, 1);
    let mut learner = Learner::new(scenario);
    let (mut angles, mut ends, mut rewards) =
        (LargestError::default(), LargestError::default(), LargestError::default());
    let mut inputs = [0.0; 6];
    let noise = run["noise"].as_array().unwrap();
    for (tick, (expected, noise)) in run["ticks"].as_array().unwrap().iter().zip(noise).enumerate() {
        let noise = outputs(noise);
        arm.sense(tick as u64, &mut inputs);
        let drawn = learner.command(&inputs, &noise);
        let outcome = arm.advance(tick as u64, &drawn[..4]);
        learner.learn(&noise, outcome.reward);
        for (theta, expected) in arm.angles().iter().zip(numbers(&expected["theta"])) {
            angles.check(*theta, expected, 4e-6, &format!("angle at tick {tick}"));
        }
        for (x, expected) in arm.end().iter().zip(numbers(&expected["end"])) {
            ends.check(*x, expected, 8e-6, &format!("end at tick {tick}"));
        }
        let reward = expected["reward"].as_f64().unwrap();
        rewards.check(outcome.reward, reward, 4e-6 * (1.0 + reward.abs()), &format!("reward at tick {tick}"));
    }
    println!("angles {:e} rad, ends {:e} m, rewards {:e}", angles.0, ends.0, rewards.0);
    learner.check_weights(&run["weights"]);
}

#[test]
fn the_eye_learns_as_the_reference_does() {
    let run = load("eye_run.json");
    let mut scenario = Scenario::find("eye").unwrap();
    scenario.policy.sigma = run["sigma"].as_f64().unwrap();
    scenario.learner.alpha_over_variance = run["alpha_over_variance"].as_f64().unwrap();
    scenario.learner.beta = 0.0;
    let table = scenario.plant.eye.as_mut().unwrap();
    assert_eq!(run["retina"], "log_polar");
    table.retina = Retina::LogPolar;
    table.bonus = run["b"].as_f64().unwrap();
    let mut eye = Eye::new(table, 1);
    let mut learner = Learner::new(scenario);
    let (mut commands, mut rewards, mut errors) =
        (LargestError::default(), LargestError::default(), LargestError::default());
    for (trial, expected) in run["trials"].as_array().unwrap().iter().enumerate() {
        let pair = |key: &str| [0, 1].map(|i| expected[key][i].as_f64().unwrap() as f32);
        let stimulus = Stimulus { position: pair("position"), velocity: pair("velocity") };
        let noise = outputs(&expected["noise"]);
        let drawn = learner.command(&eye.see(&stimulus), &noise);
        eye.show(stimulus);
        let outcome = eye.advance(trial as u64, &drawn[..4]);
        learner.learn(&noise, outcome.reward);
        for (u, expected) in drawn.iter().zip(numbers(&expected["command"])) {
            commands.check(*u, expected, 1e-7, &format!("command of trial {trial}"));
        }
        rewards.check(outcome.reward, expected["reward"].as_f64().unwrap(), 1e-6, &format!("reward of trial {trial}"));
        errors.check(
            outcome.measures[0],
            expected["error"].as_f64().unwrap(),
            1e-6,
            &format!("error of trial {trial}"),
        );
    }
    println!("commands {:e}, rewards {:e}, errors {:e}", commands.0, rewards.0, errors.0);
    learner.check_weights(&run["weights"]);
}
