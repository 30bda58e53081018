//! The plant's side of the tick: a body behind its gate.

use super::{Gate, PlantReport};
use crate::plant::{Outcome, Plant};
use crate::policy::Outputs;
use crate::scenario::Plan;
use crate::state::{Ledger, Remember};
use crate::wire::{Command, MAX_OUTPUTS, Observation, flag};

/// A body behind its gate: the plant's half of every tick, without clock and transport.
#[derive(Debug, Clone)]
pub struct PlantSide<P> {
    body: P,
    gate: Gate,
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
            outputs,
            outcome: Outcome::default(),
            applied: [0.0; MAX_OUTPUTS],
            flags: flag::FIRST,
            report: PlantReport::default(),
        }
    }

    /// The body.
    pub fn body_mut(&mut self) -> &mut P {
        &mut self.body
    }

    /// Lives through `tick` with the command that arrived for it; `None` if it was missed.
    pub fn live(&mut self, tick: u64, command: Option<&Command>) {
        let applied = self.gate.pass(command.map(|c| &c.drawn));
        self.report.missed += u64::from(applied.flags & flag::MISSED != 0);
        self.report.clamped += u64::from(applied.flags & flag::CLAMPED != 0);
        self.report.non_finite += u64::from(applied.flags & flag::NON_FINITE != 0);
        self.applied = applied.command;
        self.flags = applied.flags;
        self.outcome = self.body.advance(tick, &applied.command[..self.outputs]);
    }

    /// Lives through the ticks from `tick` up to but without `until` that nobody had time for.
    pub fn skip(&mut self, tick: u64, until: u64) {
        for tick in tick..until {
            self.live(tick, None);
        }
        self.report.skipped += until - tick;
    }

    /// Senses at the beginning of `tick`. `more` are flags that the loop adds; `skipped` ticks were passed over.
    pub fn observe(&mut self, tick: u64, more: u32, skipped: u32, observation: &mut Observation) {
        let fresh = self.body.sense(tick, &mut observation.inputs);
        let skip = if skipped > 0 { flag::SKIPPED } else { 0 };
        let target = if fresh { flag::NEW_TARGET } else { 0 };
        observation.header.tick = tick;
        observation.header.flags = self.flags | more | skip | target;
        observation.applied = self.applied;
        observation.reward = self.outcome.reward;
        observation.measures = self.outcome.measures;
        observation.skipped = skipped;
        self.report.ticks += 1;
    }
}

impl<P: Plant> Remember for PlantSide<P> {
    fn remember(&mut self, ledger: &mut dyn Ledger) {
        ledger.part("body", &mut self.body);
        ledger.part("gate", &mut self.gate);
        ledger.number("reward", &mut self.outcome.reward);
        ledger.numbers("measures", &mut self.outcome.measures);
        ledger.numbers("applied", &mut self.applied);
        ledger.number("flags", &mut self.flags);
        ledger.part("report", &mut self.report);
    }
}
