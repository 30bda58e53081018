//! The run of one learner on one task with one seed: its tests, and the processor time of its ticks.

use super::candidate::Candidate;
use super::outcome::{PhaseTest, RunResult};
use super::plan::TaskPlan;
use super::test::{TestScore, TestView, drive};
use crate::reference::TestPercept;
use crate::runtime::{PipeError, PlantSide};
use crate::scenario::Plan;
use crate::study::subject::Subject;
use crate::study::{JobProgress, StudyError};
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

/// Runs a learner and tests it at intervals, at the change and at the end. `None` if the study has to stop before.
///
/// # Errors
/// When the learner is a program of one's own, and fails.
pub(super) fn run(
    task: &TaskPlan,
    learner: &Candidate,
    seed: u64,
    progress: &JobProgress,
) -> Result<Option<RunResult>, StudyError> {
    let Some(plan) = task.of_run(learner, seed) else { return Ok(None) };
    match run_subject(task, &plan, progress) {
        // The pool says it of the whole study.
        Err(PipeError::Interrupted { .. }) => Ok(None),
        other => other.map_err(|error| {
            let name = format!("{} on {}", learner.name(), task.task.name);
            StudyError::Controller { name, seed, error }
        }),
    }
}

fn run_subject(task: &TaskPlan, plan: &Plan, progress: &JobProgress) -> Result<Option<RunResult>, PipeError> {
    let Some(plant) = plan.simulated_plant() else { return Ok(None) };
    let (mut side, mut subject) = (PlantSide::new(plant, plan), Subject::new(plan, progress)?);
    let (mut observation, mut command) = (Observation::default(), Command::default());
    let change = task.change();
    let (mut tests, mut begins, mut next, mut used_ns) = (Vec::new(), 0, test_interval(0), 0);
    for tick in 0..task.ticks {
        side.observe(tick, 0, 0, &mut observation);
        let began = subject.cpu_ns();
        subject.respond(&observation, &mut command)?;
        subject.after_command(&observation)?;
        used_ns += subject.cpu_ns().saturating_sub(began);
        side.keep_ahead(subject.ahead());
        side.step(tick, Some(&command));

        let done = tick + 1;
        if done.is_multiple_of(REPORT) && !progress.report(REPORT) {
            return Ok(None);
        }
        if done == next || done == task.ticks || change == Some(done) {
            let changed = begins > 0;
            let Some(score) = test(task, plan, &mut subject, (done, changed), progress)? else { return Ok(None) };
            tests.push(PhaseTest { tick: done, changed, score });
            if change == Some(done) {
                begins = done;
            }
            next = done + test_interval(done - begins);
        }
    }
    progress.report(task.ticks % REPORT);
    let diverged = subject.finish()?.diverged_at.is_some();
    Ok(Some(RunResult { tests, diverged, ms_per_tick: used_ns as f64 / 1e6 / task.ticks as f64 }))
}

/// Tests what was learned in the first `done` ticks; `None` if the study has to stop.
fn test(
    task: &TaskPlan,
    plan: &Plan,
    subject: &mut Subject,
    (done, changed): (u64, bool),
    progress: &JobProgress,
) -> Result<Option<TestScore>, PipeError> {
    let (inputs, outputs) = (plan.inputs.len(), plan.outputs.len());
    let mut frozen = subject.frozen(plan, done)?;
    let mut ticks = 0..;
    let control = |view: &TestView| {
        let observation = view.observation;
        let (inputs, applied) = (&observation.inputs[..inputs], &observation.applied[..outputs]);
        let (tick, flags) = (ticks.next().unwrap_or_default(), observation.header.flags);
        frozen.command(&TestPercept { tick, inputs, applied, flags })
    };
    let score = drive(task, changed, false, control, &|| progress.report(0));
    frozen.end()?;
    Ok(score)
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
