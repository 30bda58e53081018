//! The equations of the actor-critic, and the bounds of its steps.

use super::*;

const CRITIC: CriticConstants = CriticConstants {
    step: 0.5,
    discount: 0.9,
    decay: 0.5,
    reward_feature: 0.25,
    bound: 3.0,
    half_life: f32::INFINITY,
    floor: 0.0,
    warm_up: 0.0,
    noise_step: 0.0,
    sigma: 1.0,
};

fn tick<'a>(features: &'a [f32], noise: &'a Outputs, reward: f32, next_features: &'a [f32]) -> Transition<'a> {
    Transition {
        features,
        inputs: &[],
        noise,
        applied: noise,
        reward,
        next_features,
        next_inputs: &[],
        new_target: false,
    }
}

/// All value weights, including the pending step.
fn values(rule: &mut ActorCritic) -> Vec<f32> {
    let mut updated = rule.clone();
    updated.cut_trace();
    updated.values.as_slice().to_vec()
}

#[test]
fn two_ticks_follow_the_equations() {
    let mut policy = LinearPolicy::new(4, (0..4).collect(), 4);
    // Steps that no bound limits.
    let critic = CriticConstants { step: 0.25, sigma: 10.0, ..CRITIC };
    let mut rule = ActorCritic::new(4, 4, 0.8, 0.1, critic);
    let mut noise = [0.0; 8];
    noise[..2].copy_from_slice(&[0.5, -1.0]);
    let (a, b, c) = ([1.0, 0.0, 0.5, 0.0], [0.0, 1.0, 0.5, 0.0], [0.0, 0.0, 1.0, 0.0]);
    rule.learn(&mut policy, &tick(&a, &noise, -2.0, &b));
    // No value yet: delta = r. v = 0.25 * -2 * a; the last reward was 0, so its weight stays.
    assert_eq!(values(&mut rule), [-0.5, 0.0, -0.25, 0.0]);
    assert!((policy.weight(1, 0) - 0.2).abs() < 1e-6);
    // delta = -1 + 0.9 * -0.25 - -0.125.
    rule.learn(&mut policy, &tick(&b, &noise, -1.0, &c));
    let delta = -1.0 + 0.9 * -0.25 + 0.125_f32;
    let trace = [0.45, 1.0, 0.45 * 0.5 + 0.5, 0.0];
    let now = values(&mut rule);
    for (i, before) in [-0.5, 0.0, -0.25, 0.0].iter().enumerate() {
        assert!((now[i] - (before + 0.25 * delta * trace[i])).abs() < 1e-6);
    }
    rule.cut_trace();
    assert!((rule.reward_input[0] - 0.25 * delta * 0.25 * -2.0).abs() < 1e-6);
    let expected = -0.1 + 0.1 * delta * (0.8 * 0.5 * 1.0);
    assert!((policy.weight(0, 0) - expected).abs() < 1e-6);
}

#[test]
fn no_step_moves_a_mean_or_a_value_farther_than_the_bounds() {
    let (a, b) = ([0.8, 0.6, 0.0, 0.0], [0.0, 0.6, 0.8, 0.0]);
    for metric in [None, Some(NaturalMetric::from_moments(vec![0.25; 16], 4, 4, 0.3))] {
        let mut policy = LinearPolicy::new(4, (0..4).collect(), 3);
        let critic = CriticConstants { step: 100.0, sigma: 0.2, bound: 1e9, ..CRITIC };
        let mut rule = ActorCritic::new(4, 3, 0.9, 1000.0, critic).with(None, metric);
        let mut exploration = crate::policy::Exploration::new(3, 0.2, 3);
        let mut longest = 0.0_f32;
        for k in 0..500 {
            let (here, next) = if k % 7 < 3 { (&a, &b) } else { (&b, &a) };
            let (before, value) = (policy.mean(here), dot(&values(&mut rule), here));
            let reward = if k % 50 == 49 { -1e4 } else { -1.0 };
            let known = reward + 0.9 * dot(&values(&mut rule), next) - value;
            rule.learn(&mut policy, &tick(here, &exploration.draw(), reward, next));
            for (after, before) in policy.mean(here).iter().zip(before) {
                longest = longest.max((after - before).abs());
            }
            // The last reward is a feature too, and may account for part of the error.
            let moved = dot(&values(&mut rule), here) - value;
            let weight = rule.reward_input[0].abs() * 0.25 * 2e4;
            assert!(moved.abs() <= known.abs() + weight + 1e-3, "{k}: {moved} {known}");
        }
        // Single precision, with weights of the order of 1.
        assert!(longest <= MAX_MEAN_STEP * 0.2 * 1.001 && longest > 0.5 * MAX_MEAN_STEP * 0.2, "{longest}");
        assert!(!rule.halted());
    }
}

#[test]
fn the_cost_of_squared_noise_is_learned_and_subtracted() {
    let mut policy = LinearPolicy::new(4, (0..4).collect(), 2);
    let critic = CriticConstants { noise_step: 0.05, sigma: 0.5, bound: 1e6, ..CRITIC };
    let mut rule = ActorCritic::new(4, 2, 0.0, 0.0, critic);
    let mut exploration = crate::policy::Exploration::new(3, 0.5, 2);
    for _ in 0..2000 {
        let noise = exploration.draw();
        let reward = -0.1 - 0.3 * noise[0] * noise[0];
        rule.learn(&mut policy, &tick(&[1.0, 0.0, 0.0, 0.0], &noise, reward, &[1.0, 0.0, 0.0, 0.0]));
    }
    // 0.3 sigma^2 on the first output, nothing on the second or on unused outputs.
    assert!((rule.noise_costs[0] + 0.075).abs() < 0.01, "{:?}", rule.noise_costs);
    assert!(rule.noise_costs[1].abs() < 0.01 && rule.noise_costs[2..] == [0.0; 6], "{:?}", rule.noise_costs);
    assert!(rule.error_size < 0.03, "{}", rule.error_size);
}

#[test]
fn an_outlier_is_limited_to_the_bound() {
    let mut rule = ActorCritic::new(4, 4, 0.8, 0.1, CRITIC);
    assert_eq!(rule.bound_error(-0.5), -0.5);
    assert_eq!(rule.bound_error(-100.0), -1.5);
}

#[test]
fn a_number_that_is_not_finite_stops_learning() {
    let mut policy = LinearPolicy::new(4, (0..4).collect(), 4);
    let mut rule = ActorCritic::new(4, 4, 0.8, 0.1, CRITIC);
    rule.values.as_mut_slice()[0] = f32::INFINITY;
    let noise = [1.0; 8];
    rule.learn(&mut policy, &tick(&[1.0; 4], &noise, -1.0, &[1.0; 4]));
    assert!(rule.halted());
    rule.values.as_mut_slice()[0] = 0.0;
    rule.learn(&mut policy, &tick(&[1.0; 4], &noise, -1.0, &[1.0; 4]));
    assert_eq!(policy.norm(), 0.0);
}

/// The weight of the only feature after `ticks` ticks of a task whose best command is 0.3; `reward_of` makes the
/// reward of tick k from the command.
fn learned_weight(ticks: usize, limit: f32, reward_of: impl Fn(usize, f32) -> f32) -> (f32, f32) {
    let mut policy = LinearPolicy::new(4, (0..4).collect(), 1);
    let critic = CriticConstants { discount: 0.0, reward_feature: 0.0, bound: 5.0, sigma: 0.1, step: 0.1, ..CRITIC };
    let mut rule = ActorCritic::new(4, 1, 0.0, 1.0, critic).limited_to([limit; 8]);
    let mut exploration = crate::policy::Exploration::new(3, 0.1, 1);
    let features = [1.0, 0.0, 0.0, 0.0];
    let mut farthest = 0.0_f32;
    for k in 0..ticks {
        let mean = policy.mean(&features)[0];
        let mut noise = exploration.draw();
        let applied = (mean + noise[0]).clamp(-limit, limit);
        noise[0] = applied - mean;
        rule.learn(&mut policy, &tick(&features, &noise, reward_of(k, applied), &features));
        farthest = farthest.max(policy.weight(0, 0).abs());
    }
    (policy.weight(0, 0), farthest)
}

#[test]
fn a_first_error_of_zero_or_nearly_zero_is_no_scale() {
    let best = |u: f32| -(u - 0.3).powi(2);
    for first in [0.0, 1e-12] {
        let (weight, _) = learned_weight(4000, 10.0, |k, u| if k == 0 { first } else { best(u) });
        assert!((weight - 0.3).abs() < 0.1, "{first}: {weight}");
    }
}

#[test]
fn the_mean_stays_at_the_gates_limit_and_comes_back_from_it() {
    // More is better, up to tick 3000: the mean goes to the limit.
    let (weight, farthest) = learned_weight(3000, 0.5, |_, u| u);
    assert!(weight > 0.4 && farthest <= 0.5 + MEAN_MARGIN * 0.1 + 1e-6, "{weight} {farthest}");
    let (weight, _) = learned_weight(6000, 0.5, |k, u| if k < 3000 { u } else { -(u + 0.3).abs() });
    assert!((weight + 0.3).abs() < 0.15, "{weight}");
    // At the limit the reward does not depend on the noise any more, and pure chance may not move the mean.
    let chance = |k: usize| ((k * 7919) % 1000) as f32 / 500.0 - 1.0;
    let (_, farthest) = learned_weight(20_000, 0.05, |k, _| chance(k));
    assert!(farthest <= 0.05 + MEAN_MARGIN * 0.1 + 1e-6, "{farthest}");
}
