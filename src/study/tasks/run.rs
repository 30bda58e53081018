//! The run of one learner on one task with one seed: its tests, and the processor time of its ticks.

use super::outcome::{PhaseTest, RunResult};
use super::plan::TaskPlan;
use super::test::drive;
use crate::agent::{Agent, LinearAgent};
use crate::clock::thread_cpu_ns;
use crate::policy::Outputs;
use crate::reference::MeanPolicy;
use crate::runtime::{Controller, PlantSide};
use crate::scenario::{Plan, Rule};
use crate::wire::{Command, Observation};

/// Ticks between two reports of progress, so that a slow learner's run stops soon.
const REPORT: u64 = 16;

/// Ticks until the next test, `since` ticks after the beginning or the change: 50 within the first 200, then 100 up to
/// 1,000, 200 up to 4,000, and then a tenth of what has passed.
pub(super) fn test_interval(since: u64) -> u64 {
    match since {
        0..200 => 50,
        200..1_000 => 100,
        1_000..4_000 => 200,
        _ => since / 10,
    }
}

/// An agent that can be tested: what it has learned so far answers inputs, without exploration noise, and learns
/// nothing from the test.
pub(super) trait TestedAgent: Agent {
    /// The answers of the agent as it is now.
    fn answers(&self, plan: &Plan) -> impl FnMut(&Observation) -> Outputs;
}

impl TestedAgent for LinearAgent {
    fn answers(&self, plan: &Plan) -> impl FnMut(&Observation) -> Outputs {
        let mut mean = MeanPolicy::new(plan);
        let inputs = plan.inputs.len();
        move |observation| mean.command(self.linear_policy(), &observation.inputs[..inputs])
    }
}

/// Runs a rule and tests it. `None` once `go_on` returns false.
pub(super) fn run(task: &TaskPlan, rule: Rule, seed: u64, go_on: &dyn Fn(u64) -> bool) -> Option<RunResult> {
    let plan = task.of_run(rule, seed)?;
    run_agent(task, &plan, plan.linear_agent(), go_on)
}

/// Runs an agent and tests it at intervals, at the change and at the end. `None` once `go_on` returns false.
pub(super) fn run_agent<A: TestedAgent>(
    task: &TaskPlan,
    plan: &Plan,
    agent: A,
    go_on: &dyn Fn(u64) -> bool,
) -> Option<RunResult> {
    let mut side = PlantSide::new(plan.simulated_plant()?, plan);
    let mut controller = Controller::with_agent(plan, agent);
    let (mut observation, mut command) = (Observation::default(), Command::default());
    let change = task.change();
    let (mut tests, mut begins, mut next, mut used_ns) = (Vec::new(), 0, test_interval(0), 0);
    for tick in 0..task.ticks {
        side.observe(tick, 0, 0, &mut observation);
        let began = thread_cpu_ns();
        controller.respond(&observation, &mut command);
        controller.after_command(&observation);
        used_ns += thread_cpu_ns() - began;
        side.step(tick, Some(&command));

        let done = tick + 1;
        if done.is_multiple_of(REPORT) && !go_on(REPORT) {
            return None;
        }
        if done == next || done == task.ticks || change == Some(done) {
            let changed = begins > 0;
            let mut answers = controller.agent().answers(plan);
            let score = drive(task, changed, false, |view| answers(view.observation), &|| go_on(0))?;
            tests.push(PhaseTest { tick: done, changed, score });
            if change == Some(done) {
                begins = done;
            }
            next = done + test_interval(done - begins);
        }
    }
    go_on(task.ticks % REPORT);
    let diverged = controller.halted();
    Some(RunResult { tests, diverged, ms_per_tick: used_ns as f64 / 1e6 / task.ticks as f64 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tests_come_at_intervals_that_grow() {
        let (mut at, mut tests) = (0, vec![]);
        while at < 100_000 {
            at += test_interval(at);
            tests.push(at);
        }
        assert!([50, 100, 200, 300, 1000, 1200, 2400].iter().all(|tick| tests.contains(tick)), "{tests:?}");
        assert!(tests.len() < 80, "{}", tests.len());
    }
}
