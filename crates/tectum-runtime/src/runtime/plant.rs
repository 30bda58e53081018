//! The plant's side of the tick: a plant behind its gate.

use super::commands_ahead::{CommandAhead, CommandsAhead};
use super::{CommandRanges, FaultyChannel, Gate, PlantReport};
use crate::plant::{EpisodeEnd, Outcome, Plant};
use crate::scenario::Plan;
use crate::state::{Persist, StateVisitor, save, size};
use crate::wire::{Ahead, Command, MAX_OUTPUTS, Observation, OutputValues, flag};

/// A plant behind its gate: the plant's half of every tick, without clock and transport.
///
/// The work is that of `PlantTick`, which knows the plant as `dyn Plant`: so it is compiled once, in this crate, for
/// every plant.
#[derive(Debug, Clone)]
pub struct PlantSide<P> {
    body: P,
    tick: PlantTick,
}

impl<P: Plant> PlantSide<P> {
    /// The plant `body` behind the gate of `plan`.
    pub fn new(body: P, plan: &Plan) -> Self {
        Self { body, tick: PlantTick::new(plan) }
    }

    /// Counts so far.
    pub fn report(&self) -> &PlantReport {
        &self.tick.report
    }

    /// The counts, after the run.
    pub fn into_report(self) -> PlantReport {
        self.tick.report
    }

    /// The counts, for the loop around this that counts too.
    pub(crate) fn report_mut(&mut self) -> &mut PlantReport {
        &mut self.tick.report
    }

    /// Whether the scenario has no faults on the command channel.
    pub fn is_fault_free(&self) -> bool {
        self.tick.commands.is_fault_free()
    }

    /// Sets the ranges that the position limits leave in the following ticks, in place of those from the
    /// plant's joints.
    pub fn set_command_ranges(&mut self, ranges: CommandRanges) {
        self.tick.known_ranges = Some(ranges);
    }

    /// Whether the gate limits positions.
    pub fn limits_positions(&self) -> bool {
        self.tick.gate.command_ranges(|| None).is_some()
    }

    /// Takes the command applied in the last tick, and the flags of its limits, from `observation`.
    pub fn adopt_applied(&mut self, observation: &Observation) {
        self.tick.adopt_applied(observation);
    }

    /// The state that determines the following ticks, as bytes.
    pub fn state_bytes(&mut self) -> Vec<u8> {
        [&mut self.body as &mut dyn Persist, &mut self.tick.gate, &mut self.tick.commands, &mut self.tick.ahead]
            .into_iter()
            .flat_map(|part| {
                let mut bytes = vec![0; size(part)];
                save(part, &mut bytes);
                bytes
            })
            .collect()
    }

    /// The plant.
    pub fn body_mut(&mut self) -> &mut P {
        &mut self.body
    }

    /// Tells the plant that the run is over.
    pub(crate) fn stop(&mut self) {
        self.body.stop();
    }

    /// The plant, after the run.
    pub fn into_body(self) -> P {
        self.body
    }

    /// Keeps the commands ahead that came with a command, if any did, for ticks in which none arrives.
    pub fn keep_ahead(&mut self, ahead: Option<&Ahead>) {
        ahead.into_iter().for_each(|ahead| self.tick.ahead.keep(ahead));
    }

    /// For a replay: in the next step, the command ahead that `observation` says was applied, with the flags of its
    /// limits. Its `age` is not in the log.
    pub fn know_ahead(&mut self, observation: &Observation, age: u32) {
        let flags = observation.header.flags & GATE_LIMITS;
        self.tick.known_ahead = Some((CommandAhead { command: observation.applied, age }, flags));
    }

    /// Advances the plant by `tick`, with the command that arrived for it; `None` if it was missed. A command
    /// with the flag `UNHEARD` counts as none. The scenario's faults act on the command before the gate.
    pub fn step(&mut self, tick: u64, command: Option<&Command>) {
        self.tick.step(&mut self.body, tick, command);
    }

    /// The first half of [`step`](Self::step): determines the applied command of `tick`. With `act`, passes it
    /// on to a plant that acts within the tick.
    pub fn apply(&mut self, tick: u64, command: Option<&Command>, act: bool) {
        self.tick.apply(&mut self.body, tick, command, act);
    }

    /// The second half of [`step`](Self::step): the tick is over. Advances the plant and keeps the tick's
    /// outcome.
    pub fn finish_step(&mut self, tick: u64) {
        self.tick.finish_step(&mut self.body, tick);
    }

    /// How long the plant waits for a tick's command within that tick, ns ([`Plant::command_deadline_ns`]).
    pub fn command_deadline_ns(&self) -> Option<u64> {
        self.body.command_deadline_ns()
    }

    /// Advances the plant by the ticks from `tick` up to but without `until`, which the loop skipped because it
    /// was late.
    pub fn skip(&mut self, tick: u64, until: u64) {
        self.tick.skip(&mut self.body, tick, until);
    }

    /// Senses at the start of `tick` and fills the observation. `more` are flags that the loop adds; `skipped`
    /// ticks were skipped right before this one.
    pub fn observe(&mut self, tick: u64, more: u32, skipped: u32, observation: &mut Observation) {
        self.tick.observe(&mut self.body, tick, more, skipped, observation);
    }
}

/// Gate, command channel and outcome of a plant: what its half of a tick needs beside the plant.
#[derive(Debug, Clone)]
struct PlantTick {
    gate: Gate,
    /// The receiving end of the command channel, with the scenario's faults.
    commands: FaultyChannel<Command>,
    /// The ranges that the position limits leave, where the plant cannot report its joints and a replay knows
    /// the ranges.
    known_ranges: Option<CommandRanges>,
    /// Commands for ticks in which none arrives.
    ahead: CommandsAhead,
    /// The one that a replay knows from the log, and the flags of its limits.
    known_ahead: Option<(CommandAhead, u32)>,
    /// Whether ticks are passed over.
    skipping: bool,
    inputs: usize,
    outputs: usize,
    outcome: Outcome,
    applied: OutputValues,
    flags: u32,
    /// Counts so far.
    report: PlantReport,
}

/// Flags of the gate's limits.
const GATE_LIMITS: u32 = flag::CLAMPED | flag::STEP_LIMITED | flag::POSITION_LIMITED | flag::RAMPED;

impl PlantTick {
    fn new(plan: &Plan) -> Self {
        let outputs = plan.outputs.len();
        Self {
            gate: Gate::new(&plan.scenario.gate, outputs),
            commands: FaultyChannel::of(plan),
            known_ranges: None,
            ahead: CommandsAhead::new(plan.scenario.link.ahead),
            known_ahead: None,
            skipping: false,
            inputs: plan.inputs.len(),
            outputs,
            outcome: Outcome::default(),
            applied: [0.0; MAX_OUTPUTS],
            flags: flag::FIRST,
            report: PlantReport::default(),
        }
    }

    fn adopt_applied(&mut self, observation: &Observation) {
        const LIMITS: u32 = GATE_LIMITS & !flag::RAMPED;
        self.applied = observation.applied;
        self.flags = self.flags & !LIMITS | observation.header.flags & LIMITS;
        self.gate.set_applied(self.applied);
    }

    fn step(&mut self, body: &mut dyn Plant, tick: u64, command: Option<&Command>) {
        self.apply(body, tick, command, true);
        self.finish_step(body, tick);
    }

    fn apply(&mut self, body: &mut dyn Plant, tick: u64, command: Option<&Command>, act: bool) {
        let command = command.filter(|c| c.header.flags & flag::UNHEARD == 0);
        let (mut passed_on, mut late) = (None, 0);
        let received = if self.commands.is_fault_free() {
            command.map(|c| &c.drawn)
        } else {
            let ahead = &mut self.ahead;
            self.commands.pass(tick, command, |c| {
                ahead.hear(c.header.tick, tick);
                match c.header.tick == tick {
                    true => passed_on = Some(c.drawn),
                    false => late += 1,
                }
            });
            passed_on.as_ref()
        };
        let known = self.known_ahead.take();
        let ahead = known.map_or_else(|| self.command_ahead(tick), |(command, _)| Some(command));
        let ranges = self.gate.command_ranges(|| body.joints());
        let ranges = self.known_ranges.as_ref().or(ranges.as_ref());
        let mut applied = self.gate.pass_or(received, ahead, ranges);
        if let Some((_, limits)) = known.filter(|_| applied.flags & flag::AHEAD != 0) {
            applied.flags |= limits;
        }
        if act && body.command_deadline_ns().is_some() {
            let before = applied.command;
            applied.flags |= body.act(tick, &mut applied.command[..self.outputs], applied.flags);
            if applied.command != before {
                self.gate.set_applied(applied.command);
            }
        }
        self.count(applied.flags, late);
        self.applied = applied.command;
        // An episode that ended in a skipped tick is stated in the next observation.
        let ended = self.flags & flag::EPISODE_END;
        self.flags = applied.flags | ended | if late > 0 { flag::LATE } else { 0 };
    }

    /// The command for `tick` that an earlier one brought ahead. In a tick that is passed over it would be for a time
    /// that is gone.
    fn command_ahead(&mut self, tick: u64) -> Option<CommandAhead> {
        if !self.ahead.is_used() || self.skipping {
            return None;
        }
        if self.commands.is_fault_free() {
            self.ahead.hear_all(tick);
        }
        self.ahead.command_for(tick)
    }

    /// Counts what the gate did in a tick, by its flags, and the commands that came late.
    fn count(&mut self, flags: u32, late: u64) {
        self.report.late += late;
        if flags == 0 {
            return;
        }
        for (count, flag) in [
            (&mut self.report.missed, flag::MISSED),
            (&mut self.report.ahead, flag::AHEAD),
            (&mut self.report.clamped, flag::CLAMPED),
            (&mut self.report.step_limited, flag::STEP_LIMITED),
            (&mut self.report.position_limited, flag::POSITION_LIMITED),
            (&mut self.report.ramped, flag::RAMPED),
            (&mut self.report.non_finite, flag::NON_FINITE),
        ] {
            *count += u64::from(flags & flag != 0);
        }
    }

    fn finish_step(&mut self, body: &mut dyn Plant, tick: u64) {
        self.outcome = body.advance(tick, &self.applied[..self.outputs]);
        self.flags |= body.episode_end().map_or(0, EpisodeEnd::flag);
    }

    fn skip(&mut self, body: &mut dyn Plant, tick: u64, until: u64) {
        self.skipping = true;
        if body.command_deadline_ns().is_some() {
            // Hardware has moved through all skipped ticks by now, so it acts and is read only once.
            for tick in tick..until {
                self.apply(body, tick, None, tick + 1 == until);
            }
            if tick < until {
                self.finish_step(body, until - 1);
            }
        } else {
            for tick in tick..until {
                self.step(body, tick, None);
            }
        }
        self.skipping = false;
        self.report.skipped += until - tick;
    }

    fn observe(&mut self, body: &mut dyn Plant, tick: u64, more: u32, skipped: u32, observation: &mut Observation) {
        let fresh = body.sense(tick, &mut observation.inputs[..self.inputs]);
        let skip = if skipped > 0 { flag::SKIPPED } else { 0 };
        let target = if fresh { flag::NEW_TARGET } else { 0 };
        observation.header.tick = tick;
        observation.header.flags = self.flags | body.sensing_flags() | more | skip | target;
        self.flags &= !flag::EPISODE_END;
        observation.applied = self.applied;
        observation.reward = self.outcome.reward;
        observation.measures = self.outcome.measures;
        observation.skipped = skipped;
        self.report.ticks += 1;
    }
}

impl<P: Plant> Persist for PlantSide<P> {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.nested("body", &mut self.body);
        visitor.nested("gate", &mut self.tick.gate);
        visitor.nested("line", &mut self.tick.commands);
        visitor.nested("ahead", &mut self.tick.ahead);
        visitor.number("reward", &mut self.tick.outcome.reward);
        visitor.numbers("measures", &mut self.tick.outcome.measures);
        visitor.numbers("applied", &mut self.tick.applied);
        visitor.number("flags", &mut self.tick.flags);
        visitor.nested("report", &mut self.tick.report);
    }
}
