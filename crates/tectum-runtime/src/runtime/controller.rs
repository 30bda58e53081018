//! The controller's side of the tick: an agent behind the faults of its channel, with statistics and report.

use super::run_counts::RunCounter;
use super::statistics::FinishedStatistics;
use super::{ControllerReport, FaultyChannel, RunStatistics};
use crate::agent::{
    Agent, AgentRecord, Answer, Boundary, Experience, MAX_COLUMNS, Percept, ShippedAgent, Withheld, learned_hash,
};
use crate::checkpoint::{Checkpoint, CheckpointError};
use crate::policy::LinearPolicy;
use crate::scenario::{Plan, limits::RANGE};
use crate::simd::SimdPath;
use crate::state::{Persist, StateVisitor};
use crate::wire::{Command, Learning, MAX_INPUTS, MAX_OUTPUTS, Observation, OutputValues, flag};

/// An agent in its run: the controller's half of every tick, without clock and transport.
///
/// A tick has two parts. [`respond`](Self::respond) computes the command.
/// [`after_command`](Self::after_command) and [`record`](Self::record) follow after the command has been sent.
///
/// It tells the agent what became of its last command, and decides what may be learned from ([`Withheld`]): only the
/// reward of a command that was applied as the agent gave it, or as the gate limited it.
#[derive(Debug, Clone)]
pub struct Controller<A = ShippedAgent> {
    /// The receiving end of the observation channel, with the scenario's faults.
    observations: FaultyChannel<Observation>,
    agent: A,
    inputs: usize,
    outputs: usize,
    ticks: u64,
    hash_every: u64,
    /// Updates of the agent in a tick.
    updates: u32,
    /// The tick answered last; `None` when its command was not the agent's.
    answered: Option<u64>,
    answered_inputs: [f32; MAX_INPUTS],
    /// The agent's command for that tick.
    asked: [f32; MAX_OUTPUTS],
    /// The command applied in the tick before that command.
    applied_before: [f32; MAX_OUTPUTS],
    /// Whether every applied command is credited, also those of another policy.
    off_policy: bool,
    freeze: Freeze,
    /// Flags of the learner in this tick, and whether its command is the agent's.
    flags: u32,
    acted: bool,
    /// Observations in a row whose inputs the plant could not read.
    age: u32,
    statistics: RunStatistics,
    counter: RunCounter,
    pub(super) report: ControllerReport,
}

/// Whether the agent learns and explores.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Freeze {
    /// It does both.
    None,
    /// It does neither, and goes on planning.
    PlansOn,
    /// It is only asked to act.
    Whole,
}

/// Whether all values are finite. There is no branch per value, because they nearly always are.
fn finite(values: &OutputValues) -> bool {
    values.iter().fold(true, |all, x| all & x.is_finite())
}

/// Takes the command for its mean, where an agent has left the mean as it was: nothing of it is exploration. False if
/// the agent has not, or if the command is not finite.
#[cold]
fn take_for_mean(command: &mut Command, outputs: usize) -> bool {
    let untouched = finite(&command.drawn) && command.mean[..outputs].iter().all(|x| x.is_nan());
    if untouched {
        command.mean = command.drawn;
    }
    untouched
}

impl Controller {
    /// The controller of `plan` with its learner, which knows nothing yet.
    pub fn new(plan: &Plan) -> Self {
        Self::with_agent(plan, plan.agent())
    }

    /// The same controller for commands that another policy chose: every applied command is credited.
    pub fn off_policy(self) -> Self {
        Self { off_policy: true, ..self }
    }

    /// The same controller with its inner loops on `path` instead of the machine's best path. The numbers are
    /// the same, bit for bit.
    pub fn on(self, path: SimdPath) -> Self {
        Self { agent: self.agent.on(path), ..self }
    }
}

impl<A: Agent> Controller<A> {
    /// The controller of `plan` with an agent of its own.
    pub fn with_agent(plan: &Plan, agent: A) -> Self {
        Self {
            observations: FaultyChannel::of(plan),
            agent,
            inputs: plan.inputs.len(),
            outputs: plan.outputs.len(),
            ticks: plan.scenario.ticks,
            hash_every: plan.scenario.log.hash_every,
            updates: plan.scenario.controller.updates,
            answered: None,
            answered_inputs: [0.0; MAX_INPUTS],
            asked: [0.0; MAX_OUTPUTS],
            applied_before: [0.0; MAX_OUTPUTS],
            off_policy: false,
            freeze: Freeze::None,
            flags: 0,
            acted: false,
            age: 0,
            statistics: RunStatistics::new(plan),
            counter: RunCounter::new(plan),
            report: ControllerReport::default(),
        }
    }

    /// From now on the agent neither learns nor explores: its mean is the command ([`Agent::freeze`]).
    pub fn freeze(&mut self) {
        self.freeze = if self.agent.freeze() { Freeze::PlansOn } else { Freeze::Whole };
        self.report.frozen = true;
    }

    /// Restores what an agent has learned in another run, up to the tick of `checkpoint`. It learns nothing from the
    /// step from that run to this one: its eligibility trace is cut.
    ///
    /// # Errors
    /// When the checkpoint holds the state of another agent; this one must then not be used.
    pub fn start_from(&mut self, checkpoint: &Checkpoint) -> Result<(), CheckpointError> {
        checkpoint.restore_agent(&mut self.agent)?;
        self.agent.learn(&Experience {
            tick: 0,
            inputs: &self.answered_inputs[..self.inputs],
            asked: &self.asked[..self.outputs],
            applied: &self.applied_before[..self.outputs],
            limited: false,
            reward: 0.0,
            next_inputs: &self.answered_inputs[..self.inputs],
            boundary: Boundary::Truncated,
            withheld: Some(Withheld::First),
        });
        self.report.started_from = Some(checkpoint.facts.tick);
        Ok(())
    }

    /// Learns from the observation's reward and computes the command for its inputs: mean, drawn output, tick
    /// and flags.
    ///
    /// Credit goes to the applied command. When the command was not applied at all, or observations are missing in
    /// between, nothing may be learned. An observation with a value that is not finite, or beyond any range that a
    /// scenario may have, is answered with zero. The scenario's faults act on the observation first. When they leave
    /// no observation of this tick, the command has the flag [`flag::UNHEARD`].
    pub fn respond(&mut self, observation: &Observation, command: &mut Command) {
        if self.observations.is_fault_free() {
            return self.answer(observation, command);
        }
        let tick = observation.header.tick;
        let mut received = None;
        let stale = &mut self.report.stale;
        self.observations.pass(tick, Some(observation), |o| match o.header.tick == tick {
            true => received = Some(*o),
            false => *stale += 1,
        });
        match received {
            Some(received) => self.answer(&received, command),
            None => self.answer_unheard(tick, command),
        }
    }

    /// The command for a tick without an observation. The last command of the agent stays recorded: when the
    /// next observation arrives, one is missing in between.
    fn answer_unheard(&mut self, tick: u64, command: &mut Command) {
        self.report.unheard += 1;
        (self.flags, self.acted) = (0, false);
        (command.header.tick, command.header.flags) = (tick, flag::UNHEARD);
        (command.mean, command.drawn) = ([0.0; MAX_OUTPUTS], [0.0; MAX_OUTPUTS]);
    }

    /// Learns from an observation and computes the command for it.
    fn answer(&mut self, observation: &Observation, command: &mut Command) {
        let tick = observation.header.tick;
        let inputs = &observation.inputs[..self.inputs];
        // A NaN fails the comparison, too. There is no branch per value, because they are nearly always valid.
        let invalid = !inputs.iter().fold(true, |all, x| all & (f64::from(x.abs()) <= RANGE));
        self.age = if observation.header.flags & flag::BLIND == 0 { 0 } else { self.age.saturating_add(1) };
        self.learn(observation, invalid);
        // Whole arrays: copies of a fixed size are a few instructions.
        self.applied_before = observation.applied;

        command.header.tick = tick;
        command.header.flags = 0;
        (command.mean, command.drawn) = ([0.0; MAX_OUTPUTS], [0.0; MAX_OUTPUTS]);
        let (mean, drawn) = (&mut command.mean[..self.outputs], &mut command.drawn[..self.outputs]);
        if invalid {
            self.answered = None;
            self.acted = false;
            command.header.flags = flag::INVALID;
            self.report.invalid += 1;
            return;
        }
        self.answered_inputs = observation.inputs;
        (self.answered, self.acted) = (Some(tick), true);
        let percept = Percept { tick, inputs, age: self.age, flags: observation.header.flags };
        mean.fill(f32::NAN);
        self.agent.act(&percept, &mut Answer { command: drawn, mean });
        let sound = finite(&command.mean) && finite(&command.drawn) || take_for_mean(command, self.outputs);
        if !sound {
            (command.mean, command.drawn) = ([0.0; MAX_OUTPUTS], [0.0; MAX_OUTPUTS]);
            (self.answered, self.acted) = (None, false);
            self.flags |= flag::DIVERGED;
            command.header.flags = flag::DIVERGED;
            self.report.diverged_at.get_or_insert(tick);
        }
        if self.freeze != Freeze::None {
            command.drawn = command.mean;
        }
        self.asked = command.drawn;
    }

    /// Answers an observation of a test: the agent's mean, without exploration noise. The agent decides and learns
    /// nothing, and nothing is counted; its state is to be put back after the test. Faults of the channel do not act.
    pub(super) fn answer_test(&mut self, observation: &Observation, command: &mut Command) {
        let (header, inputs) = (&observation.header, &observation.inputs[..self.inputs]);
        (command.header.tick, command.header.flags) = (header.tick, 0);
        (command.mean, command.drawn) = ([0.0; MAX_OUTPUTS], [0.0; MAX_OUTPUTS]);
        let (mean, drawn) = (&mut command.mean[..self.outputs], &mut command.drawn[..self.outputs]);
        mean.fill(f32::NAN);
        let percept = Percept { tick: header.tick, inputs, age: 0, flags: header.flags };
        self.agent.act(&percept, &mut Answer { command: drawn, mean });
        if !finite(&command.mean) && !take_for_mean(command, self.outputs) {
            command.mean = [0.0; MAX_OUTPUTS];
            command.header.flags = flag::DIVERGED;
        }
        command.drawn = command.mean;
    }

    /// Whether a gate could have made `applied` from the agent's command. The limits of size, ramp and
    /// position move a command towards zero, and the step limit moves it towards the previously applied one, so
    /// it must lie between these. Otherwise the gate limited a corrupted command.
    fn gate_could_apply(&self, applied: &[f32]) -> bool {
        self.asked.iter().zip(&self.applied_before).zip(applied).all(|((&asked, &before), &applied)| {
            let (low, high) = (asked.min(before).min(0.0), asked.max(before).max(0.0));
            low <= applied && applied <= high
        })
    }

    /// Why nothing may be learned from the observation's reward, if the agent answered tick `answered` last.
    fn withheld(&self, observation: &Observation, answered: u64, invalid: bool) -> Option<Withheld> {
        let flags = observation.header.flags;
        if let Some(why) = Withheld::of(flags) {
            return Some(why);
        }
        if observation.header.tick != answered + 1 {
            return Some(Withheld::Lost);
        }
        let limited = flags & flag::CLAMPED != 0;
        if limited && !self.off_policy && !self.gate_could_apply(&observation.applied[..self.outputs]) {
            return Some(Withheld::Corrupted);
        }
        (invalid || !observation.reward.is_finite()).then_some(Withheld::Invalid)
    }

    /// Hands the result of the last command to the agent.
    fn learn(&mut self, observation: &Observation, invalid: bool) {
        self.flags = 0;
        let Some(answered) = self.answered.filter(|_| self.freeze != Freeze::Whole) else { return };
        let flags = observation.header.flags;
        let experience = Experience {
            tick: answered,
            inputs: &self.answered_inputs[..self.inputs],
            asked: &self.asked[..self.outputs],
            applied: &observation.applied[..self.outputs],
            limited: flags & flag::CLAMPED != 0,
            reward: observation.reward,
            next_inputs: &observation.inputs[..self.inputs],
            boundary: Boundary::of(flags),
            withheld: self.withheld(observation, answered, invalid),
        };
        let learned = self.agent.learn(&experience);
        if self.freeze != Freeze::None {
            return;
        }
        if learned {
            self.flags = flag::LEARNED;
            self.report.learned += 1;
        } else if experience.withheld.is_some() || experience.boundary.ends_episode() {
            self.flags = flag::TRACE_CUT;
            self.report.cuts += 1;
        }
    }

    /// The work after the command has been sent: improves the agent, and adds the observation to the
    /// statistics.
    pub fn after_command(&mut self, observation: &Observation) {
        if self.freeze != Freeze::Whole {
            self.agent.improve(self.updates);
        }
        if self.agent.halted() {
            self.report.diverged_at.get_or_insert(observation.header.tick);
        }
        self.statistics.observe(observation);
        self.counter.observe(observation, self.flags & flag::LEARNED != 0, &self.asked);
        self.report.ticks += 1;
    }

    /// Fills the learning record of the last answered tick.
    pub fn record(&mut self, observation: &Observation, learning: &mut Learning) {
        let tick = observation.header.tick;
        let hashed = tick.is_multiple_of(self.hash_every) || tick + 1 == self.ticks;
        let learned = self.flags & flag::LEARNED != 0;
        learning.header.tick = tick;
        let halted = if self.agent.halted() { flag::DIVERGED } else { 0 };
        learning.header.flags = self.flags | halted | if hashed { flag::HASHED } else { 0 };
        let noise = &mut learning.noise[..self.outputs];
        noise.fill(0.0);
        let mut record =
            AgentRecord { noise, step: 0.0, weights_norm: 0.0, trace_norm: 0.0, columns: [0.0; MAX_COLUMNS] };
        self.agent.record(&mut record);
        if !self.acted || self.freeze != Freeze::None {
            record.noise.fill(0.0);
        }
        learning.step = if learned { record.step } else { 0.0 };
        learning.weights_norm = record.weights_norm;
        learning.trace_norm = record.trace_norm;
        learning.columns = record.columns;
        learning.reward = if learned { observation.reward } else { 0.0 };
        learning.weights_hash = if hashed { learned_hash(&mut self.agent) } else { 0 };
    }

    /// The current policy, if the agent has a linear one.
    pub fn policy(&self) -> Option<&LinearPolicy> {
        self.agent.policy()
    }

    /// The agent.
    pub fn agent(&self) -> &A {
        &self.agent
    }

    pub(super) fn agent_mut(&mut self) -> &mut A {
        &mut self.agent
    }

    /// Whether the agent has stopped learning because of a number that is not finite.
    pub fn halted(&self) -> bool {
        self.agent.halted()
    }

    /// The current statistics.
    pub fn statistics(&self) -> &RunStatistics {
        &self.statistics
    }

    /// Ends the run and returns the report, with the hash of what was learned.
    pub fn finish(self) -> ControllerReport {
        self.finish_with_agent().0
    }

    /// Like [`finish`](Self::finish), and gives the agent back.
    pub fn finish_with_agent(mut self) -> (ControllerReport, A) {
        let weights_hash = format!("{:016x}", learned_hash(&mut self.agent));
        let FinishedStatistics { windows, first_switch, last_switch, targets } =
            self.statistics.finish(self.report.ticks + self.report.unseen);
        let counts = self.counter.finish(self.agent.outliers(), self.agent.policy().is_some_and(|p| p.norm() == 0.0));
        let learner = self.agent.counts().into_iter().map(|(name, count)| (name.to_owned(), count)).collect();
        let report = ControllerReport {
            weights_hash,
            windows,
            first_switch,
            last_switch,
            targets,
            counts,
            learner,
            ..self.report
        };
        (report, self.agent)
    }
}

impl<A: Agent> Persist for Controller<A> {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.nested("line", &mut self.observations);
        if self.agent.policy().is_some() {
            // The rows of a learning rule stand beside those of the controller, as in all checkpoints before.
            self.agent.visit_state(visitor);
        } else {
            visitor.nested("agent", &mut self.agent);
        }
        visitor.optional("answered", &mut self.answered);
        visitor.numbers("shown", &mut self.answered_inputs);
        visitor.numbers("asked", &mut self.asked);
        visitor.numbers("before", &mut self.applied_before);
        visitor.number("flags", &mut self.flags);
        visitor.boolean("acted", &mut self.acted);
        visitor.number("age", &mut self.age);
        visitor.nested("tally", &mut self.statistics);
        visitor.nested("counter", &mut self.counter);
        visitor.nested("report", &mut self.report);
    }
}

#[cfg(test)]
mod learner_tests;
#[cfg(test)]
mod state_tests;
#[cfg(test)]
mod tests;
