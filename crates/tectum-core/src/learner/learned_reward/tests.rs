//! The models against a known reward, and the slope of rollouts against a numerical one.

use rand::RngExt as _;

use super::*;
use crate::learner::test_specs::arm;
use crate::learner::{LearnerConfig, ModelBasis, Rule};
use crate::policy::Exploration;

pub(super) fn spec(basis: ModelBasis) -> LearnerSpec {
    let mut learner = LearnerConfig::preset(Rule::LearnedReward);
    learner.model.get_or_insert_default().basis = basis;
    LearnerSpec { learner, ..arm() }
}

fn encoder(spec: &LearnerSpec) -> Encoder {
    Encoder::new(&spec.maps, spec.normalise)
}

/// The arm's reward, in double precision.
pub(super) fn reward(inputs: &[f32], changes: &[f32]) -> f32 {
    let [mut x, mut y] = [-f64::from(inputs[0]), -1.0 - f64::from(inputs[1])];
    let (mut angles, mut effort) = (0.0, 0.0);
    for (&theta, &change) in inputs[2..6].iter().zip(changes) {
        let theta = f64::from(theta);
        (x, y) = (x + 0.5 * theta.cos(), y + 0.5 * theta.sin());
        angles += theta * theta;
        effort += f64::from(change).powi(2) * 400.0;
    }
    (-0.1 * (x * x + y * y + 0.025 * effort + 0.01 * angles)) as f32
}

pub(super) fn draw(rng: &mut Rng) -> [f32; 6] {
    let mut inputs: [f32; 6] = std::array::from_fn(|_| rng.random::<f32>() * 2.0 - 1.0);
    inputs[2..].iter_mut().for_each(|x| *x *= std::f32::consts::PI);
    inputs
}

/// A learner that has learned from `ticks` states drawn from the whole input box.
pub(super) fn trained(basis: ModelBasis, ticks: usize) -> LearnedReward {
    let spec = spec(basis);
    let mut rule = LearnedReward::of(&spec, &encoder(&spec));
    let mut rng = stream(3, "test");
    let mut exploration = Exploration::new(3, 0.003, 4);
    for _ in 0..ticks {
        let (inputs, u) = (draw(&mut rng), exploration.draw());
        let changes: [f32; 4] = std::array::from_fn(|j| 31.4 * u[j]);
        assert!(rule.reward.learn(SimdPath::best(), &inputs, &changes, reward(&inputs, &changes), true).is_some());
        rule.movement.learn(&u, &changes, false);
    }
    rule.rollouts.cost.load(rule.reward.weights());
    rule
}

#[test]
fn the_smooth_model_fits_the_arms_reward_after_about_as_many_ticks_as_it_has_weights() {
    let mut rule = trained(ModelBasis::Smooth, 300);
    assert_eq!(rule.model_size(), 263);
    let mut rng = stream(4, "test");
    for _ in 0..100 {
        let inputs = draw(&mut rng);
        let changes = [0.1, -0.2, 0.0, 0.05];
        let (predicted, actual) = (rule.reward.predict(&inputs, &changes), reward(&inputs, &changes));
        assert!((predicted - f64::from(actual)).abs() < 0.01, "{predicted} {actual}");
    }
}

#[test]
fn the_model_of_maps_has_the_documented_size() {
    let spec = spec(ModelBasis::Maps);
    assert_eq!(LearnedReward::of(&spec, &encoder(&spec)).model_size(), 965);
}

/// One rollout of the champion from `state`. Returns where it ends.
pub(super) fn simulate(rule: &mut LearnedReward, state: &[f32; 6]) -> State {
    let mut states = [[0.0; MAX_INPUTS]];
    states[0][..6].copy_from_slice(state);
    rule.rollouts.set_targets(SimdPath::best(), &states);
    rule.rollouts.simulate(SimdPath::best(), &mut rule.champion, &rule.movement, &mut states);
    states[0]
}

/// The cost of a rollout from `state`, in double precision where it matters.
fn rollout_cost(rule: &mut LearnedReward, spec: &LearnerSpec, policy: &LinearPolicy, state: &[f32; 6]) -> f64 {
    let mut encoder = encoder(spec);
    let mut features = encoder.features();
    let mut state = *state;
    let mut cost = 0.0;
    for tick in 0..rule.config.horizon {
        encoder.encode(&state, &mut features);
        let u = policy.mean(features.as_slice());
        let changes: [f32; 4] =
            std::array::from_fn(|i| rule.movement.gains[i].iter().zip(&u).map(|(b, u)| b * u).sum());
        for (theta, change) in state[2..].iter_mut().zip(changes) {
            *theta = wrap(*theta + change);
        }
        let weight = if tick + 1 == rule.config.horizon { rule.config.last_counts } else { 1.0 };
        // The cost of changes counts once, whatever the weight of the last tick.
        let without_changes = rule.reward.predict(&state, &[0.0; 4]);
        cost -= weight * without_changes + rule.reward.predict(&state, &changes) - without_changes;
    }
    cost
}

#[test]
fn the_slope_matches_the_numerical_one() {
    let spec = spec(ModelBasis::Smooth);
    let mut rule = trained(ModelBasis::Smooth, 400);
    let encoder = encoder(&spec);
    let mut policy = LinearPolicy::new(encoder.len(), encoder.positions().collect(), 4);
    let mut rng = stream(5, "test");
    for (position, output) in (0..encoder.len()).flat_map(|position| (0..4).map(move |output| (position, output))) {
        *policy.weights_mut().get_mut(output, position) = 0.02 * (rng.random::<f32>() - 0.5);
    }
    let state = [0.4, -0.3, 0.5, -1.0, 0.8, 2.0];
    rule.champion.load_policy(&policy, &rule.rollouts.feature_groups);
    simulate(&mut rule, &state);
    let positions = rule.rollouts.feature_groups.clone().map(|group| group.positions);
    let slopes = rule.champion.slope.clone();
    let cost = rollout_cost(&mut rule, &spec, &policy, &state);
    assert!((f64::from(rule.champion.cost) - cost).abs() < 1e-3 * cost, "{} {cost}", rule.champion.cost);
    for (group, feature, output) in [(0, 100, 0), (0, 200, 3), (1, 5, 1), (1, 30, 2), (1, 40, 0), (1, 60, 3)] {
        let at = positions[group][feature];
        let mut along = |step: f32| {
            *policy.weights_mut().get_mut(output, at) += step;
            let cost = rollout_cost(&mut rule, &spec, &policy, &state);
            *policy.weights_mut().get_mut(output, at) -= step;
            cost
        };
        let numerical = (along(1e-3) - along(-1e-3)) / 2e-3;
        let slope = f64::from(slopes[group][output * positions[group].len() + feature]);
        assert!((slope - numerical).abs() < 0.02 * numerical.abs() + 2e-3, "{group} {feature}: {slope} {numerical}");
    }
}

#[test]
fn a_number_that_is_not_finite_stops_learning() {
    let spec = spec(ModelBasis::Smooth);
    let encoder = encoder(&spec);
    let mut policy = LinearPolicy::new(encoder.len(), encoder.positions().collect(), 4);
    let mut rule = LearnedReward::of(&spec, &encoder);
    let (features, none) = (vec![0.1; encoder.len()], [0.0; 8]);
    let mut tick = |reward| {
        let tick = Transition {
            features: &features,
            inputs: &[0.1; 6],
            noise: &none,
            applied: &none,
            reward,
            next_features: &features,
            next_inputs: &[0.1; 6],
            new_target: false,
        };
        rule.learn(&mut policy, &tick);
        rule.improve(&mut policy);
        rule.halted()
    };
    assert!(!tick(-1.0));
    assert!(tick(f32::NAN));
    assert!(tick(-1.0));
}

#[test]
fn it_works_rarely_while_nothing_changes_and_always_after_a_change() {
    let mut spec = spec(ModelBasis::Smooth);
    let config = spec.learner.model.get_or_insert_default();
    (config.rest, config.movements, config.steps, config.horizon) = (4, 1, 1, 2);
    let encoder = encoder(&spec);
    let mut policy = LinearPolicy::new(encoder.len(), encoder.positions().collect(), 4);
    let mut rule = LearnedReward::of(&spec, &encoder);
    let (mut rng, mut exploration) = (stream(6, "test"), Exploration::new(6, 0.003, 4));
    let (features, none) = (vec![0.1; encoder.len()], [0.0; 8]);
    let mut run = |rule: &mut LearnedReward, ticks: usize, factor: f32| {
        let mut worked = 0;
        for _ in 0..ticks {
            let (inputs, applied, before) = (draw(&mut rng), exploration.draw(), policy.hash());
            let mut next = inputs;
            for i in 0..4 {
                next[2 + i] = wrap(next[2 + i] + 31.4 * applied[i]);
            }
            let changes: [f32; 4] = std::array::from_fn(|i| 31.4 * applied[i]);
            let tick = Transition {
                features: &features,
                inputs: &inputs,
                noise: &none,
                applied: &applied,
                reward: factor * reward(&next, &changes),
                next_features: &features,
                next_inputs: &next,
                new_target: false,
            };
            rule.learn(&mut policy, &tick);
            rule.improve(&mut policy);
            worked += usize::from(policy.hash() != before);
        }
        worked
    };
    run(&mut rule, 1500, 1.0);
    // Every tick is checked for changes, but the rule works in hardly any.
    assert!((1..=4).contains(&run(&mut rule, 512, 1.0)));
    let unchanged = rule.unchanged_ticks;
    assert!(unchanged > 1000, "{unchanged}");
    assert!(run(&mut rule, 40, 1.3) > 10);
    assert!(rule.unchanged_ticks < 40, "{}", rule.unchanged_ticks);
}
