//! Tests of the gate: each rule by itself, and, over arbitrary bits, that no limit is ever exceeded.

use super::*;
use crate::plant::{Arm, Plant as _};
use crate::scenario::{ArmConfig, PerOutput};
use proptest::prelude::*;

fn config() -> GateConfig {
    GateConfig { max_command: PerOutput::All(0.5), hold_ticks: 2, decay_ticks: 3, ..GateConfig::default() }
}

fn gate() -> Gate {
    Gate::new(&config(), 2)
}

/// A command with `u` for the first output.
fn first(u: f32) -> OutputValues {
    let mut command = [0.0; MAX_OUTPUTS];
    command[0] = u;
    command
}

/// The applied command of the first output, and the flags other than `CLAMPED` and `MISSED`.
fn pass_one(gate: &mut Gate, command: Option<f32>, joints: Option<&JointState>) -> (f32, u32) {
    let ranges = gate.command_ranges(|| joints.copied());
    let applied = gate.pass(command.map(first).as_ref(), ranges.as_ref());
    let limited = flag::STEP_LIMITED | flag::POSITION_LIMITED | flag::RAMPED;
    assert!(applied.flags & limited == 0 || applied.flags & flag::CLAMPED != 0, "{applied:?}");
    (applied.command[0], applied.flags & !(flag::CLAMPED | flag::MISSED))
}

/// A command with these two outputs.
fn two(first: f32, second: f32) -> OutputValues {
    let mut command = [0.0; MAX_OUTPUTS];
    command[..2].copy_from_slice(&[first, second]);
    command
}

#[test]
fn hold_then_decay_then_stop_and_back() {
    let mut gate = gate();
    let command = two(0.4, -0.2);
    assert_eq!(gate.pass(Some(&command), None), Applied { command, flags: 0 });
    let outputs: Vec<(f32, u32)> = (0..7)
        .map(|_| {
            let applied = gate.pass(None, None);
            (applied.command[0] / 0.4, applied.flags & !flag::MISSED)
        })
        .collect();
    let expected = [1.0, 1.0, 0.75, 0.5, 0.25, 0.0, 0.0];
    for ((share, _), expected) in outputs.iter().zip(expected) {
        assert!((share - expected).abs() < 1e-6, "{outputs:?}");
    }
    let flags: Vec<u32> = outputs.iter().map(|s| s.1).collect();
    let (h, d, s) = (flag::HELD, flag::DECAYED, flag::STOPPED);
    assert_eq!(flags, [h, h, d, d, d, s, s]);
    assert_eq!(gate.pass(Some(&command), None).flags, 0);
    assert_eq!(gate.pass(None, None).command, command, "held again after a command arrived");
}

#[test]
fn a_command_that_is_not_finite_counts_as_none() {
    let mut gate = gate();
    gate.pass(Some(&[0.1; MAX_OUTPUTS]), None);
    let applied = gate.pass(Some(&two(0.2, f32::NAN)), None);
    assert_eq!(applied.flags, flag::MISSED | flag::HELD | flag::NON_FINITE);
    assert_eq!(applied.command[0], 0.1);
}

/// The applied command of the first output, and the flags, of a tick in which no command arrives, with one ahead.
fn pass_ahead(gate: &mut Gate, u: f32, age: u32) -> (f32, u32) {
    let applied = gate.pass_or(None, Some(CommandAhead { command: first(u), age }), None);
    assert!(applied.flags & flag::MISSED != 0);
    (applied.command[0], applied.flags & !flag::MISSED)
}

#[test]
fn a_command_ahead_takes_the_place_of_a_held_one_only() {
    let (mut ahead, mut held) = (gate(), gate());
    for gate in [&mut ahead, &mut held] {
        gate.pass(Some(&first(0.4)), None);
    }
    // Both stop in the same tick, whatever came ahead.
    let mut steps = vec![];
    for age in 1..=7 {
        let flags = held.pass(None, None).flags;
        let (u, other) = pass_ahead(&mut ahead, 0.1 * age as f32, age);
        assert_eq!(other & flag::STOPPED, flags & flag::STOPPED);
        steps.push((u, other));
    }
    let (a, d, s) = (flag::AHEAD, flag::DECAYED, flag::STOPPED);
    let expected = [(0.1, a), (0.2, a), (0.15, d), (0.1, d), (0.05, d), (0.0, s), (0.0, s)];
    for ((u, flags), (expected, which)) in steps.iter().zip(expected) {
        assert!((u - expected).abs() < 1e-6 && *flags == which, "{steps:?}");
    }
    // The hold policy goes on from the command ahead, and as old as that is. One that is not finite counts as none.
    let mut gate = gate();
    gate.pass(Some(&first(0.4)), None);
    assert_eq!(pass_ahead(&mut gate, 0.3, 1), (0.3, a));
    assert_eq!(pass_ahead(&mut gate, f32::NAN, 2), (0.3, flag::HELD));
    assert_eq!(pass_ahead(&mut gate, f32::NAN, 3).1, d);
    // A newer one ends the decay, within the limit.
    assert_eq!(pass_ahead(&mut gate, 9.0, 1), (0.5, a | flag::CLAMPED));
    assert_eq!(pass_one(&mut gate, None, None), (0.5, flag::HELD));
    // A command that has arrived goes before one ahead, and one that is not finite does not.
    let with =
        |gate: &mut Gate, u| gate.pass_or(Some(&first(u)), Some(CommandAhead { command: first(0.2), age: 1 }), None);
    assert_eq!(with(&mut gate, 0.1).command[0], 0.1);
    let corrupted = with(&mut gate, f32::NAN);
    assert_eq!((corrupted.command[0], corrupted.flags), (0.2, flag::MISSED | a | flag::NON_FINITE));
}

#[test]
fn commands_ahead_are_ramped() {
    let mut gate = Gate::new(&GateConfig { ramp_ticks: 3, ..config() }, 2);
    let (a, limited) = (flag::AHEAD, flag::AHEAD | flag::CLAMPED | flag::RAMPED);
    let steps = [1, 1, 2, 1].map(|age| pass_ahead(&mut gate, 0.5, age));
    assert_eq!(steps, [(0.125, limited), (0.25, limited), (0.375, limited), (0.5, a)]);
}

#[test]
fn every_output_has_its_own_limit() {
    let mut gate = Gate::new(&GateConfig { max_command: PerOutput::Each(vec![0.5, 0.1]), ..config() }, 2);
    let applied = gate.pass(Some(&[9.0; MAX_OUTPUTS]), None);
    assert_eq!((applied.command[..3].to_vec(), applied.flags), (vec![0.5, 0.1, 0.0], flag::CLAMPED));
}

#[test]
fn steps_are_limited_also_on_the_way_to_a_stop() {
    let mut gate =
        Gate::new(&GateConfig { max_step: Some(PerOutput::All(0.125)), hold_ticks: 1, decay_ticks: 0, ..config() }, 2);
    let s = flag::STEP_LIMITED;
    let steps: Vec<_> = [Some(0.3), Some(0.3), Some(0.3)].into_iter().map(|u| pass_one(&mut gate, u, None)).collect();
    assert_eq!(steps, [(0.125, s), (0.25, s), (0.3, 0)]);
    let down: Vec<_> = (0..5).map(|_| pass_one(&mut gate, None, None)).collect();
    let (h, stop) = (flag::HELD, flag::STOPPED);
    assert_eq!(down.iter().map(|d| d.1).collect::<Vec<_>>(), [h, stop | s, stop | s, stop, stop]);
    for ((u, _), expected) in down.iter().zip([0.3, 0.175, 0.05, 0.0, 0.0]) {
        assert!((u - expected).abs() < 1e-6, "{down:?}");
    }
    // The limited command is held: the gate does not continue towards the command that it had limited.
    assert_eq!(pass_one(&mut gate, Some(0.5), None).0, 0.125);
    assert_eq!(pass_one(&mut gate, None, None), (0.125, h));
}

#[test]
fn commands_are_ramped_when_they_start_or_return() {
    let mut gate = Gate::new(&GateConfig { ramp_ticks: 3, ..config() }, 2);
    let r = flag::RAMPED;
    let ramp = [(0.125, r), (0.25, r), (0.375, r), (0.5, 0), (0.5, 0)];
    let five_commands = |gate: &mut Gate| [0.5; 5].map(|u| pass_one(gate, Some(u), None));
    assert_eq!(five_commands(&mut gate), ramp);
    // A held command does not restart the ramp.
    pass_one(&mut gate, None, None);
    assert_eq!(pass_one(&mut gate, Some(0.5), None), (0.5, 0));
    for _ in 0..3 {
        pass_one(&mut gate, None, None);
    }
    assert_eq!(five_commands(&mut gate), ramp, "a ramp after the command had begun to decay");
    for _ in 0..99 {
        pass_one(&mut gate, None, None);
    }
    assert_eq!(pass_one(&mut gate, Some(-0.1), None), (-0.1, 0), "within the ramp's share");
    assert_eq!(pass_one(&mut gate, Some(-0.5), None), (-0.25, r));
}

#[test]
fn joints_stay_within_their_limits_and_return_from_outside() {
    let config = GateConfig { positions: vec![[-1.0, 0.5], [-1.0, 1.0]], ..config() };
    let p = flag::POSITION_LIMITED;
    for (position, travel, wanted, low, high, flags) in [
        (0.0, 1.0, 0.4, 0.4, 0.4, 0),
        (0.3, 1.0, 0.4, 0.199_99, 0.2, p),
        (0.3, -1.0, -0.4, -0.2, -0.199_99, p),
        (0.3, -1.0, 0.4, 0.4, 0.4, 0),
        // A joint outside moves no further out. It moves back, but not beyond the far limit.
        (0.6, 1.0, 0.4, 0.0, 0.0, p),
        (0.6, 1.0, -0.4, -0.4, -0.4, 0),
        (0.6, 10.0, -0.4, -0.16, -0.159_99, p),
        (-7.0, 1.0, -0.4, 0.0, 0.0, p),
        // Not known: it does not move. Not moved by this output: no limit.
        (f32::NAN, 1.0, 0.4, 0.0, 0.0, p),
        (0.0, f32::INFINITY, 0.4, 0.0, 0.0, p),
        (0.0, 0.0, 0.4, 0.4, 0.4, 0),
    ] {
        let joints = JointState { position: [position; MAX_OUTPUTS], travel: [travel; MAX_OUTPUTS] };
        let (u, reported) = pass_one(&mut Gate::new(&config, 2), Some(wanted), Some(&joints));
        assert!(low <= u && u <= high && reported == flags, "{position} {travel} {wanted}: {u} {reported:x}");
    }
    assert_eq!(
        pass_one(&mut Gate::new(&config, 2), Some(0.1), None),
        (0.0, p),
        "a plant that does not report its joints"
    );
    // The position limit goes before the step limit.
    let config = GateConfig { max_step: Some(PerOutput::All(0.125)), ..config };
    let mut gate = Gate::new(&config, 2);
    let joints = |position| JointState { position: [position; MAX_OUTPUTS], travel: [1.0; MAX_OUTPUTS] };
    for _ in 0..3 {
        pass_one(&mut gate, Some(0.3), Some(&joints(-0.5)));
    }
    assert_eq!(pass_one(&mut gate, Some(0.3), Some(&joints(0.5))), (0.0, p));
}

/// An arbitrary tick: the command, if there is one, as arbitrary bits; the measured position as arbitrary bits or, more
/// often, the true position; and the age of the command if it came ahead, 0 if it arrived in time.
fn arbitrary_tick() -> impl Strategy<Value = (Option<[u32; 2]>, Option<u32>, u32)> {
    let ordinary = (-1.0_f32..1.0).prop_map(f32::to_bits);
    let bits = prop_oneof![any::<u32>(), ordinary];
    let age = prop_oneof![3 => Just(0), 1 => 1..4_u32, 1 => any::<u32>()];
    (prop::option::of(prop::array::uniform2(bits)), prop::option::weighted(0.1, any::<u32>()), age)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    /// I7 over arbitrary bits: the applied command is finite and within rate, step and ramp, and no joint moves
    /// beyond its limits.
    #[test]
    fn applied_commands_stay_within_limits(
        ticks in prop::collection::vec(arbitrary_tick(), 1..150),
        step in prop::option::of(0.01..0.6_f64),
        limits in prop::option::of((-3.0..1.0_f64, 0.01..3.0_f64)),
        travel in prop_oneof![Just(1.0_f32), -40.0_f32..40.0],
        start in -4.0_f32..4.0,
        ramp_ticks in 0..5_u32,
    ) {
        let positions = limits.map_or(Vec::new(), |(low, width)| vec![[low, low + width]; 2]);
        let config = GateConfig { max_step: step.map(PerOutput::All), positions, ramp_ticks, ..config() };
        let mut gate = Gate::new(&config, 2);
        let (mut theta, mut before) = ([start, -start], [0.0_f32; 2]);
        for (bits, measured, aged) in ticks {
            let mut command = [f32::NAN; MAX_OUTPUTS];
            if let Some(bits) = bits {
                command[..2].copy_from_slice(&bits.map(f32::from_bits));
            }
            let mut joints = JointState { position: [0.0; MAX_OUTPUTS], travel: [travel; MAX_OUTPUTS] };
            joints.position[..2].copy_from_slice(&theta);
            if let Some(measured) = measured {
                joints.position[0] = f32::from_bits(measured);
            }
            let ranges = gate.command_ranges(|| Some(joints));
            let applied = match aged {
                // What came ahead is any bits, too, and of any age.
                age @ 1.. => gate.pass_or(None, Some(CommandAhead { command, age }), ranges.as_ref()),
                0 => gate.pass(bits.map(|_| command).as_ref(), ranges.as_ref()),
            };
            prop_assert!(applied.command[2..].iter().all(|&u| u == 0.0));
            for i in 0..2 {
                let u = applied.command[i];
                prop_assert!(u.abs() <= 0.5, "{applied:?}");
                if let (Some(step), true) = (step, applied.flags & flag::POSITION_LIMITED == 0) {
                    let by = (f64::from(u) - f64::from(before[i])).abs();
                    prop_assert!(by <= f64::from(step as f32), "{by}: {applied:?}");
                }
                before[i] = u;
                let next = theta[i] + travel * u;
                // A limit can be kept only where the position is measured correctly.
                if let (Some(&[low, high]), true) = (config.positions.get(i), measured.is_none() || i == 1) {
                    let (from, to) = (f64::from(theta[i]), f64::from(next));
                    prop_assert!(to >= low.min(from) && to <= high.max(from), "{from} to {to}: {applied:?}");
                }
                theta[i] = next;
            }
        }
    }

    /// The same with an arm, whose joint angles wrap: no limit is crossed from either side, to the last bit.
    #[test]
    fn an_arm_stays_within_its_limits(
        ticks in prop::collection::vec(prop::option::of(prop::array::uniform2(-1.0_f32..1.0)), 1..150),
        low in -3.1..-0.1_f64,
        high in 0.1..3.1_f64,
        open_loop in any::<bool>(),
    ) {
        let arm = ArmConfig { lengths: vec![0.5; 2], open_loop, ..ArmConfig::default() };
        let mut arm = Arm::new(&arm, 0.05, 1);
        let mut gate = Gate::new(&GateConfig { positions: vec![[low, high]; 2], ..config() }, 2);
        for (tick, drawn) in (0..).zip(ticks) {
            let mut command = [0.0; MAX_OUTPUTS];
            drawn.iter().for_each(|drawn| command[..2].copy_from_slice(drawn));
            let ranges = gate.command_ranges(|| arm.joints());
            let applied = gate.pass(drawn.map(|_| command).as_ref(), ranges.as_ref());
            arm.advance(tick, &applied.command[..2]);
            let angles = arm.angles();
            prop_assert!(angles.iter().all(|&x| low <= f64::from(x) && f64::from(x) <= high), "{angles:?}");
        }
    }
}
