//! The plant's side of the tick: a body behind its gate.

use super::{CommandRanges, FaultyChannel, Gate, PlantReport};
use crate::plant::{Outcome, Plant};
use crate::policy::Outputs;
use crate::scenario::Plan;
use crate::state::{Persist, StateVisitor, save, size};
use crate::wire::{Command, MAX_OUTPUTS, Observation, flag};

/// A body behind its gate: the plant's half of every tick, without clock and transport.
#[derive(Debug, Clone)]
pub struct PlantSide<P> {
    body: P,
    gate: Gate,
    /// The commands' way to here.
    line: FaultyChannel<Command>,
    /// What is left by limits of position, where the body cannot say and somebody else can.
    told: Option<CommandRanges>,
    outputs: usize,
    outcome: Outcome,
    applied: Outputs,
    flags: u32,
    /// Counts so far.
    pub report: PlantReport,
}

impl<P: Plant> PlantSide<P> {
    /// `body` behind the gate of `plan`.
    pub fn new(body: P, plan: &Plan) -> Self {
        let outputs = plan.outputs.len();
        Self {
            body,
            gate: Gate::new(&plan.scenario.gate, outputs),
            line: FaultyChannel::of(plan),
            told: None,
            outputs,
            outcome: Outcome::default(),
            applied: [0.0; MAX_OUTPUTS],
            flags: flag::FIRST,
            report: PlantReport::default(),
        }
    }

    /// Whether nothing can go wrong on the commands' way to the gate, but for what the run itself does to them.
    pub fn is_clean(&self) -> bool {
        self.line.is_clean()
    }

    /// Tells what limits of position leave, for the ticks that follow: nobody is asked where the joints are.
    pub(crate) fn tell(&mut self, spans: CommandRanges) {
        self.told = Some(spans);
    }

    /// Whether the gate limits positions.
    pub(crate) fn limits_positions(&self) -> bool {
        self.gate.spans(|| None).is_some()
    }

    /// Takes what was applied in the tick lived last, and what limited it, from `observation`.
    pub(crate) fn take_over(&mut self, observation: &Observation) {
        const LIMITS: u32 = flag::CLAMPED | flag::STEP_LIMITED | flag::POSITION_LIMITED;
        self.applied = observation.applied;
        self.flags = self.flags & !LIMITS | observation.header.flags & LIMITS;
        self.gate.take_over(self.applied);
    }

    /// All that decides how it goes on, as bytes.
    pub(crate) fn standing(&mut self) -> Vec<u8> {
        [&mut self.body as &mut dyn Persist, &mut self.gate, &mut self.line]
            .into_iter()
            .flat_map(|part| {
                let mut bytes = vec![0; size(part)];
                save(part, &mut bytes);
                bytes
            })
            .collect()
    }

    /// The body.
    pub fn body_mut(&mut self) -> &mut P {
        &mut self.body
    }

    /// The body, when all is over.
    pub fn into_body(self) -> P {
        self.body
    }

    /// Lives through `tick` with the command that arrived for it; `None` if it was missed. One that stands for silence is
    /// none. What the scenario's faults make of it is between here and the gate.
    pub fn step(&mut self, tick: u64, command: Option<&Command>) {
        self.apply(tick, command, true);
        self.finish_step(tick);
    }

    /// The first half of [`live`](Self::live): what is applied in `tick`; with `act` the body is told, if it acts at once.
    pub fn apply(&mut self, tick: u64, command: Option<&Command>, act: bool) {
        let command = command.filter(|c| c.header.flags & flag::UNHEARD == 0);
        let (mut found, mut late) = (None, 0);
        if self.line.is_clean() {
            found = command.map(|c| c.drawn);
        } else {
            self.line.pass(tick, command, |c| match c.header.tick == tick {
                true => found = Some(c.drawn),
                false => late += 1,
            });
        }
        let spans = self.gate.spans(|| self.body.joints());
        let mut applied = self.gate.pass(found.as_ref(), self.told.as_ref().or(spans.as_ref()));
        if act && self.body.acts_within().is_some() {
            let before = applied.command;
            applied.flags |= self.body.act(tick, &mut applied.command[..self.outputs], applied.flags);
            if applied.command != before {
                self.gate.take_over(applied.command);
            }
        }
        self.report.late += late;
        for (count, flag) in [
            (&mut self.report.missed, flag::MISSED),
            (&mut self.report.clamped, flag::CLAMPED),
            (&mut self.report.step_limited, flag::STEP_LIMITED),
            (&mut self.report.position_limited, flag::POSITION_LIMITED),
            (&mut self.report.ramped, flag::RAMPED),
            (&mut self.report.non_finite, flag::NON_FINITE),
        ] {
            *count += u64::from(applied.flags & flag != 0);
        }
        self.applied = applied.command;
        self.flags = applied.flags | if late > 0 { flag::LATE } else { 0 };
    }

    /// The second half: the tick is over, and something came of it.
    pub fn finish_step(&mut self, tick: u64) {
        self.outcome = self.body.advance(tick, &self.applied[..self.outputs]);
    }

    /// How long the body waits for a tick's command within that tick, ns ([`Plant::acts_within`]).
    pub fn acts_within(&self) -> Option<u64> {
        self.body.acts_within()
    }

    /// Lives through the ticks from `tick` up to but without `until` that nobody had time for.
    pub fn skip(&mut self, tick: u64, until: u64) {
        if self.body.acts_within().is_some() {
            // What is real has lived through all of them at once.
            for tick in tick..until {
                self.apply(tick, None, tick + 1 == until);
            }
            if tick < until {
                self.finish_step(until - 1);
            }
        } else {
            for tick in tick..until {
                self.step(tick, None);
            }
        }
        self.report.skipped += until - tick;
    }

    /// Senses at the beginning of `tick`. `more` are flags that the loop adds; `skipped` ticks were passed over.
    pub fn observe(&mut self, tick: u64, more: u32, skipped: u32, observation: &mut Observation) {
        let fresh = self.body.sense(tick, &mut observation.inputs);
        let skip = if skipped > 0 { flag::SKIPPED } else { 0 };
        let target = if fresh { flag::NEW_TARGET } else { 0 };
        observation.header.tick = tick;
        observation.header.flags = self.flags | self.body.remarks() | more | skip | target;
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
        visitor.nested("gate", &mut self.gate);
        visitor.nested("line", &mut self.line);
        visitor.number("reward", &mut self.outcome.reward);
        visitor.numbers("measures", &mut self.outcome.measures);
        visitor.numbers("applied", &mut self.applied);
        visitor.number("flags", &mut self.flags);
        visitor.nested("report", &mut self.report);
    }
}
