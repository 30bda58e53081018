//! Counts of what went on in a run, from which [`run_warnings`](super::run_warnings) judges whether it went well.
//!
//! The controller counts, because it receives the observations of any plant, after the command has been sent. The
//! counts have a fixed size, and are part of the state that survives the process.

use serde::{Deserialize, Serialize};

use crate::scenario::{Plan, limits::RANGE};
use crate::state::{Persist, StateVisitor};
use crate::wire::{MAX_INPUTS, MAX_OUTPUTS, Observation, flag};

/// How far beyond its range an input may be, as a fraction of the range: rounding is no fault.
const TOLERANCE: f64 = 1e-6;

/// Why nothing was learned from a tick, in the order of the counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NotLearned {
    /// It was the first tick of a plant.
    First,
    /// The plant passed over ticks.
    Skipped,
    /// The actuators were not enabled.
    Unarmed,
    /// The plant had stopped for safety.
    Tripped,
    /// The plant could not sense.
    Blind,
    /// Its command did not arrive in time.
    Missed,
    /// An input was not a number, or beyond any range, in this tick or the one before.
    InvalidInput,
    /// The controller did not receive the observation before.
    Unseen,
    /// The reward was not finite.
    Reward,
    /// What was applied cannot come from the controller's command: a fault of a channel.
    Foreign,
}

impl NotLearned {
    /// All causes, in the order of the counts.
    pub const ALL: [NotLearned; 10] = [
        Self::First,
        Self::Skipped,
        Self::Unarmed,
        Self::Tripped,
        Self::Blind,
        Self::Missed,
        Self::InvalidInput,
        Self::Unseen,
        Self::Reward,
        Self::Foreign,
    ];

    /// The cause in words.
    pub fn in_words(self) -> &'static str {
        match self {
            Self::First => "first tick",
            Self::Skipped => "ticks passed over",
            Self::Unarmed => "motors not enabled",
            Self::Tripped => "safety stop",
            Self::Blind => "nothing sensed",
            Self::Missed => "command missed",
            Self::InvalidInput => "input not a number",
            Self::Unseen => "observation missed",
            Self::Reward => "reward not finite",
            Self::Foreign => "fault of a channel",
        }
    }
}

/// The counts of an input.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct InputCounts {
    /// Its least value; 0 if there was none.
    pub least: f32,
    /// Its greatest value.
    pub greatest: f32,
    /// Ticks in which it was outside its declared range.
    pub outside: u64,
}

/// The counts of a run, as the controller reports them.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct RunCounts {
    /// Observations counted.
    pub observations: u64,
    /// By input.
    pub inputs: Vec<InputCounts>,
    /// By output: ticks in which the gate or the plant limited it.
    pub limited: Vec<u64>,
    /// Rewards that were finite.
    pub rewards: u64,
    /// Rewards that were not.
    pub rewards_not_finite: u64,
    /// Whether two finite rewards differed.
    pub rewards_differed: bool,
    /// By cause ([`NotLearned::ALL`]): ticks from which nothing was learned.
    pub not_learned: [u64; NotLearned::ALL.len()],
    /// Rewards that the learner left out as outliers.
    pub outliers: u64,
    /// Whether all weights were 0 at the end.
    pub weights_zero: bool,
}

/// Counts while a run goes on.
#[derive(Debug, Clone)]
pub(super) struct RunCounter {
    inputs: usize,
    outputs: usize,
    /// The declared ranges; infinite for inputs that do not exist.
    low: [f32; MAX_INPUTS],
    high: [f32; MAX_INPUTS],
    /// Values seen so far.
    least: [f32; MAX_INPUTS],
    greatest: [f32; MAX_INPUTS],
    outside: [u64; MAX_INPUTS],
    /// By input: values between these are within the declared range, and no extremes. Most ticks have no others.
    /// Empty at first, also after a restart: the next tick sets them.
    usual: [[f32; 2]; MAX_INPUTS],
    /// The command of the last observation, as the controller sent it.
    asked: [f32; MAX_OUTPUTS],
    limited: [u64; MAX_OUTPUTS],
    rewards: u64,
    rewards_not_finite: u64,
    /// Least and greatest finite reward.
    reward_range: [f32; 2],
    not_learned: [u64; NotLearned::ALL.len()],
    observations: u64,
    /// The last observation's tick, and whether an input of it was invalid.
    last_tick: Option<u64>,
    was_invalid: bool,
}

impl RunCounter {
    /// A counter for runs of `plan`.
    pub fn new(plan: &Plan) -> Self {
        let (mut low, mut high) = ([f32::NEG_INFINITY; MAX_INPUTS], [f32::INFINITY; MAX_INPUTS]);
        for (i, signal) in plan.inputs.iter().enumerate() {
            let tolerance = TOLERANCE * (signal.max - signal.min);
            (low[i], high[i]) = ((signal.min - tolerance) as f32, (signal.max + tolerance) as f32);
        }
        Self {
            inputs: plan.inputs.len(),
            outputs: plan.outputs.len(),
            low,
            high,
            least: [f32::INFINITY; MAX_INPUTS],
            greatest: [f32::NEG_INFINITY; MAX_INPUTS],
            outside: [0; MAX_INPUTS],
            usual: [[f32::INFINITY, f32::NEG_INFINITY]; MAX_INPUTS],
            asked: [0.0; MAX_OUTPUTS],
            limited: [0; MAX_OUTPUTS],
            rewards: 0,
            rewards_not_finite: 0,
            reward_range: [f32::INFINITY, f32::NEG_INFINITY],
            not_learned: [0; NotLearned::ALL.len()],
            observations: 0,
            last_tick: None,
            was_invalid: false,
        }
    }

    /// Counts an observation. `learned` states whether the controller learned from the tick before it, and `asked`
    /// is the command that it sent in answer.
    pub fn observe(&mut self, observation: &Observation, learned: bool, asked: &[f32; MAX_OUTPUTS]) {
        let flags = observation.header.flags;
        let inputs = observation.inputs[..self.inputs].iter().zip(&self.usual);
        let usual = inputs.fold(true, |all, (x, [low, high])| all & (low <= x) & (x <= high));
        let invalid = !usual && self.count_inputs(&observation.inputs);
        if flags & flag::FIRST == 0 {
            self.count_reward(observation.reward);
        }
        // A command that was missed is the hold policy's.
        if flags & (flag::CLAMPED | flag::MISSED) == flag::CLAMPED {
            let outputs = observation.applied.iter().zip(&self.asked).zip(&mut self.limited).take(self.outputs);
            outputs.for_each(|((applied, asked), count)| *count += u64::from(applied != asked));
        }
        if !learned {
            self.not_learned[self.cause(observation, invalid) as usize] += 1;
        }
        self.asked[..self.outputs].copy_from_slice(&asked[..self.outputs]);
        (self.was_invalid, self.last_tick) = (invalid, Some(observation.header.tick));
        self.observations += 1;
    }

    /// Counts the values of the inputs. Returns whether one of them is not a number, or beyond any range.
    #[cold]
    fn count_inputs(&mut self, inputs: &[f32; MAX_INPUTS]) -> bool {
        let inputs = &inputs[..self.inputs];
        for (i, &x) in inputs.iter().enumerate() {
            self.outside[i] += u64::from(x < self.low[i] || x > self.high[i]);
            self.least[i] = self.least[i].min(x);
            self.greatest[i] = self.greatest[i].max(x);
            self.usual[i] = [self.low[i].max(self.least[i]), self.high[i].min(self.greatest[i])];
        }
        inputs.iter().any(|x| x.is_nan() || f64::from(x.abs()) > RANGE)
    }

    fn count_reward(&mut self, reward: f32) {
        if reward.is_finite() {
            self.rewards += 1;
            self.reward_range = [self.reward_range[0].min(reward), self.reward_range[1].max(reward)];
        } else {
            self.rewards_not_finite += 1;
        }
    }

    /// Why nothing was learned from the tick before `observation`.
    fn cause(&self, observation: &Observation, invalid: bool) -> NotLearned {
        let flags = observation.header.flags;
        let flagged = [
            (flag::FIRST, NotLearned::First),
            (flag::SKIPPED, NotLearned::Skipped),
            (flag::UNARMED, NotLearned::Unarmed),
            (flag::TRIPPED, NotLearned::Tripped),
            (flag::BLIND, NotLearned::Blind),
            (flag::MISSED, NotLearned::Missed),
        ];
        if let Some((_, cause)) = flagged.into_iter().find(|(flag, _)| flags & flag != 0) {
            cause
        } else if invalid || self.was_invalid {
            NotLearned::InvalidInput
        } else if self.last_tick.is_none_or(|tick| tick + 1 != observation.header.tick) {
            NotLearned::Unseen
        } else if !observation.reward.is_finite() {
            NotLearned::Reward
        } else {
            NotLearned::Foreign
        }
    }

    /// The counts of the whole run. The learner left out `outliers` rewards; `weights_zero` states whether it ends
    /// without weights.
    pub fn finish(&self, outliers: u64, weights_zero: bool) -> RunCounts {
        let input = |i: usize| match self.least[i] <= self.greatest[i] {
            // As JSON has no infinities.
            true => InputCounts {
                least: self.least[i].max(f32::MIN),
                greatest: self.greatest[i].min(f32::MAX),
                outside: self.outside[i],
            },
            false => InputCounts::default(),
        };
        RunCounts {
            observations: self.observations,
            inputs: (0..self.inputs).map(input).collect(),
            limited: self.limited[..self.outputs].to_vec(),
            rewards: self.rewards,
            rewards_not_finite: self.rewards_not_finite,
            rewards_differed: self.reward_range[0] < self.reward_range[1],
            not_learned: self.not_learned,
            outliers,
            weights_zero,
        }
    }
}

impl Persist for RunCounter {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.numbers("least", &mut self.least);
        visitor.numbers("greatest", &mut self.greatest);
        visitor.numbers("outside", &mut self.outside);
        visitor.numbers("asked", &mut self.asked);
        visitor.numbers("limited", &mut self.limited);
        let mut counts = [self.rewards, self.rewards_not_finite, self.observations];
        visitor.numbers("counts", &mut counts);
        [self.rewards, self.rewards_not_finite, self.observations] = counts;
        visitor.numbers("reward_range", &mut self.reward_range);
        visitor.numbers("not_learned", &mut self.not_learned);
        visitor.optional("last_tick", &mut self.last_tick);
        visitor.boolean("was_invalid", &mut self.was_invalid);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::Scenario;

    fn observation(tick: u64, flags: u32, reward: f32) -> Observation {
        let mut o = Observation { reward, ..Observation::default() };
        (o.header.tick, o.header.flags) = (tick, flags);
        o
    }

    #[test]
    fn every_cause_is_told_apart_and_all_counts_survive_the_process() {
        let plan = Scenario::find("arm").unwrap().plan().unwrap();
        let mut counter = RunCounter::new(&plan);
        let none = &[0.0; MAX_OUTPUTS];
        counter.observe(&observation(0, flag::FIRST, 0.0), false, none);
        counter.observe(&observation(1, 0, -1.0), true, &[0.5; MAX_OUTPUTS]);
        // One output of four was limited.
        let mut limited = observation(2, flag::CLAMPED, -1.0);
        limited.applied = [0.5; MAX_OUTPUTS];
        limited.applied[2] = 0.1;
        counter.observe(&limited, true, none);
        for (tick, flags) in [flag::SKIPPED, flag::UNARMED, flag::TRIPPED, flag::BLIND, flag::MISSED].iter().enumerate()
        {
            counter.observe(&observation(3 + tick as u64, *flags, -1.0), false, none);
        }
        let mut invalid = observation(8, 0, -1.0);
        invalid.inputs[1] = f32::NAN;
        counter.observe(&invalid, false, none);
        counter.observe(&observation(9, 0, -1.0), false, none);
        counter.observe(&observation(11, 0, -1.0), false, none);
        counter.observe(&observation(12, 0, f32::NAN), false, none);
        counter.observe(&observation(13, 0, -2.0), false, none);
        let mut outside = observation(14, 0, -2.0);
        (outside.inputs[0], outside.inputs[5]) = (1.5, -4.0);
        counter.observe(&outside, true, none);

        let mut bytes = vec![0; crate::state::size(&mut counter)];
        crate::state::save(&mut counter, &mut bytes);
        let mut restored = RunCounter::new(&plan);
        assert!(crate::state::load(&mut restored, &bytes));
        let counts = restored.finish(3, true);
        assert_eq!(counts.not_learned, [1, 1, 1, 1, 1, 1, 2, 1, 1, 1]);
        assert_eq!((counts.observations, counts.rewards, counts.rewards_not_finite), (14, 12, 1));
        assert!(counts.rewards_differed && counts.weights_zero && counts.outliers == 3);
        assert_eq!(counts.limited, [0, 0, 1, 0]);
        assert_eq!(counts.inputs[0], InputCounts { least: 0.0, greatest: 1.5, outside: 1 });
        assert_eq!(counts.inputs[5], InputCounts { least: -4.0, greatest: 0.0, outside: 1 });
        assert_eq!(counts.inputs[2], InputCounts::default());
        // An angle of exactly half a turn is within its range.
        let mut counter = RunCounter::new(&plan);
        let mut edge = observation(0, flag::FIRST, 0.0);
        edge.inputs[2] = std::f32::consts::PI;
        counter.observe(&edge, false, none);
        assert_eq!(counter.finish(0, false).inputs[2].outside, 0);
    }
}
