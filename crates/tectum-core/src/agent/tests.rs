//! What the learning rules make of targets and episodes, and the state of an agent.

use tectum_encoder::Encoder;

use super::*;
use crate::learner::test_specs::arm;
use crate::learner::{LearnerConfig, LearnerSpec, Rule};
use crate::policy::Noise;
use crate::state::{load, save, size};

const RULES: [Rule; 5] =
    [Rule::Paper, Rule::Baseline, Rule::ActorCritic, Rule::NaturalActorCritic, Rule::LearnedReward];

fn agent(rule: Rule) -> LinearAgent {
    let spec = LearnerSpec { learner: LearnerConfig::preset(rule), ..arm() };
    let encoder = Encoder::new(&spec.maps, spec.normalise);
    LinearAgent::new(&spec, encoder, Noise::Gaussian)
}

/// Inputs of tick `tick`.
fn inputs(tick: u64) -> [f32; 6] {
    std::array::from_fn(|i| ((tick * 7 + i as u64 * 3) % 11) as f32 * 0.05 - 0.2)
}

/// An agent with its last command.
struct Tick {
    agent: LinearAgent,
    command: [f32; 4],
}

impl Tick {
    /// The agent of `rule` after some ticks that it has learned from.
    fn after_some(rule: Rule) -> Self {
        let mut tick = Self { agent: agent(rule), command: [0.0; 4] };
        tick.act(&inputs(0));
        for k in 1..40 {
            assert!(tick.learn(k, &inputs(k), Boundary::None, None), "{rule:?}");
            tick.act(&inputs(k));
            tick.agent.improve(1);
        }
        tick
    }

    fn act(&mut self, inputs: &[f32]) {
        let mut mean = [0.0; 4];
        let percept = Percept { tick: 0, inputs, age: 0, flags: 0 };
        self.agent.act(&percept, &mut Answer { command: &mut self.command, mean: &mut mean });
    }

    /// Learns from the tick before `tick`, whose inputs are `next`.
    fn learn(&mut self, tick: u64, next: &[f32], boundary: Boundary, withheld: Option<Withheld>) -> bool {
        self.agent.learn(&Experience {
            tick: tick - 1,
            inputs: &inputs(tick - 1),
            asked: &self.command,
            applied: &self.command,
            limited: false,
            reward: -0.1 * tick as f32 % 1.7,
            next_inputs: next,
            boundary,
            withheld,
        })
    }

    fn hash(&self) -> u64 {
        self.agent.linear_policy().hash()
    }
}

#[test]
fn a_new_target_is_learned_from_like_any_other_tick() {
    for rule in RULES {
        let (mut target, mut none) = (Tick::after_some(rule), Tick::after_some(rule));
        assert!(target.learn(40, &inputs(40), Boundary::NewTarget, None));
        assert!(none.learn(40, &inputs(40), Boundary::None, None));
        // `learned-reward` alone tells a target that jumps from a movement.
        let same = state::hash(&mut target.agent) == state::hash(&mut none.agent);
        assert_eq!(same, rule != Rule::LearnedReward, "{rule:?}");
        assert_eq!(target.agent.trace_norm(), none.agent.trace_norm());
    }
}

/// What comes after an episode belongs to another one: nothing may depend on it.
#[test]
fn the_last_tick_of_an_episode_takes_no_value_from_the_next_one() {
    for boundary in [Boundary::Terminated, Boundary::Truncated] {
        for rule in RULES {
            let (mut one, mut other) = (Tick::after_some(rule), Tick::after_some(rule));
            let before = one.hash();
            let learned = one.learn(40, &[0.3; 6], boundary, None);
            assert_eq!(other.learn(40, &[-0.5; 6], boundary, None), learned);
            assert_eq!(state::hash(&mut one.agent), state::hash(&mut other.agent), "{rule:?} {boundary:?}");
            let expected = match rule {
                Rule::LearnedReward => false,
                Rule::ActorCritic | Rule::NaturalActorCritic => boundary == Boundary::Terminated,
                _ => true,
            };
            assert_eq!((learned, one.hash() != before), (expected, expected), "{rule:?} {boundary:?}");
            if rule != Rule::LearnedReward {
                assert_eq!(one.agent.trace_norm(), 0.0, "{rule:?}");
            }
        }
    }
}

/// Within an episode the next value counts: the test above could not fail without this.
#[test]
fn a_critic_takes_the_next_value_within_an_episode() {
    let (mut one, mut other) = (Tick::after_some(Rule::ActorCritic), Tick::after_some(Rule::ActorCritic));
    one.learn(40, &[0.3; 6], Boundary::None, None);
    other.learn(40, &[-0.5; 6], Boundary::None, None);
    // The bound on a step may hide it in the policy's weights, but not in what the critic learns. Of the state only
    // the mean depends on the next inputs by itself, so it is computed for the same ones.
    for tick in [&mut one, &mut other] {
        tick.learn(41, &[0.1; 6], Boundary::None, Some(Withheld::Missed));
        tick.act(&[0.1; 6]);
    }
    assert_ne!(state::hash(&mut one.agent), state::hash(&mut other.agent));
}

#[test]
fn what_is_withheld_cuts_the_trace_and_changes_nothing_else() {
    let mut tick = Tick::after_some(Rule::Paper);
    let before = tick.hash();
    assert!(!tick.learn(40, &[f32::NAN; 6], Boundary::None, Some(Withheld::Missed)));
    assert_eq!((tick.hash(), tick.agent.trace_norm()), (before, 0.0));
}

#[test]
fn flags_give_boundary_and_reason() {
    assert_eq!(Boundary::of(flag::NEW_TARGET | flag::TRUNCATED), Boundary::Truncated);
    assert_eq!(Boundary::of(flag::TERMINATED | flag::TRUNCATED), Boundary::Terminated);
    assert_eq!(Boundary::of(flag::NEW_TARGET | flag::CLAMPED), Boundary::NewTarget);
    assert_eq!(Boundary::of(flag::LATE), Boundary::None);
    assert_eq!(Withheld::of(flag::CLAMPED | flag::NEW_TARGET), None);
    assert_eq!(Withheld::of(flag::MISSED | flag::HELD), Some(Withheld::Missed));
    assert_eq!(Withheld::of(flag::FIRST | flag::MISSED), Some(Withheld::First));
    assert_eq!(Withheld::of(flag::BLIND), Some(Withheld::Blind));
}

#[test]
fn a_restored_agent_goes_on_as_if_it_had_never_stopped() {
    for rule in RULES {
        let mut whole = Tick::after_some(rule);
        let mut bytes = vec![0; size(&mut whole.agent)];
        save(&mut whole.agent, &mut bytes);
        let mut back = Tick { agent: agent(rule), command: whole.command };
        assert!(load(&mut back.agent, &bytes));
        for tick in [&mut whole, &mut back] {
            tick.learn(40, &inputs(40), Boundary::None, None);
            tick.act(&inputs(40));
            tick.agent.improve(1);
        }
        assert_eq!(whole.command, back.command, "{rule:?}");
        assert_eq!(learned_hash(&mut whole.agent), learned_hash(&mut back.agent));
        assert_eq!(state::hash(&mut whole.agent), state::hash(&mut back.agent));
    }
}
