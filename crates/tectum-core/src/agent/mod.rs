//! Agents: whatever decides on the commands of a run, and learns from their results, as pure computation.
//!
//! An agent knows no clock, no transport and no files. In each tick the runtime calls, in this order:
//!
//! 1. [`Agent::learn`] with the [`Experience`] of the tick before: what was answered, what was applied, the reward;
//! 2. [`Agent::act`] with the [`Percept`] of this tick; the answer is sent at once;
//! 3. [`Agent::improve`], for whatever takes longer and need not be done before the command is sent.
//!
//! The runtime decides what may be learned from, and says why not ([`Withheld`]); it also looks after everything that
//! is not learning: missing and late samples, limits, log, crash recovery, checkpoints and replay. For the last three
//! an agent lists its state ([`Persist`]): a controller that was killed continues from the saved state, and a replay
//! gives the same commands only if the agent is a function of its state and of what it is called with. So randomness
//! comes from [seeded streams](crate::seed), and nothing in an agent depends on time.
//!
//! [`LinearAgent`] is the agent of the learning rules in [`crate::learner`], [`ModelPredictiveAgent`] that of the
//! model-predictive learner. [`ShippedAgent`] is the one of the two that a scenario names.

mod linear;
mod model_predictive;
mod shipped;

pub use linear::LinearAgent;
pub use model_predictive::ModelPredictiveAgent;
pub use shipped::ShippedAgent;

use crate::flag;
use crate::plant::MAX_JOINTS;
use crate::policy::LinearPolicy;
use crate::state::{self, Persist};

/// Number of an agent's own columns in the learning record.
pub const MAX_COLUMNS: usize = 8;

/// What an agent perceives at the beginning of a tick.
#[derive(Debug, Clone, Copy)]
pub struct Percept<'a> {
    /// The tick.
    pub tick: u64,
    /// The inputs, in the scenario's order and units. All are finite.
    pub inputs: &'a [f32],
    /// Age of the inputs, ticks: 0 unless the plant could not be read and repeats what it sensed before.
    pub age: u32,
    /// Flags of the observation ([`crate::flag`]), such as [`flag::NEW_TARGET`].
    pub flags: u32,
}

/// The answer to a percept, filled in by the agent. Both lists have an entry for each output.
#[derive(Debug)]
pub struct Answer<'a> {
    /// The command. It begins as zeros. A number that is not finite makes the whole command zero.
    pub command: &'a mut [f32],
    /// The command without exploration noise, for the log and for tests of what was learned. It begins as NaN: an agent
    /// that leaves it so says that nothing of the command is exploration.
    pub mean: &'a mut [f32],
}

/// How an experience ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Boundary {
    /// The next inputs follow from these ones.
    #[default]
    None,
    /// The next inputs have a new target. The reward still belongs to the target before.
    NewTarget,
    /// The episode has ended, and the value after it is zero. The next inputs belong to another episode.
    Terminated,
    /// The episode was cut off, and the value after it is unknown. The next inputs belong to another episode.
    Truncated,
}

impl Boundary {
    /// The boundary that an observation's `flags` state. An episode's end comes before a new target, and
    /// [`Boundary::Terminated`] before [`Boundary::Truncated`].
    pub fn of(flags: u32) -> Self {
        if flags & flag::TERMINATED != 0 {
            Self::Terminated
        } else if flags & flag::TRUNCATED != 0 {
            Self::Truncated
        } else if flags & flag::NEW_TARGET != 0 {
            Self::NewTarget
        } else {
            Self::None
        }
    }

    /// Whether the episode ends.
    pub fn ends_episode(self) -> bool {
        matches!(self, Self::Terminated | Self::Truncated)
    }
}

/// Why nothing may be learned from an experience: its reward is not the result of the agent's command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Withheld {
    /// The observation is the first of its plant, and its reward belongs to no tick.
    First,
    /// The command did not arrive in time. The plant held the last one, let it decay, or stood still.
    Missed,
    /// The plant passed over ticks.
    Skipped,
    /// Observations are missing between the command and this reward.
    Lost,
    /// The hardware was not driven: torque was off.
    NotDriven,
    /// The plant could not be read.
    Blind,
    /// What was applied cannot come from the agent's command: it was corrupted on its way.
    Corrupted,
    /// The next inputs or the reward are not numbers.
    Invalid,
}

impl Withheld {
    /// The reason that an observation's `flags` state, if any.
    pub fn of(flags: u32) -> Option<Self> {
        const NONE: u32 = flag::FIRST | flag::MISSED | flag::SKIPPED | flag::UNARMED | flag::TRIPPED | flag::BLIND;
        if flags & NONE == 0 {
            return None;
        }
        Some(match flags {
            flags if flags & flag::FIRST != 0 => Self::First,
            flags if flags & (flag::UNARMED | flag::TRIPPED) != 0 => Self::NotDriven,
            flags if flags & flag::BLIND != 0 => Self::Blind,
            flags if flags & flag::SKIPPED != 0 => Self::Skipped,
            _ => Self::Missed,
        })
    }
}

/// What became of an agent's last command.
#[derive(Debug, Clone, Copy)]
pub struct Experience<'a> {
    /// The tick of the command.
    pub tick: u64,
    /// The inputs that it answered.
    pub inputs: &'a [f32],
    /// The command as the agent gave it.
    pub asked: &'a [f32],
    /// The command as it was applied.
    pub applied: &'a [f32],
    /// Whether the gate limited it; `applied` then differs from `asked`.
    pub limited: bool,
    /// The reward of the tick.
    pub reward: f32,
    /// The inputs of the next tick: those of the percept that follows.
    pub next_inputs: &'a [f32],
    /// Whether a new target or a new episode begins with the next inputs.
    pub boundary: Boundary,
    /// Why nothing may be learned from it; `None` if it may. The other fields then say what the observation said, and
    /// `next_inputs` may hold numbers that are not finite.
    pub withheld: Option<Withheld>,
}

/// An agent's part of a learning record.
#[derive(Debug)]
pub struct AgentRecord<'a> {
    /// The exploration noise in the command of this tick, one entry for each output.
    pub noise: &'a mut [f32],
    /// The size of the last step.
    pub step: f32,
    /// Norm of what was learned: the weights.
    pub weights_norm: f32,
    /// Norm of the eligibility trace.
    pub trace_norm: f32,
    /// The agent's own columns, in the order of [`Agent::columns`].
    pub columns: [f32; MAX_COLUMNS],
}

/// Decides on commands, and learns from their results. The module's documentation has the order of calls.
///
/// No method may depend on time, on another thread, or on randomness other than a [seeded stream](crate::seed) that is
/// part of the state. In a run on the real clock, no method should allocate.
pub trait Agent: Persist {
    /// Decides on the command of a tick.
    fn act(&mut self, percept: &Percept, answer: &mut Answer);

    /// Commands for the ticks after the one in which it has just acted, without exploration noise, as far as it can
    /// tell: fills in a command for each tick, and returns the number of ticks. Called after
    /// [`act`](Self::act) where a scenario has `[link] ahead`. It must not change what the agent does from then on.
    fn look_ahead(&mut self, _commands: &mut [[f32; MAX_JOINTS]]) -> usize {
        0
    }

    /// Learns from the result of the last command, before the next one is decided, so it has to be fast. Returns
    /// whether something was learned. Called also where nothing may be learned ([`Experience::withheld`]); an agent
    /// with an eligibility trace then cuts it.
    fn learn(&mut self, _experience: &Experience) -> bool {
        false
    }

    /// Makes `updates` updates of whatever takes longer, after the command was sent. Their number follows from the
    /// ticks alone, never from the time that is left, so that a replay makes the same ones.
    fn improve(&mut self, _updates: u32) {}

    /// From now on the agent neither learns nor explores. Returns whether it looks after that by itself, as a planner
    /// does that goes on planning: it is then told what became of its commands, and improves, as before. Any other
    /// agent is only asked to act, and its mean is sent.
    fn freeze(&mut self) -> bool {
        false
    }

    /// Names of the agent's own columns in the learning record, at most [`MAX_COLUMNS`].
    fn columns(&self) -> &'static [&'static str] {
        &[]
    }

    /// Fills in the agent's part of the learning record. All of it begins as zeros.
    fn record(&self, _record: &mut AgentRecord) {}

    /// Whether learning has stopped for good, because a number was not finite.
    fn halted(&self) -> bool {
        false
    }

    /// Number of rewards that were not learned from, because the agent took them for outliers.
    fn outliers(&self) -> u64 {
        0
    }

    /// What the agent counted, by name, for the summary of a run. Asked once, at its end.
    fn counts(&self) -> Vec<(&'static str, u64)> {
        Vec::new()
    }

    /// After how many ticks the crash store gets the whole state anew; at least 1. A controller that was killed repeats
    /// fewer ticks than that, so an agent with long ticks wants it to be small, and one with a large state does not.
    fn save_every(&self) -> u64 {
        64
    }

    /// The linear policy over encoded features, if that is what the agent has. The hash of a run's result is then that
    /// of its weights, and otherwise that of the agent's whole state ([`learned_hash`]).
    fn policy(&self) -> Option<&LinearPolicy> {
        None
    }
}

/// 64-bit hash of what an agent has learned: of its policy's weights, or else of its whole state. Two runs with equal
/// hashes have learned the same.
pub fn learned_hash(agent: &mut dyn Agent) -> u64 {
    match agent.policy() {
        Some(policy) => policy.hash(),
        None => state::hash(agent),
    }
}

impl<A: Agent + ?Sized> Persist for Box<A> {
    fn visit_state(&mut self, visitor: &mut dyn state::StateVisitor) {
        (**self).visit_state(visitor);
    }
}

impl<A: Agent + ?Sized> Agent for Box<A> {
    fn act(&mut self, percept: &Percept, answer: &mut Answer) {
        (**self).act(percept, answer);
    }

    fn look_ahead(&mut self, commands: &mut [[f32; MAX_JOINTS]]) -> usize {
        (**self).look_ahead(commands)
    }

    fn learn(&mut self, experience: &Experience) -> bool {
        (**self).learn(experience)
    }

    fn improve(&mut self, updates: u32) {
        (**self).improve(updates);
    }

    fn freeze(&mut self) -> bool {
        (**self).freeze()
    }

    fn columns(&self) -> &'static [&'static str] {
        (**self).columns()
    }

    fn record(&self, record: &mut AgentRecord) {
        (**self).record(record);
    }

    fn halted(&self) -> bool {
        (**self).halted()
    }

    fn outliers(&self) -> u64 {
        (**self).outliers()
    }

    fn counts(&self) -> Vec<(&'static str, u64)> {
        (**self).counts()
    }

    fn save_every(&self) -> u64 {
        (**self).save_every()
    }

    fn policy(&self) -> Option<&LinearPolicy> {
        (**self).policy()
    }
}

#[cfg(test)]
mod tests;
