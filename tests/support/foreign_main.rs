//! The controllers of `tests/compare.rs` and `tests/wide.rs`: the paper's rule in a program of its own, agents that
//! fail, and one for as many inputs and outputs as a plant may have.

use std::process::ExitCode;

use tectum::agent::{Agent, AgentRecord, Answer, Experience, Percept};
use tectum::process::controller_main;
use tectum::state::{Persist, StateVisitor};
use tectum::wire::flag;

/// Fails in the way that its name says.
enum Failing {
    Ends,
    FailsInTests,
    Hangs,
}

impl Persist for Failing {
    fn visit_state(&mut self, _visitor: &mut dyn StateVisitor) {}
}

impl Agent for Failing {
    fn act(&mut self, percept: &Percept, answer: &mut Answer) {
        let in_test = percept.flags & flag::TRUNCATED != 0;
        match self {
            Self::Ends if percept.tick == 100 && !in_test => std::process::exit(7),
            Self::FailsInTests if in_test => std::process::exit(8),
            Self::Hangs if percept.tick == 10 => {
                std::fs::write("hangs", "").unwrap();
                loop {
                    std::thread::park();
                }
            }
            _ => answer.command.fill(0.001),
        }
    }
}

/// Draws each of the first inputs to one of the others, the more strongly the more reward it has collected.
struct Wide {
    collected: f32,
    updates: u32,
}

impl Persist for Wide {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.number("collected", &mut self.collected);
        visitor.number("updates", &mut self.updates);
    }
}

impl Agent for Wide {
    fn act(&mut self, percept: &Percept, answer: &mut Answer) {
        let (positions, targets) = percept.inputs.split_at(answer.command.len());
        let strength = 0.5 + 0.4 * (self.collected * 0.01).clamp(-1.0, 1.0);
        for (command, (position, target)) in answer.command.iter_mut().zip(positions.iter().zip(targets)) {
            *command = strength * (target - position);
        }
    }

    fn learn(&mut self, experience: &Experience) -> bool {
        self.collected += experience.reward;
        true
    }

    fn improve(&mut self, updates: u32) {
        self.updates += updates;
    }

    fn columns(&self) -> &'static [&'static str] {
        &["updates"]
    }

    fn record(&self, record: &mut AgentRecord) {
        record.columns[0] = self.updates as f32;
    }
}

fn main() -> ExitCode {
    controller_main(&[
        ("paper", |plan| Ok(Box::new(plan.agent()))),
        ("wide", |_| Ok(Box::new(Wide { collected: 0.0, updates: 0 }))),
        ("ends", |_| Ok(Box::new(Failing::Ends))),
        ("fails-in-tests", |_| Ok(Box::new(Failing::FailsInTests))),
        ("hangs", |_| Ok(Box::new(Failing::Hangs))),
    ])
}
