//! The run of one learner on one task with one seed: its tests, and the processor time of its ticks.

use super::outcome::{PhaseTest, RunResult};
use super::plan::TaskPlan;
use super::test::{TestScore, TestView, drive};
use crate::clock::thread_cpu_ns;
use crate::reference::{FrozenAgent, TestPercept};
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

/// Runs a rule and tests it at intervals, at the change and at the end. `None` once `go_on` returns false.
pub(super) fn run(task: &TaskPlan, rule: Rule, seed: u64, go_on: &dyn Fn(u64) -> bool) -> Option<RunResult> {
    let plan = task.of_run(rule, seed)?;
    let mut side = PlantSide::new(plan.simulated_plant()?, &plan);
    let mut controller = Controller::new(&plan);
    let (mut observation, mut command) = (Observation::default(), Command::default());
    let change = task.change();
    let (mut tests, mut begins, mut next, mut used_ns) = (Vec::new(), 0, test_interval(0), 0);
    for tick in 0..task.ticks {
        side.observe(tick, 0, 0, &mut observation);
        let began = thread_cpu_ns();
        controller.respond(&observation, &mut command);
        controller.after_command(&observation);
        used_ns += thread_cpu_ns() - began;
        side.keep_ahead(controller.ahead());
        side.step(tick, Some(&command));

        let done = tick + 1;
        if done.is_multiple_of(REPORT) && !go_on(REPORT) {
            return None;
        }
        if done == next || done == task.ticks || change == Some(done) {
            let changed = begins > 0;
            let score = test(task, &plan, &controller, changed, go_on)?;
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

/// Tests what the controller's agent knows.
fn test(
    task: &TaskPlan,
    plan: &Plan,
    controller: &Controller,
    changed: bool,
    go_on: &dyn Fn(u64) -> bool,
) -> Option<TestScore> {
    let (inputs, outputs) = (plan.inputs.len(), plan.outputs.len());
    let mut agent = FrozenAgent::of(controller.agent(), plan);
    let mut ticks = 0..;
    let control = |view: &TestView| {
        let observation = view.observation;
        let (inputs, applied) = (&observation.inputs[..inputs], &observation.applied[..outputs]);
        let (tick, flags) = (ticks.next().unwrap_or_default(), observation.header.flags);
        agent.command(&TestPercept { tick, inputs, applied, flags })
    };
    drive(task, changed, false, control, &|| go_on(0))
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
