//! The controller's side of the tick: an agent behind the faults of its channel, with statistics and report.

use self::tick::{ControllerTick, Freeze};
use super::{ControllerReport, RunStatistics};
use crate::agent::{Agent, Boundary, Experience, ShippedAgent, Withheld};
use crate::checkpoint::{Checkpoint, CheckpointError};
use crate::policy::LinearPolicy;
use crate::scenario::Plan;
use crate::simd::SimdPath;
use crate::state::{Persist, StateVisitor};
use crate::wire::{Ahead, Command, Learning, Observation};

mod tick;

/// An agent in its run: the controller's half of every tick, without clock and transport.
///
/// What it does knows the agent as `dyn Agent` (`tick.rs`), and is compiled once for all agents. A tick has two parts.
/// [`respond`](Self::respond) computes the command.
/// [`after_command`](Self::after_command) and [`record`](Self::record) follow after the command has been sent.
///
/// It tells the agent what became of its last command, and decides what may be learned from ([`Withheld`]): only the
/// reward of a command that was applied as the agent gave it, or as the gate limited it.
#[derive(Debug, Clone)]
pub struct Controller<A = ShippedAgent> {
    agent: A,
    tick: ControllerTick,
}

impl Controller {
    /// The controller of `plan` with its learner, which knows nothing yet.
    pub fn new(plan: &Plan) -> Self {
        Self::with_agent(plan, plan.agent())
    }

    /// The same controller for commands that another policy chose: every applied command is credited.
    pub fn off_policy(self) -> Self {
        Self { tick: ControllerTick { off_policy: true, ..self.tick }, ..self }
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
        Self { agent, tick: ControllerTick::new(plan) }
    }

    /// From now on the agent neither learns nor explores: its mean is the command ([`Agent::freeze`]).
    pub fn freeze(&mut self) {
        self.tick.freeze = if self.agent.freeze() { Freeze::PlansOn } else { Freeze::Whole };
        self.tick.report.frozen = true;
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
            inputs: &self.tick.answered_inputs[..self.tick.inputs],
            asked: &self.tick.asked[..self.tick.outputs],
            applied: &self.tick.applied_before[..self.tick.outputs],
            limited: false,
            reward: 0.0,
            next_inputs: &self.tick.answered_inputs[..self.tick.inputs],
            boundary: Boundary::Truncated,
            withheld: Some(Withheld::First),
        });
        self.tick.report.started_from = Some(checkpoint.facts.tick);
        Ok(())
    }

    /// Learns from the observation's reward and computes the command for its inputs: mean, drawn output, tick
    /// and flags.
    ///
    /// Credit goes to the applied command. When the command was not applied at all, or observations are missing in
    /// between, nothing may be learned. An observation with a value that is not finite, or beyond any range that a
    /// scenario may have, is answered with zero. The scenario's faults act on the observation first. When they leave
    /// no observation of this tick, the command has the flag [`flag::UNHEARD`](crate::wire::flag::UNHEARD).
    pub fn respond(&mut self, observation: &Observation, command: &mut Command) {
        self.tick.respond(&mut self.agent, observation, command);
    }

    /// What goes with the last command that answered an observation: commands for the ticks after it; `None` where the
    /// scenario has none.
    pub fn ahead(&self) -> Option<&Ahead> {
        self.tick.ahead.as_deref()
    }

    /// Answers an observation of a test: the agent's mean, without exploration noise. The agent decides and learns
    /// nothing, and nothing is counted; its state is to be put back after the test. Faults of the channel do not act.
    pub(super) fn answer_test(&mut self, observation: &Observation, command: &mut Command) {
        self.tick.answer_test(&mut self.agent, observation, command);
    }

    /// The work after the command has been sent: improves the agent, and adds the observation to the
    /// statistics.
    pub fn after_command(&mut self, observation: &Observation) {
        self.tick.after_command(&mut self.agent, observation);
    }

    /// Fills the learning record of the last answered tick.
    pub fn record(&mut self, observation: &Observation, learning: &mut Learning) {
        self.tick.record(&mut self.agent, observation, learning);
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
        &self.tick.statistics
    }

    /// Ends the run and returns the report, with the hash of what was learned.
    pub fn finish(self) -> ControllerReport {
        self.finish_with_agent().0
    }

    /// Like [`finish`](Self::finish), and gives the agent back.
    pub fn finish_with_agent(mut self) -> (ControllerReport, A) {
        let report = self.tick.finish(&mut self.agent);
        (report, self.agent)
    }

    /// The report so far, for the loop around this.
    pub(super) fn report(&self) -> &ControllerReport {
        &self.tick.report
    }

    /// The same, to add what the loop counts.
    pub(super) fn report_mut(&mut self) -> &mut ControllerReport {
        &mut self.tick.report
    }
}

impl<A: Agent> Persist for Controller<A> {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.nested("line", &mut self.tick.observations);
        if self.agent.policy().is_some() {
            // The rows of a learning rule stand beside those of the controller, as in all checkpoints before.
            self.agent.visit_state(visitor);
        } else {
            visitor.nested("agent", &mut self.agent);
        }
        visitor.optional("answered", &mut self.tick.answered);
        visitor.numbers("shown", &mut self.tick.answered_inputs);
        visitor.numbers("asked", &mut self.tick.asked);
        visitor.numbers("before", &mut self.tick.applied_before);
        visitor.number("flags", &mut self.tick.flags);
        visitor.boolean("acted", &mut self.tick.acted);
        visitor.number("age", &mut self.tick.age);
        if let Some(ahead) = &mut self.tick.ahead {
            visitor.words("ahead", &mut **ahead);
        }
        visitor.nested("tally", &mut self.tick.statistics);
        visitor.nested("counter", &mut self.tick.counter);
        visitor.nested("report", &mut self.tick.report);
    }
}

#[cfg(test)]
mod learner_tests;
#[cfg(test)]
mod state_tests;
#[cfg(test)]
mod tests;
