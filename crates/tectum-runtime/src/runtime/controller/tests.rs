//! Tests of credit: from which observations the controller learns.

use super::*;
use crate::scenario::Scenario;
use crate::wire::{MAX_OUTPUTS, flag};

fn controller() -> Controller {
    Controller::new(&Scenario::find("paper").unwrap().plan().unwrap())
}

fn observation(tick: u64, flags: u32) -> Observation {
    let mut observation = Observation { reward: -1.0, ..Observation::default() };
    observation.header.tick = tick;
    observation.header.flags = flags;
    observation.inputs[..6].copy_from_slice(&[0.1, -0.2, 0.3, 0.4, -0.5, 0.6]);
    observation
}

fn answer(controller: &mut Controller, observation: &Observation) -> (Command, u32) {
    let mut command = Command::default();
    controller.respond(observation, &mut command);
    (command, controller.tick.flags)
}

#[test]
fn only_rewards_of_the_policys_commands_are_learned_from() {
    for (flags, skip, expected) in [
        (0, 0, flag::LEARNED),
        (flag::NEW_TARGET, 0, flag::LEARNED),
        (flag::CLAMPED, 0, flag::LEARNED),
        (flag::CLAMPED | flag::STEP_LIMITED | flag::POSITION_LIMITED | flag::RAMPED, 0, flag::LEARNED),
        (flag::LATE, 0, flag::LEARNED),
        (flag::MISSED | flag::STOPPED | flag::CLAMPED | flag::STEP_LIMITED, 0, flag::TRACE_CUT),
        (flag::MISSED | flag::HELD, 0, flag::TRACE_CUT),
        (flag::SKIPPED, 2, flag::TRACE_CUT),
        (flag::FIRST, 0, flag::TRACE_CUT),
        (0, 1, flag::TRACE_CUT),
    ] {
        let mut controller = controller();
        assert_eq!(answer(&mut controller, &observation(0, flag::FIRST)).1, 0);
        assert_eq!(answer(&mut controller, &observation(1, 0)).1, flag::LEARNED);
        let before = controller.policy().unwrap().hash();
        assert_eq!(answer(&mut controller, &observation(2 + skip, flags)).1, expected, "flags {flags:x}");
        let learned = controller.policy().unwrap().hash() != before;
        assert_eq!(learned, expected == flag::LEARNED, "flags {flags:x}");
        if expected == flag::TRACE_CUT {
            let ShippedAgent::Linear(agent) = controller.agent() else {
                panic!("the paper's rule has a linear policy")
            };
            assert_eq!(agent.trace_norm(), 0.0);
        }
    }
}

#[test]
fn credit_goes_to_the_applied_command() {
    let mut limited = controller();
    let (command, _) = answer(&mut limited, &observation(0, flag::FIRST));
    let mut applied = observation(1, flag::CLAMPED);
    applied.applied = command.drawn;
    applied.applied[0] *= 0.5;
    let mut corrupted = limited.clone();
    let mut unlimited = limited.clone();
    assert_eq!(answer(&mut limited, &applied).1, flag::LEARNED);
    answer(&mut unlimited, &observation(1, 0));
    // The step of the paper's rule is proportional to the applied command less the mean, which is 0 at first.
    for feature in 0..limited.policy().unwrap().features() {
        let weight = |controller: &Controller, output| controller.policy().unwrap().weight(output, feature);
        let (half, whole) = (weight(&limited, 0), weight(&unlimited, 0));
        assert!((half - 0.5 * whole).abs() <= 1e-6 * whole.abs(), "{half} {whole}");
        assert_eq!(weight(&limited, 1), weight(&unlimited, 1));
    }

    // No gate could have made this from the policy's command, so the command was corrupted on its way.
    applied.applied[0] *= 3.0;
    assert_eq!(answer(&mut corrupted.clone(), &applied).1, flag::TRACE_CUT);
    // It is possible if it is limited in step from the previously applied command.
    corrupted.tick.applied_before[0] = applied.applied[0] * 1.5;
    assert_eq!(answer(&mut corrupted.clone(), &applied).1, flag::LEARNED);
    corrupted.tick.applied_before[0] = 0.0;
    assert_eq!(answer(&mut corrupted.off_policy(), &applied).1, flag::LEARNED);
}

#[test]
fn weights_stay_finite_for_any_step() {
    let mut scenario = Scenario::find("paper").unwrap();
    scenario.learner.alpha_over_variance = 1000.0;
    for reward in [-1e36, -10.0] {
        let mut controller = Controller::new(&scenario.clone().plan().unwrap()).off_policy();
        for tick in 0..400 {
            let mut observation = observation(tick, if tick == 0 { flag::FIRST } else { flag::CLAMPED });
            // The applied command stays within the gate's limits while the mean grows.
            observation.applied[..4].copy_from_slice(&[0.05; 4]);
            observation.reward = reward;
            let (command, _) = answer(&mut controller, &observation);
            controller.after_command(&observation);
            assert!(command.drawn.iter().all(|u| u.is_finite()), "{command:?}");
        }
        assert!(controller.halted() && controller.policy().unwrap().norm().is_finite(), "{reward}");
        assert!(controller.report().diverged_at.is_some());
    }
}

#[test]
fn invalid_values_are_answered_with_zero_and_not_learned_from() {
    let mut controller = controller();
    answer(&mut controller, &observation(0, flag::FIRST));
    let mut invalid = observation(1, 0);
    invalid.inputs[3] = f32::NAN;
    let (command, flags) = answer(&mut controller, &invalid);
    assert_eq!((command.drawn, command.header.flags, flags), ([0.0; MAX_OUTPUTS], flag::INVALID, flag::TRACE_CUT));
    assert_eq!(answer(&mut controller, &observation(2, 0)).1, 0, "nothing to credit after an invalid observation");
    let mut infinite_reward = observation(3, 0);
    infinite_reward.reward = f32::INFINITY;
    assert_eq!(answer(&mut controller, &infinite_reward).1, flag::TRACE_CUT);
    assert_eq!(controller.policy().unwrap().norm(), 0.0);
    assert_eq!(answer(&mut controller, &observation(4, 0)).1, flag::LEARNED);
    // The same holds for a finite value that is out of every range.
    let mut out_of_range = observation(5, 0);
    out_of_range.inputs[0] = 1e30;
    let (command, flags) = answer(&mut controller, &out_of_range);
    assert_eq!((command.drawn, command.header.flags, flags), ([0.0; MAX_OUTPUTS], flag::INVALID, flag::TRACE_CUT));
}

/// A withheld observation is answered as unheard, a late one is ignored, and no credit is taken across the gap.
#[test]
fn a_withheld_observation_is_neither_answered_nor_learned_from() {
    let mut scenario = Scenario::find("paper").unwrap();
    scenario.faults =
        toml::from_str("[[channel]]\nchannel = \"observation\"\nkind = \"delay\"\nfrom = 2\nuntil = 3\nticks = 2")
            .unwrap();
    let mut controller = Controller::new(&scenario.plan().unwrap());
    let mut clean = self::controller();
    for tick in 0..2 {
        let observation = observation(tick, if tick == 0 { flag::FIRST } else { 0 });
        assert_eq!(answer(&mut controller, &observation), answer(&mut clean, &observation));
    }
    let (command, flags) = answer(&mut controller, &observation(2, 0));
    assert_eq!((command.header.tick, command.header.flags, flags), (2, flag::UNHEARD, 0));
    assert_eq!((command.mean, command.drawn), ([0.0; MAX_OUTPUTS], [0.0; MAX_OUTPUTS]));
    let mut learning = Learning::default();
    controller.record(&observation(2, 0), &mut learning);
    assert_eq!((learning.header.tick, learning.noise, learning.reward), (2, [0.0; MAX_OUTPUTS], 0.0));
    // The next observation arrives with one missing in between. The noise continues with the next draw.
    let norm = controller.policy().unwrap().norm();
    let (command, flags) = answer(&mut controller, &observation(3, 0));
    assert_eq!((command.header.flags, flags, controller.policy().unwrap().norm()), (0, flag::TRACE_CUT, norm));
    controller.record(&observation(3, 0), &mut learning);
    answer(&mut clean, &observation(2, 0));
    let mut drawn = Learning::default();
    clean.record(&observation(2, 0), &mut drawn);
    assert_eq!(learning.noise, drawn.noise);
    // The delayed observation arrives, too, and has no effect on this tick.
    assert_eq!(answer(&mut controller, &observation(4, 0)).1, flag::LEARNED);
    assert_eq!((controller.report().unheard, controller.report().stale, controller.report().cuts), (1, 1, 1));
}
