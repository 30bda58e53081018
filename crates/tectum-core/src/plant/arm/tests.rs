//! The arm's tests: each setting against values worked out by hand.

use std::f32::consts::PI;

use super::*;
use crate::plant::{Angles, ArmRewardConfig, MirrorAxis, MirrorConfig, ShortenConfig};
use proptest::prelude::*;

#[test]
fn a_straight_arm_reaches_as_far_as_its_segments() {
    let arm = Arm::new(&ArmConfig::default(), 0.05, 1);
    assert_eq!(arm.end(), [2.0, -1.0]);
}

#[test]
fn targets_are_within_reach_of_an_arm_with_one_long_segment() {
    let config = ArmConfig { lengths: vec![1.5, 0.3], ..Default::default() };
    let mut arm = Arm::new(&config, 0.05, 1);
    let mut inputs = [0.0; 4];
    for tick in (0..8000).step_by(80) {
        arm.sense(tick, &mut inputs);
        let distance = inputs[0].hypot(inputs[1] + 1.0);
        assert!((1.2..=1.8).contains(&distance), "{distance}");
    }
}

#[test]
fn targets_jump_on_time_and_lie_within_reach() {
    let mut arm = Arm::new(&ArmConfig::default(), 0.05, 1);
    let mut inputs = [0.0; 6];
    let mut targets = Vec::new();
    for tick in 0..800 {
        assert_eq!(arm.sense(tick, &mut inputs), tick % 80 == 0, "tick {tick}");
        if tick % 80 == 0 {
            targets.push([inputs[0], inputs[1]]);
            assert!(inputs[0].hypot(inputs[1] + 1.0) <= 2.0);
        }
    }
    targets.dedup();
    assert_eq!(targets.len(), 10);
    // The sequence is a function of the tick: a plant that was late has the same target.
    let mut late = Arm::new(&ArmConfig::default(), 0.05, 1);
    assert!(late.sense(790, &mut inputs));
    assert_eq!([inputs[0], inputs[1]], targets[9]);
}

#[test]
fn a_blocked_joint_does_not_move_and_costs_no_speed() {
    let config = ArmConfig { block: vec![BlockConfig { joint: 3, tick: 2, angle: 0.25 }], ..Default::default() };
    let mut arm = Arm::new(&config, 0.05, 1);
    let command = [0.01; 4];
    for tick in 0..4 {
        arm.advance(tick, &command);
        let expected = if tick < 2 { 0.1 * PI * (tick + 1) as f32 } else { 0.25 };
        assert!((arm.angles()[2] - expected).abs() < 1e-6, "tick {tick}");
    }
    assert!((noise_share(&config, 0.003, 0) - 0.0355).abs() < 1e-4);
    assert!((noise_share(&config, 0.003, 2) / noise_share(&config, 0.003, 0) - 0.75).abs() < 1e-12);
}

/// The other reading of the reward: the command of a blocked joint costs what it would cost if the joint turned.
#[test]
fn the_command_of_a_blocked_joint_pays_where_it_is_wanted() {
    let block = vec![BlockConfig { joint: 3, tick: 0, angle: 0.25 }];
    let reward = ArmRewardConfig { blocked_pays: true, ..Default::default() };
    let usual = ArmConfig { block, ..Default::default() };
    let paying = ArmConfig { reward, ..usual.clone() };
    let rewards = |third: f32| [&usual, &paying].map(|config| step(config, [0.01, 0.0, third, 0.0]));
    let [[free, same], [usual_, paid]] = [rewards(0.0), rewards(0.02)];
    assert_eq!([free, free], [same, usual_], "nothing asked, nothing paid");
    let cost = 0.1 * 0.025 * (0.02 * 200.0 * PI).powi(2);
    assert!((free - paid - cost).abs() < 1e-6, "{free} {paid} {cost}");
    assert_eq!(noise_share(&paying, 0.003, 0), noise_share(&ArmConfig::default(), 0.003, 0));
}

/// The reward of a first tick.
fn step(config: &ArmConfig, command: [f32; 4]) -> f32 {
    let mut arm = Arm::new(config, 0.05, 1);
    arm.sense(0, &mut [0.0; 6]);
    arm.advance(0, &command).reward
}

proptest! {
    #[test]
    fn angles_stay_wrapped(commands in proptest::collection::vec(-0.05_f32..0.05, 4..400)) {
        let mut arm = Arm::new(&ArmConfig::default(), 0.05, 1);
        for (tick, command) in commands.chunks_exact(4).enumerate() {
            let outcome = arm.advance(tick as u64, command);
            prop_assert!(outcome.reward <= 0.0);
            // In single precision the upper end can be reached but not exceeded.
            prop_assert!(arm.angles().iter().all(|t| (-PI..=PI).contains(t)));
        }
    }
}

/// A command that turns a joint by `angle` in a tick of 50 ms.
fn turning(angle: f32) -> f32 {
    angle / (10.0 * PI)
}

#[test]
fn relative_angles_add_up_along_the_arm() {
    let config = ArmConfig { angles: Angles::Relative, ..Default::default() };
    let mut arm = Arm::new(&config, 0.05, 1);
    // Up, right, up, left: directions 90, 0, 90 and 180 degrees, from (0, -1).
    let quarter = turning(PI / 2.0);
    let outcome = arm.advance(0, &[quarter, -quarter, quarter, quarter]);
    let [x, y] = arm.end();
    assert!(x.abs() < 1e-6 && y.abs() < 1e-6, "{x} {y}");
    assert_eq!(outcome.measures[1..3], [x, y]);
    // The same commands give different postures as relative and as absolute angles.
    for (angles, x) in [(Angles::Relative, -1.0), (Angles::Absolute, 1.0)] {
        let mut arm = Arm::new(&ArmConfig { angles, ..Default::default() }, 0.05, 1);
        arm.advance(0, &[quarter, 0.0, quarter, 0.0]);
        assert!((arm.end()[0] - x).abs() < 1e-6 && arm.end()[1].abs() < 1e-6, "{:?}", arm.end());
    }
}

#[test]
fn a_limited_joint_stops_and_costs_only_its_actual_speed() {
    let limits = vec![[-0.5, 1.0], [-1.0, 0.25]];
    let reward = ArmRewardConfig { scale: 1.0, speed: 1.0, angle: 0.0, near: Some(1e-3), ..Default::default() };
    let config = ArmConfig { lengths: vec![1.0, 1.0], limits, reward, ..Default::default() };
    let mut arm = Arm::new(&config, 0.05, 1);
    let outcome = arm.advance(0, &[turning(0.4), turning(0.4)]);
    assert!((arm.angles()[0] - 0.4).abs() < 1e-6);
    assert_eq!(arm.angles()[1], 0.25);
    // Rates of 0.4 and 0.25 rad in 50 ms.
    assert!((outcome.reward + 8.0_f32.powi(2) + 5.0_f32.powi(2)).abs() < 1e-3, "{}", outcome.reward);
    let outcome = arm.advance(1, &[0.0, turning(0.4)]);
    assert_eq!((arm.angles()[1], outcome.reward), (0.25, 0.0), "at the stop nothing moves");
    // More than a turn in the other direction ends at the other stop: limited angles do not wrap.
    arm.advance(2, &[turning(-7.0), turning(-7.0)]);
    assert_eq!(arm.angles(), [-0.5, -1.0]);
}

#[test]
fn with_near_the_error_counts_only_close_to_the_target() {
    let reward = ArmRewardConfig { scale: 2.0, speed: 0.0, angle: 0.0, near: Some(0.5), ..Default::default() };
    for (target, expected) in [([2.0, -1.0], 0.5), ([2.0, -0.7], 2.0 * (0.25 - 0.09)), ([2.0, -0.4], 0.0)] {
        let config =
            ArmConfig { arena: [-2.0, 2.0], targets: vec![target], reward: reward.clone(), ..Default::default() };
        let mut arm = Arm::new(&config, 0.05, 1);
        arm.sense(0, &mut [0.0; 6]);
        let outcome = arm.advance(0, &[0.0; 4]);
        assert!((f64::from(outcome.reward) - expected).abs() < 1e-6, "{target:?}: {}", outcome.reward);
        assert!((f64::from(outcome.measures[0]) - (target[1] + 1.0)).abs() < 1e-6, "the error is measured everywhere");
    }
}

#[test]
fn crossing_segments_cost_by_the_pair() {
    let reward = ArmRewardConfig { scale: 0.5, speed: 0.0, collision: 0.3, ..Default::default() };
    let bent = [0.0, PI / 2.0, PI, -PI / 2.0].map(turning);
    let config = ArmConfig { lengths: vec![0.5, 0.5, 0.4, 0.75], ..Default::default() };
    let free = ArmConfig { reward: ArmRewardConfig { collision: 0.0, ..reward.clone() }, ..config.clone() };
    let punished = ArmConfig { reward, ..config };
    let [free, punished] = [free, punished].map(|config| Arm::new(&config, 0.05, 1).advance(0, &bent));
    assert_eq!((free.measures[3], punished.measures[3]), (0.0, 1.0));
    assert!((free.reward - punished.reward - 0.15).abs() < 1e-6);
    let straight = Arm::new(&ArmConfig::default(), 0.05, 1).advance(0, &[0.0; 4]);
    assert_eq!(straight.measures[3], 0.0);
}

#[test]
fn in_an_open_loop_a_command_is_a_posture() {
    let config = ArmConfig { open_loop: true, target_every: 1, gain: 20.0, ..Default::default() };
    let mut arm = Arm::new(&config, 0.05, 1);
    let mut targets = Vec::new();
    for tick in 0..10 {
        let mut inputs = [7.0; 6];
        assert!(arm.sense(tick, &mut inputs), "a new target every tick");
        assert_eq!(inputs[2..], [7.0; 4], "only the target is sensed");
        targets.push([inputs[0], inputs[1]]);
        let posture = [0.1 * tick as f32, -1.5, 0.5, 3.5];
        let outcome = arm.advance(tick, &posture);
        // Independent of the posture before; 3.5 rad wraps to 3.5 less a turn.
        let expected = [posture[0], -1.5, 0.5, 3.5 - 2.0 * PI];
        assert!(arm.angles().iter().zip(expected).all(|(a, e)| (a - e).abs() < 1e-5), "{:?}", arm.angles());
        let [x, y] = arm.end();
        assert!((outcome.measures[0] - (x - inputs[0]).hypot(y - inputs[1])).abs() < 1e-5);
    }
    targets.dedup();
    assert_eq!(targets.len(), 10);
}

#[test]
fn a_segment_changes_its_length_and_later_targets_are_within_reach() {
    let shorten = |segment, tick, length| ShortenConfig { segment, tick, length };
    // Deliberately not in order of ticks.
    let shorten = vec![shorten(4, 200, 0.01), shorten(1, 100, 0.01), shorten(2, 100, 0.01), shorten(1, 300, 1.0)];
    let config = ArmConfig { shorten, ..Default::default() };
    let mut arm = Arm::new(&config, 0.05, 1);
    let mut other = Arm::new(&ArmConfig::default(), 0.05, 1);
    let (mut inputs, mut same) = ([0.0; 6], [0.0; 6]);
    let mut far = Vec::new();
    for tick in 0..800 {
        arm.sense(tick, &mut inputs);
        other.sense(tick, &mut same);
        arm.advance(tick, &[0.0; 4]);
        let expected = match tick {
            0..100 => 2.0,
            100..200 => 1.02,
            200..300 => 0.53,
            _ => 1.52,
        };
        assert!((arm.end()[0] - expected).abs() < 1e-6, "tick {tick}: {}", arm.end()[0]);
        if tick < 160 {
            assert_eq!(inputs, same, "the current target does not change");
        }
        if tick % 80 == 0 {
            far.push(inputs[0].hypot(inputs[1] + 1.0));
        }
    }
    assert!(far[2] <= 1.02 && far[3] <= 0.53 && far[4..].iter().all(|f| *f <= 1.52), "{far:?}");
    // The sequence is a function of the tick here, too.
    let mut late = Arm::new(&config, 0.05, 1);
    let mut late_inputs = [0.0; 6];
    late.sense(799, &mut late_inputs);
    assert_eq!(late_inputs[..2], inputs[..2]);
}

#[test]
fn a_mirror_changes_only_the_reported_target() {
    let mirror = |axis, tick| MirrorConfig { axis, tick };
    let mirror = vec![mirror(MirrorAxis::X, 1), mirror(MirrorAxis::Y, 2), mirror(MirrorAxis::X, 3)];
    let config = ArmConfig { mirror, ..Default::default() };
    let (mut arm, mut plain) = (Arm::new(&config, 0.05, 1), Arm::new(&ArmConfig::default(), 0.05, 1));
    let (mut inputs, mut same) = ([0.0; 6], [0.0; 6]);
    for (tick, [x, y]) in [(0, [1.0, 1.0]), (1, [-1.0, 1.0]), (2, [-1.0, -1.0]), (3, [1.0, -1.0]), (100, [1.0, -1.0])] {
        arm.sense(tick, &mut inputs);
        plain.sense(tick, &mut same);
        assert_eq!(inputs[..2], [x * same[0], y * same[1]], "tick {tick}");
        assert_eq!(arm.target(), [same[0], same[1]]);
        assert_eq!(arm.advance(tick, &[0.01; 4]), plain.advance(tick, &[0.01; 4]), "the outcome is the same");
    }
}

proptest! {
    #[test]
    fn for_any_commands_angles_stay_within_limits_and_rewards_are_finite(
        commands in proptest::collection::vec(-1e6_f32..1e6, 3..300),
        ends in proptest::array::uniform3((-3.1_f64..-0.001, 0.0_f64..3.1)),
        relative in any::<bool>(),
        open_loop in any::<bool>(),
    ) {
        let limits: Vec<_> = ends.iter().map(|&(low, high)| [low, high]).collect();
        let config = ArmConfig {
            lengths: vec![0.7, 0.7, 0.6],
            angles: if relative { Angles::Relative } else { Angles::Absolute },
            limits: limits.clone(),
            open_loop,
            target_every: 1,
            reward: ArmRewardConfig { collision: 1.0, near: Some(0.3), ..Default::default() },
            ..Default::default()
        };
        let mut arm = Arm::new(&config, 0.05, 1);
        let mut inputs = [0.0; 5];
        for (tick, command) in commands.chunks_exact(3).enumerate() {
            arm.sense(tick as u64, &mut inputs);
            let outcome = arm.advance(tick as u64, command);
            prop_assert!(outcome.reward.is_finite() && outcome.measures.iter().all(|m| m.is_finite()));
            for (theta, [low, high]) in arm.angles().iter().zip(&limits) {
                prop_assert!((*low as f32..=*high as f32).contains(theta), "{theta} of {low} to {high}");
            }
        }
    }
}
