//! The test set with arms whose optimum is known, and the order of its references.

use super::damped_least_squares::{DampingSettings, TUNED};
use super::*;
use crate::scenario::{ArmConfig, BlockConfig, MirrorAxis, MirrorConfig, Scenario, ShortenConfig};

fn test_set(config: &ArmConfig) -> TestSet {
    TestSet::new(&Scenario::find("arm").unwrap().plan().unwrap(), FixedArm::at(config, 0.05, 0))
}

fn blocked() -> ArmConfig {
    ArmConfig { block: vec![BlockConfig { joint: 3, tick: 0, angle: 0.0 }], ..ArmConfig::default() }
}

/// Few starts find nearly the optimum, and take little time.
fn optimum(set: &TestSet) -> Score {
    set.optimum(3, || true).unwrap()
}

#[test]
fn references_that_know_more_have_less_loss() {
    for config in [ArmConfig::default(), blocked()] {
        let set = test_set(&config);
        let (zero, random) = (set.zero(), set.random());
        let (classical, best) = (set.damped_least_squares(), optimum(&set));
        let losses = [best.loss, classical.loss, random.loss, zero.loss];
        assert!(losses.is_sorted(), "{losses:?}");
        assert!(classical.loss < 1.1 * best.loss, "damped least squares is near the optimum: {losses:?}");
        assert!(classical.miss_m < 0.15 && best.miss_m < 0.15, "{classical:?} {best:?}");
    }
}

#[test]
fn published_optima_level_and_targets() {
    let (whole, blocked) = (test_set(&ArmConfig::default()), test_set(&blocked()));
    // With many starts the optima are 0.01926 and 0.02431.
    let (best, worse) = (optimum(&whole).loss, optimum(&blocked).loss);
    assert!((0.0192..0.0196).contains(&best), "{best}");
    assert!((0.0242..0.0248).contains(&worse), "{worse}");
    assert!(best < LEVEL && worse < LEVEL && LEVEL < whole.random().loss);
    assert_eq!(whole.targets().len(), TARGETS);
    assert!(whole.targets().iter().all(|[x, y]| x.hypot(y + 1.0) <= 2.0));
}

#[test]
fn a_policy_with_zero_weights_scores_as_zero_commands() {
    let set = test_set(&ArmConfig::default());
    assert_eq!(set.score_agent(&set.plan.agent()), set.zero());
}

#[test]
fn the_optimum_equals_an_exhaustive_search() {
    // One joint, one target, three ticks: all turns in steps of 0.02 rad, compared with the planner.
    let config = ArmConfig { lengths: vec![0.8], base: [0.0, 0.0], ..ArmConfig::default() };
    let (arm, target) = (FixedArm::at(&config, 0.05, 0), [0.2, 0.7]);
    let tick = |angle: f64, turn: f64| {
        let error = (0.8 * angle.cos() - target[0]).powi(2) + (0.8 * angle.sin() - target[1]).powi(2);
        0.1 * (error + 0.025 * (turn / 0.05).powi(2) + 0.01 * angle * angle)
    };
    let mut least = f64::INFINITY;
    let angle = |i: i32| f64::from(i) * 0.02;
    for i in -150..150 {
        for j in -150..150 {
            let two = tick(angle(i), angle(i)) + tick(angle(j), angle(j - i));
            if two < least {
                let best = (-150..150).map(|k| two + tick(angle(k), angle(k - j))).fold(least, f64::min);
                least = best;
            }
        }
    }
    let found = trajectory_optimum(&arm, &[target], 3, 10, || true).unwrap().loss;
    let tried = least / 3.0;
    assert!(found <= tried && tried - found < 1e-4, "{found} {tried}");
}

#[test]
fn an_arm_that_cannot_move_has_the_loss_of_zero_commands() {
    let block = (1..=4).map(|joint| BlockConfig { joint, tick: 0, angle: 0.3 }).collect();
    let config = ArmConfig { block, ..ArmConfig::default() };
    let set = test_set(&config);
    let (best, zero) = (optimum(&set), set.zero());
    assert!((best.loss - zero.loss).abs() < 1e-5 && (best.miss_m - zero.miss_m).abs() < 1e-5, "{best:?} {zero:?}");
}

#[test]
fn damped_least_squares_reaches_most_targets() {
    let set = test_set(&ArmConfig::default());
    let controller = DampedLeastSquares::new(&set.arm);
    let (mut tick, mut ends) = (0, Vec::new());
    set.drive(|&TestPercept { inputs, .. }| {
        let angles: f64 = inputs[2..].iter().map(|a| f64::from(a * a)).sum();
        assert!(angles.is_finite());
        tick += 1;
        if tick % 80 == 0 {
            let mut end = [0.0, -1.0];
            for angle in &inputs[2..] {
                end = [end[0] + 0.5 * f64::from(*angle).cos(), end[1] + 0.5 * f64::from(*angle).sin()];
            }
            ends.push((end[0] - f64::from(inputs[0])).hypot(end[1] - f64::from(inputs[1])));
        }
        controller.command(inputs)
    });
    let reached = ends.iter().filter(|e| **e < 0.05).count();
    assert!(reached >= TARGETS * 3 / 4, "{ends:?}");
}

#[test]
fn halved_or_doubled_constants_are_worse() {
    let whole = test_set(&ArmConfig::default());
    let sets: Vec<TestSet> = (1..=4)
        .map(|seed| {
            let mut set = whole.clone();
            set.plan.scenario.plant.arm = Some(set.arm.with_targets(&set.arm.draw_targets(TARGETS, seed)));
            set
        })
        .collect();
    let loss = |settings: DampingSettings| -> f64 {
        let controller = DampedLeastSquares::with(&whole.arm, settings);
        sets.iter().map(|set| set.drive(|seen| controller.command(seen.inputs)).loss).sum()
    };
    let tuned = loss(TUNED);
    for factor in [0.5, 2.0] {
        for (what, other) in [
            ("approach", DampingSettings { approach: factor * TUNED.approach, ..TUNED }),
            ("damping", DampingSettings { damping: factor * TUNED.damping, ..TUNED }),
            ("posture", DampingSettings { posture: factor * TUNED.posture, ..TUNED }),
            ("bend", DampingSettings { bend: factor * TUNED.bend, ..TUNED }),
            ("turn", DampingSettings { turn: factor * TUNED.turn, ..TUNED }),
        ] {
            let other = loss(other);
            assert!(tuned < other, "{what} times {factor}: {other}, not {tuned}");
        }
    }
}

#[test]
fn a_fixed_arm_has_the_changes_up_to_its_tick() {
    let config = ArmConfig {
        block: vec![BlockConfig { joint: 3, tick: 100, angle: 0.2 }, BlockConfig { joint: 3, tick: 200, angle: 0.0 }],
        shorten: vec![ShortenConfig { segment: 2, tick: 150, length: 0.3 }],
        mirror: vec![MirrorConfig { axis: MirrorAxis::X, tick: 180 }],
        ..ArmConfig::default()
    };
    let arm = |tick| FixedArm::at(&config, 0.05, tick);
    assert_eq!(arm(99).config(), &ArmConfig::default());
    assert_eq!((arm(100).fixed()[2], arm(199).fixed()[2], arm(200).fixed()[2]), (Some(0.2), Some(0.2), Some(0.0)));
    assert_eq!(arm(200).free(), [0, 1, 3]);
    assert_eq!((arm(149).config().lengths[1], arm(150).config().lengths[1]), (0.5, 0.3));
    assert_eq!((arm(179).target(&[0.5, -0.5]), arm(180).target(&[0.5, -0.5])), ([0.5, -0.5], [-0.5, -0.5]));
}

#[test]
fn a_mirror_changes_the_inputs_and_not_the_targets() {
    let config = ArmConfig { mirror: vec![MirrorConfig { axis: MirrorAxis::X, tick: 0 }], ..ArmConfig::default() };
    let (plain, mirrored) = (test_set(&ArmConfig::default()), test_set(&config));
    assert_eq!(plain.targets(), mirrored.targets());
    assert_eq!(plain.damped_least_squares(), mirrored.damped_least_squares());
    let shown = |set: &TestSet| {
        let mut first = 0.0;
        set.drive(|seen| {
            first = seen.inputs[0];
            Outputs::default()
        });
        first
    };
    assert_eq!(shown(&plain), -shown(&mirrored));
}

#[test]
fn a_shorter_arm_gets_nearer_targets() {
    let config =
        ArmConfig { shorten: vec![ShortenConfig { segment: 2, tick: 0, length: 0.3 }], ..ArmConfig::default() };
    let set = test_set(&config);
    assert!(set.targets().iter().all(|[x, y]| x.hypot(y + 1.0) <= 1.8 + 1e-6));
    let best = optimum(&set);
    assert!(best.loss < set.damped_least_squares().loss && best.miss_m < 0.1, "{best:?}");
}
