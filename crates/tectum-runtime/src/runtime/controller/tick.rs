//! What a controller does in a tick, apart from its agent: it hears the observation, tells the agent what became of its
//! command, checks the agent's answer, and counts.
//!
//! It knows the agent as `dyn Agent`, so that it is compiled once, with full optimisation, for every agent.

use crate::agent::{Agent, AgentRecord, Answer, Boundary, Experience, MAX_COLUMNS, Percept, Withheld, learned_hash};
use crate::runtime::run_counts::RunCounter;
use crate::runtime::statistics::FinishedStatistics;
use crate::runtime::{ControllerReport, FaultyChannel, RunStatistics};
use crate::scenario::{Plan, limits::RANGE};
use crate::wire::{
    Ahead, Command, Header, Learning, MAX_AHEAD, MAX_INPUTS, MAX_OUTPUTS, Observation, OutputValues, flag,
};

/// The state of a controller, apart from its agent.
#[derive(Debug, Clone)]
pub(super) struct ControllerTick {
    /// The receiving end of the observation channel, with the scenario's faults.
    pub(super) observations: FaultyChannel<Observation>,
    pub(super) inputs: usize,
    pub(super) outputs: usize,
    pub(super) ticks: u64,
    pub(super) hash_every: u64,
    /// Updates of the agent in a tick.
    pub(super) updates: u32,
    /// The tick answered last; `None` when its command was not the agent's.
    pub(super) answered: Option<u64>,
    pub(super) answered_inputs: [f32; MAX_INPUTS],
    /// The agent's command for that tick.
    pub(super) asked: [f32; MAX_OUTPUTS],
    /// The command applied in the tick before that command.
    pub(super) applied_before: [f32; MAX_OUTPUTS],
    /// Whether every applied command is credited, also those of another policy.
    pub(super) off_policy: bool,
    pub(super) freeze: Freeze,
    /// Flags of the learner in this tick, and whether its command is the agent's.
    pub(super) flags: u32,
    pub(super) acted: bool,
    /// Commands for the ticks after this one, where the scenario wants them, and for how many ticks at most.
    pub(super) ahead: Option<Box<Ahead>>,
    pub(super) most_ahead: usize,
    /// Observations in a row whose inputs the plant could not read.
    pub(super) age: u32,
    pub(super) statistics: RunStatistics,
    pub(super) counter: RunCounter,
    pub(in crate::runtime) report: ControllerReport,
}

/// Whether the agent learns and explores.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Freeze {
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

impl ControllerTick {
    pub(super) fn new(plan: &Plan) -> Self {
        Self {
            observations: FaultyChannel::of(plan),
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
            ahead: (plan.scenario.link.ahead > 0).then(Box::default),
            most_ahead: plan.scenario.link.ahead as usize,
            age: 0,
            statistics: RunStatistics::new(plan),
            counter: RunCounter::new(plan),
            report: ControllerReport::default(),
        }
    }

    /// [`Controller::respond`](super::Controller::respond).
    pub(super) fn respond(&mut self, agent: &mut dyn Agent, observation: &Observation, command: &mut Command) {
        self.respond_without_ahead(agent, observation, command);
        // Without an observation there is nothing newer than what went out before.
        if let Some(ahead) = self.ahead.as_mut().filter(|_| command.header.flags & flag::UNHEARD == 0) {
            (ahead.header, ahead.ticks) = (Header { tick: command.header.tick, ..Header::default() }, 0);
            ahead.commands = [[0.0; MAX_OUTPUTS]; MAX_AHEAD];
            if self.acted {
                ahead.ticks = agent.look_ahead(&mut ahead.commands[..self.most_ahead]) as u64;
            }
        }
    }

    fn respond_without_ahead(&mut self, agent: &mut dyn Agent, observation: &Observation, command: &mut Command) {
        if self.observations.is_fault_free() {
            return self.answer(agent, observation, command);
        }
        let tick = observation.header.tick;
        let mut received = None;
        let stale = &mut self.report.stale;
        self.observations.pass(tick, Some(observation), |o| match o.header.tick == tick {
            true => received = Some(*o),
            false => *stale += 1,
        });
        match received {
            Some(received) => self.answer(agent, &received, command),
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
    fn answer(&mut self, agent: &mut dyn Agent, observation: &Observation, command: &mut Command) {
        let tick = observation.header.tick;
        let inputs = &observation.inputs[..self.inputs];
        // A NaN fails the comparison, too. There is no branch per value, because they are nearly always valid.
        let invalid = !inputs.iter().fold(true, |all, x| all & (f64::from(x.abs()) <= RANGE));
        self.age = if observation.header.flags & flag::BLIND == 0 { 0 } else { self.age.saturating_add(1) };
        self.learn(agent, observation, invalid);
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
        agent.act(&percept, &mut Answer { command: drawn, mean });
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

    /// [`Controller::answer_test`](super::Controller::answer_test).
    pub(super) fn answer_test(&mut self, agent: &mut dyn Agent, observation: &Observation, command: &mut Command) {
        let (header, inputs) = (&observation.header, &observation.inputs[..self.inputs]);
        (command.header.tick, command.header.flags) = (header.tick, 0);
        (command.mean, command.drawn) = ([0.0; MAX_OUTPUTS], [0.0; MAX_OUTPUTS]);
        let (mean, drawn) = (&mut command.mean[..self.outputs], &mut command.drawn[..self.outputs]);
        mean.fill(f32::NAN);
        let percept = Percept { tick: header.tick, inputs, age: 0, flags: header.flags };
        agent.act(&percept, &mut Answer { command: drawn, mean });
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
        let why = Withheld::of(flags);
        // What was applied in between is not known.
        if observation.header.tick != answered + 1 && matches!(why, None | Some(Withheld::Missed)) {
            return Some(Withheld::Lost);
        }
        if why.is_some() {
            return why;
        }
        let limited = flags & flag::CLAMPED != 0;
        if limited && !self.off_policy && !self.gate_could_apply(&observation.applied[..self.outputs]) {
            return Some(Withheld::Corrupted);
        }
        (invalid || !observation.reward.is_finite()).then_some(Withheld::Invalid)
    }

    /// Hands the result of the last command to the agent.
    fn learn(&mut self, agent: &mut dyn Agent, observation: &Observation, invalid: bool) {
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
        let learned = agent.learn(&experience);
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

    /// [`Controller::after_command`](super::Controller::after_command).
    pub(super) fn after_command(&mut self, agent: &mut dyn Agent, observation: &Observation) {
        if self.freeze != Freeze::Whole {
            agent.improve(self.updates);
        }
        if agent.halted() {
            self.report.diverged_at.get_or_insert(observation.header.tick);
        }
        self.statistics.observe(observation);
        self.counter.observe(observation, self.flags & flag::LEARNED != 0, &self.asked);
        self.report.ticks += 1;
    }

    /// [`Controller::record`](super::Controller::record).
    pub(super) fn record(&mut self, agent: &mut dyn Agent, observation: &Observation, learning: &mut Learning) {
        let tick = observation.header.tick;
        let hashed = tick.is_multiple_of(self.hash_every) || tick + 1 == self.ticks;
        let learned = self.flags & flag::LEARNED != 0;
        learning.header.tick = tick;
        let halted = if agent.halted() { flag::DIVERGED } else { 0 };
        learning.header.flags = self.flags | halted | if hashed { flag::HASHED } else { 0 };
        let noise = &mut learning.noise[..self.outputs];
        noise.fill(0.0);
        let mut record =
            AgentRecord { noise, step: 0.0, weights_norm: 0.0, trace_norm: 0.0, columns: [0.0; MAX_COLUMNS] };
        agent.record(&mut record);
        if !self.acted || self.freeze != Freeze::None {
            record.noise.fill(0.0);
        }
        learning.step = if learned { record.step } else { 0.0 };
        learning.weights_norm = record.weights_norm;
        learning.trace_norm = record.trace_norm;
        learning.columns = record.columns;
        learning.reward = if learned { observation.reward } else { 0.0 };
        learning.weights_hash = if hashed { learned_hash(agent) } else { 0 };
    }

    /// The report at the end of the run, with the hash of what `agent` learned.
    pub(super) fn finish(self, agent: &mut dyn Agent) -> ControllerReport {
        let weights_hash = format!("{:016x}", learned_hash(agent));
        let FinishedStatistics { windows, first_switch, last_switch, targets } =
            self.statistics.finish(self.report.ticks + self.report.unseen);
        let counts = self.counter.finish(agent.outliers(), agent.policy().is_some_and(|p| p.norm() == 0.0));
        let learner = agent.counts().into_iter().map(|(name, count)| (name.to_owned(), count)).collect();
        ControllerReport { weights_hash, windows, first_switch, last_switch, targets, counts, learner, ..self.report }
    }
}
