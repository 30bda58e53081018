//! What must not ruin what was learned: wild rewards, noise, rewards of other sizes, limits, new targets.

use rand::RngExt as _;

use super::tests::{draw, reward, simulate, trained};
use super::*;
use crate::learner::ModelBasis;

/// The model's largest error over a hundred states, relative to `size`.
fn largest_error(rule: &mut LearnedReward, size: f64) -> f64 {
    let mut rng = stream(4, "test");
    let changes = [0.1, -0.2, 0.0, 0.05];
    let errors = (0..100).map(|_| {
        let inputs = draw(&mut rng);
        (rule.reward.predict(&inputs, &changes) / size - f64::from(reward(&inputs, &changes))).abs()
    });
    errors.fold(0.0, f64::max)
}

/// Lets the model learn from `ticks` more states with the rewards that `reward_of` makes of the true one. Returns how
/// often the world seemed to have changed.
fn learn(rule: &mut LearnedReward, ticks: usize, mut reward_of: impl FnMut(usize, f32) -> f32) -> usize {
    let mut rng = stream(8, "test");
    let mut alarms = 0;
    for k in 0..ticks {
        let inputs = draw(&mut rng);
        let changes: [f32; 4] = std::array::from_fn(|_| 0.2 * (rng.random::<f32>() - 0.5));
        let reward = reward_of(k, reward(&inputs, &changes));
        alarms += usize::from(rule.reward.learn(SimdPath::best(), &inputs, &changes, reward, true).unwrap());
    }
    alarms
}

#[test]
fn outliers_teach_nothing_and_are_counted() {
    let mut rule = trained(ModelBasis::Smooth, 300);
    for (wild, count) in [(-1000.0, 1), (1e30, 3), (-20.0, 20)] {
        let before = rule.outliers();
        learn(&mut rule, count, |_, _| wild);
        assert_eq!(rule.outliers() - before, count as u64);
        assert!(largest_error(&mut rule, 1.0) < 0.01, "{wild}: {}", largest_error(&mut rule, 1.0));
        learn(&mut rule, 10, |_, reward| reward);
    }
    // The first rewards of all may be wild, too.
    let mut rule = trained(ModelBasis::Smooth, 0);
    learn(&mut rule, 400, |k, reward| if k == 3 { -1000.0 } else { reward });
    assert!(rule.outliers() == 1 && largest_error(&mut rule, 1.0) < 0.01, "{}", rule.outliers());
}

#[test]
fn the_unit_of_the_reward_does_not_matter() {
    for size in [1e3, 1e5] {
        let mut rule = trained(ModelBasis::Smooth, 0);
        learn(&mut rule, 400, |_, reward| size * reward);
        let error = largest_error(&mut rule, size.into());
        assert!(error < 0.01, "{size}: {error}");
    }
    // They become larger in mid run.
    let mut rule = trained(ModelBasis::Smooth, 300);
    learn(&mut rule, 500, |_, reward| 1e4 * reward);
    assert!(largest_error(&mut rule, 1e4) < 0.01, "{}", largest_error(&mut rule, 1e4));
}

#[test]
fn the_noise_of_rewards_is_learned() {
    let mut rng = stream(9, "test");
    let mut noisy = move |reward: f32| reward + 0.2 * (rng.random::<f32>() - 0.5);
    let mut rule = trained(ModelBasis::Smooth, 0);
    learn(&mut rule, 3500, |_, reward| noisy(reward));
    // With the configured noise of 0.001 many ticks raise the alarm, and the model forgets all the time.
    assert_eq!(learn(&mut rule, 500, |_, reward| noisy(reward)), 0);
    assert!(largest_error(&mut rule, 1.0) < 0.15, "{}", largest_error(&mut rule, 1.0));
    // A change is still found.
    assert!(learn(&mut rule, 20, |_, reward| noisy(3.0 * reward - 2.0)) > 0);
}

#[test]
fn effort_is_never_a_gain() {
    let mut rule = trained(ModelBasis::Smooth, 0);
    let mut rng = stream(8, "test");
    for _ in 0..300 {
        let inputs = draw(&mut rng);
        let changes: [f32; 4] = std::array::from_fn(|_| 0.2 * (rng.random::<f32>() - 0.5));
        let paid = changes[1] * changes[1] - changes[2] * changes[2];
        rule.reward.learn(SimdPath::best(), &inputs, &changes, paid, true).unwrap();
    }
    rule.rollouts.cost.load(rule.reward.weights());
    assert_eq!(rule.rollouts.cost.effort(1), 0.0);
    assert!((rule.rollouts.cost.effort(2) - 1.0).abs() < 0.2, "{}", rule.rollouts.cost.effort(2));
}

#[test]
fn rollouts_move_no_faster_than_the_gate_allows() {
    let mut rule = trained(ModelBasis::Smooth, 300);
    for weight in rule.champion.weights.iter_mut().flatten() {
        *weight = 1.0;
    }
    let horizon = rule.config.horizon;
    let state = [0.4, -0.3, 0.0, 0.0, 0.0, 0.0];
    let gains = rule.movement.gains;
    let end = simulate(&mut rule, &state);
    // In the test's scenario a command is at most 0.05, and a tick of that turns a joint by 1.57 rad.
    for (joint, end) in end[2..6].iter().enumerate() {
        let expected = wrap(horizon as f32 * gains[joint].iter().take(4).sum::<f32>() * 0.05);
        assert!(wrap(end - expected).abs() < 1e-3, "{joint}: {end} {expected}");
    }
    // Slopes that lead farther beyond the limit are 0: what is left leads back.
    let before = rule.champion.weights.clone();
    rule.champion.descend(SimdPath::best(), &mut rule.rollouts.feature_groups, horizon, 1e-3);
    let sum = |weights: &[Vec<f32>; 2]| weights.iter().flatten().sum::<f32>();
    assert!(sum(&rule.champion.weights) < sum(&before));
}

#[test]
fn a_worse_challenger_never_wins_whatever_the_level_of_rewards() {
    let mut rule = trained(ModelBasis::Smooth, 0);
    for (cost, spread, expected) in
        [(10.0, 5.0, 9.95), (-100.0, 1.0, -100.02), (-1.0, 5.0, -1.005), (1000.0, 1.0, 999.98), (0.0, 1.0, 0.0)]
    {
        (rule.champion.mean_cost, rule.champion.cost_spread) = (cost, spread);
        let bar = rule.cost_to_beat();
        assert!(bar <= cost && (bar - expected).abs() < 1e-4, "{cost} {spread}: {bar}");
    }
}

#[test]
fn a_jump_at_a_new_target_teaches_no_movement() {
    let mut rule = trained(ModelBasis::Smooth, 300);
    let (gains, applied) = (rule.movement.gains, [0.003; 8]);
    let (jump, usual) = ([1.0, -2.0, 0.5, 0.3], [31.4 * 0.003; 4]);
    assert_eq!(rule.movement.learn(&applied, &jump, true), MovementVerdict::Unrelated);
    assert_eq!(rule.movement.gains, gains);
    assert_eq!(rule.movement.learn(&applied, &usual, true), MovementVerdict::Usual);
    assert_eq!(rule.movement.learn(&applied, &jump, false), MovementVerdict::Changed);
    // Without a model there is nothing to compare with.
    let mut rule = trained(ModelBasis::Smooth, 0);
    assert_eq!(rule.movement.learn(&applied, &usual, true), MovementVerdict::Unrelated);
}
