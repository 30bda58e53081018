//! Every SIMD path of the inner loops gives the same bits: encoder, mean output, and the learning rules with their
//! traces, over a million random inputs each, and learned-reward over some hundred ticks of the arm. A machine with
//! only one path has nothing to compare; the test then prints that it is skipped.

use rand::RngExt as _;
use tectum::agent::learned_hash;
use tectum::encoder::{Axis, Encoder, Map};
use tectum::learner::{ActorCritic, CriticConstants, LearningRule, PaperRule, Transition};
use tectum::policy::{LinearPolicy, Outputs};
use tectum::runtime::Simulation;
use tectum::scenario::Scenario;
use tectum::seed::{Rng, stream};
use tectum::simd::SimdPath;
use tectum::state;

const MILLION: usize = 1_000_000;

/// The paths of this machine other than the baseline.
fn other_paths() -> Vec<SimdPath> {
    let others: Vec<_> = SimdPath::all().skip(1).collect();
    if others.is_empty() {
        println!("skipped: this machine has one path only, {}", SimdPath::BASELINE);
    }
    others
}

fn axis(input: usize, units: usize, radius: f64) -> Axis {
    Axis { input, units, min: -1.0, max: 1.5, radius }
}

/// Encoders that cover all cases: the paper's rows of 16, rows whose length leaves every remainder modulo the number of
/// lanes, lines that are joined and lines that are not, and scalar features.
fn encoders() -> Vec<Encoder> {
    let plane = |slow, fast| Map::Plane(axis(0, slow, 0.5), axis(1, fast, 0.4));
    vec![
        Encoder::new(&[plane(5, 16), Map::Line(axis(2, 16, 0.3)), Map::Line(axis(3, 7, 0.3))], true),
        Encoder::new(&[plane(3, 4), Map::Line(axis(2, 5, 2.0))], true).with_scalars(&[3]),
        Encoder::new(&[Map::Line(axis(1, 18, 0.05)), plane(2, 11)], true),
        Encoder::new(&[plane(17, 3)], false),
        Encoder::new(&[Map::Line(axis(0, 6, 1e-3)), Map::Line(axis(2, 2, 1e3))], false),
    ]
}

/// A random input: mostly in or near the range, sometimes far outside, and sometimes arbitrary bits.
fn input(rng: &mut Rng) -> f32 {
    let bits: u32 = rng.random();
    match bits % 16 {
        0 => f32::from_bits(rng.random()),
        1 => 1e6 * (rng.random::<f32>() - 0.5),
        _ => 4.0 * (rng.random::<f32>() - 0.5),
    }
}

#[test]
fn encoders_agree_bit_for_bit() {
    let mut rng = stream(7, "paths");
    for path in other_paths() {
        let encoders = encoders();
        let rounds = MILLION / encoders.len();
        for encoder in encoders {
            let (mut base, mut other) = (encoder.clone().on(SimdPath::BASELINE), encoder.on(path));
            let (mut expected, mut seen) = (base.features(), base.features());
            for _ in 0..rounds {
                let inputs: [f32; 4] = std::array::from_fn(|_| input(&mut rng));
                base.encode(&inputs, &mut expected);
                other.encode(&inputs, &mut seen);
                let bytes = bytemuck::cast_slice::<f32, u8>;
                assert!(bytes(expected.as_slice()) == bytes(seen.as_slice()), "{path} differs at {inputs:?}");
            }
        }
    }
}

/// A learning rule with its policy on two paths.
struct Pair<R> {
    rules: [R; 2],
    policies: [LinearPolicy; 2],
}

impl<R: LearningRule> Pair<R> {
    fn new(rules: [R; 2], path: SimdPath, len: usize, outputs: usize) -> Self {
        let policies =
            [SimdPath::BASELINE, path].map(|path| LinearPolicy::new(len, (0..len).collect(), outputs).on(path));
        Self { rules, policies }
    }

    /// Runs ticks with random features, noise and rewards. After each tick the outputs must be equal, and in the end
    /// the weights and traces.
    fn run(mut self, rng: &mut Rng, len: usize, ticks: usize) {
        let mut features: [Vec<f32>; 2] = [(); 2].map(|()| vec![0.0; len]);
        for tick in 0..ticks {
            features.swap(0, 1);
            features[1].iter_mut().for_each(|g| *g = rng.random());
            let noise: Outputs = std::array::from_fn(|_| 0.2 * (rng.random::<f32>() - 0.5));
            let reward = -rng.random::<f32>();
            let [now, next] = &features;
            let tick_of = Transition {
                features: now,
                inputs: &[],
                noise: &noise,
                applied: &noise,
                reward,
                next_features: next,
                next_inputs: &[],
                new_target: false,
            };
            let mut results = [(0.0, [0.0; 8]); 2];
            for ((rule, policy), result) in self.rules.iter_mut().zip(&mut self.policies).zip(&mut results) {
                result.0 = rule.learn_and_answer(policy, &tick_of, &mut result.1);
                // A combined pass gives the same as two separate passes.
                assert_eq!(result.1.map(f32::to_bits), policy.mean(next).map(f32::to_bits), "{:?}", policy.path());
            }
            let [(step, mean), (other_step, other_mean)] = results;
            assert_eq!((step.to_bits(), mean.map(f32::to_bits)), (other_step.to_bits(), other_mean.map(f32::to_bits)));
            if tick % 1000 == 999 {
                self.rules.iter_mut().for_each(LearningRule::cut_trace);
            }
        }
        let [baseline, other] = &self.policies;
        assert!(baseline.norm() > 0.0 && self.rules.iter().all(|rule| !rule.halted()));
        assert_eq!((baseline.hash(), baseline.norm().to_bits()), (other.hash(), other.norm().to_bits()));
        for slices in baseline.weights().as_slices().zip(other.weights().as_slices()) {
            assert_eq!(slices.0, slices.1, "also in the padding");
        }
        let norms = self.rules.map(|rule| rule.trace_norm().to_bits());
        assert_eq!(norms[0], norms[1]);
    }
}

/// Features and outputs: sizes with every remainder modulo the number of lanes, and one or two groups of outputs.
const SIZES: [(usize, usize); 4] = [(8, 4), (12, 5), (20, 1), (4, 8)];

#[test]
fn the_papers_rule_agrees_bit_for_bit() {
    let mut rng = stream(8, "paths");
    for path in other_paths() {
        for (len, outputs) in SIZES {
            let rule = PaperRule::new(len, outputs, 0.9, 0.01);
            Pair::new([rule.clone(), rule], path, len, outputs).run(&mut rng, len, MILLION / SIZES.len());
        }
    }
}

/// Learned-reward in the arm's scenario, with rollouts of both candidates and a blocked joint: what it has learned and
/// its whole state.
#[test]
fn learned_reward_agrees_bit_for_bit() {
    let mut scenario = Scenario::find("arm").unwrap();
    scenario.plant.arm.as_mut().unwrap().block[0].tick = 200;
    let plan = scenario.plan().unwrap();
    let learned = |path| {
        let mut run = Simulation::new(&plan, plan.simulated_plant().unwrap()).on(path);
        for _ in 0..300 {
            run.sense();
            run.answer();
            run.improve();
            run.advance();
        }
        let mut agent = run.finish().agent;
        (learned_hash(&mut agent), state::hash(&mut agent))
    };
    let expected = learned(SimdPath::BASELINE);
    for path in other_paths() {
        assert_eq!(learned(path), expected, "{path}");
    }
}

#[test]
fn the_actor_critic_agrees_bit_for_bit() {
    let critic = CriticConstants {
        step: 0.05,
        discount: 0.9,
        decay: 0.5,
        reward_feature: 0.5,
        bound: 3.0,
        half_life: 1e6,
        floor: 0.1,
        warm_up: 10.0,
        noise_step: 0.01,
        sigma: 0.06,
    };
    let mut rng = stream(9, "paths");
    for path in other_paths() {
        for (len, outputs) in SIZES {
            let rule = ActorCritic::new(len, outputs, 0.8, 0.01, critic);
            Pair::new([rule.clone(), rule], path, len, outputs).run(&mut rng, len, MILLION / SIZES.len());
        }
    }
}
