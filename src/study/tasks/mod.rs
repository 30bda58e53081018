//! `tectum tasks`: every learner on every task, beside controllers that know nothing and controllers that know the true
//! plant.
//!
//! A task is a simulated plant with its settings ([`crate::plant::task`]). Every learner runs on every task with every
//! seed, in one process without transport. At intervals what it has learned is tested without exploration noise on the
//! same starts and targets for all; the test decides when the task's level (`levels`) is reached. Everything but
//! times is a function of tasks, controllers and seeds.

mod candidate;
mod levels;
mod listing;
mod outcome;
mod plan;
mod references;
mod run;
mod table;
mod test;

pub use candidate::Candidate;
pub use listing::{listing, listing_json};
pub use outcome::TaskOutcome;
pub use references::ReferenceKind;

use std::collections::BTreeMap;

use serde::Serialize;

use super::{StudyError, WorkerPool};
use crate::clock::{machine_facts, monotonic_ns};
use crate::plant::task::{self, Task};
use crate::scenario::{nearest_name, word_list};
use outcome::RunResult;
use plan::TaskPlan;

/// What to measure.
#[derive(Debug, Clone)]
pub struct TaskStudy {
    /// Names of tasks; empty for the usual ones.
    pub tasks: Vec<String>,
    /// Names of learners and reference controllers; empty for all.
    pub candidates: Vec<String>,
    /// Number of seeds.
    pub seeds: u64,
    /// First seed.
    pub first_seed: u64,
    /// Length of every run, ticks; `None` for each task's usual length.
    pub ticks: Option<u64>,
    /// Show a progress line on standard error, if that is a terminal.
    pub progress: bool,
}

/// The public table: the object of `--json`.
#[derive(Debug, Clone, Serialize)]
pub struct TaskTable {
    /// One entry per task and controller.
    tasks: Vec<TaskOutcome>,
    /// Version and commit.
    build: &'static str,
    /// The machine.
    machine: BTreeMap<String, String>,
    /// Seconds that the study took.
    seconds: f64,
}

/// The runs of one controller on a task, with their seeds.
type TaskRuns<'a> = (&'a TaskPlan, Vec<(u64, RunResult)>);

/// One job of the pool: a controller on a task, with one seed.
struct Job<'a> {
    task: &'a TaskPlan,
    candidate: Candidate,
    seed: u64,
}

/// Measures the table.
///
/// # Errors
/// When an argument is invalid, or a signal ends the study.
pub fn measure(study: &TaskStudy) -> Result<TaskTable, StudyError> {
    let (tasks, candidates) = (tasks(study)?, candidates(study)?);
    if study.seeds == 0 {
        return Err(StudyError::Asked("--seeds is 0; give at least 1".to_owned()));
    }
    if study.first_seed.checked_add(study.seeds - 1).is_none_or(|last| last > crate::scenario::limits::MAX_SEED) {
        let text = "--first-seed and --seeds go beyond the largest seed; give smaller ones";
        return Err(StudyError::Asked(text.to_owned()));
    }
    let plans = tasks.into_iter().map(|task| TaskPlan::new(task, study.ticks)).collect::<Result<Vec<_>, _>>()?;
    // A plan that a rule refuses is found before anything runs.
    for plan in &plans {
        for candidate in &candidates {
            plan.check(candidate)?;
        }
    }
    let pool = WorkerPool::new(study.progress)?;
    let began = monotonic_ns();
    let jobs = jobs(study, &plans, &candidates);
    let ticks = jobs.iter().map(|job| job.candidate.ticks(job.task)).sum();
    let results = pool.run("tasks", ticks, &jobs, |job, progress| {
        job.candidate.run(job.task, job.seed, &|ticks| progress.report(ticks))
    })?;
    let seconds = (monotonic_ns() - began) as f64 / 1e9;
    Ok(TaskTable { tasks: outcomes(&jobs, results), build: crate::BUILD, machine: machine_facts(), seconds })
}

/// All jobs: the references, which are the same for all seeds, and then seed by seed.
fn jobs<'a>(study: &TaskStudy, plans: &'a [TaskPlan], candidates: &[Candidate]) -> Vec<Job<'a>> {
    let mut jobs = Vec::new();
    for task in plans {
        for candidate in candidates.iter().filter(|candidate| candidate.serves(task)) {
            let seeds = if candidate.is_reference() { 1 } else { study.seeds };
            jobs.extend((0..seeds).map(|i| Job { task, candidate: *candidate, seed: study.first_seed + i }));
        }
    }
    // The longest first, so that no core works alone on a long one at the end. The sort keeps the order of equal ones.
    jobs.sort_by_key(|job| std::cmp::Reverse(job.candidate.estimated_ns(job.task)));
    jobs
}

/// The results by task and controller, in the order in which they were asked for.
fn outcomes(jobs: &[Job], results: Vec<Option<RunResult>>) -> Vec<TaskOutcome> {
    let mut found: BTreeMap<(usize, Candidate), TaskRuns> = BTreeMap::new();
    for (job, result) in jobs.iter().zip(results) {
        if let Some(result) = result {
            let entry = found.entry((job.task.number, job.candidate)).or_insert_with(|| (job.task, Vec::new()));
            entry.1.push((job.seed, result));
        }
    }
    let of = |((_, candidate), (task, mut runs)): ((usize, Candidate), TaskRuns)| {
        runs.sort_by_key(|(seed, _)| *seed);
        TaskOutcome::of(task, candidate, &runs)
    };
    found.into_iter().map(of).collect()
}

/// The tasks that are named, or the usual ones.
fn tasks(study: &TaskStudy) -> Result<Vec<Task>, StudyError> {
    let names: Vec<&str> = match &study.tasks[..] {
        [] => task::USUAL.to_vec(),
        names => names.iter().map(String::as_str).collect(),
    };
    unique("--task", &names)?;
    names.iter().map(|name| Task::named(name).ok_or_else(|| unknown_task(name))).collect()
}

fn unknown_task(name: &str) -> StudyError {
    let names = task::names();
    let remedy = match nearest_name(name, names.iter().map(String::as_str)) {
        Some(nearest) => format!("did you mean {nearest:?}?"),
        None => "`tectum tasks --list` lists them".to_owned(),
    };
    StudyError::Asked(format!("there is no task {name:?}; {remedy}"))
}

/// The controllers that are named, or all.
fn candidates(study: &TaskStudy) -> Result<Vec<Candidate>, StudyError> {
    let all = Candidate::all();
    if study.candidates.is_empty() {
        return Ok(all);
    }
    let names: Vec<&str> = study.candidates.iter().map(String::as_str).collect();
    unique("--learner", &names)?;
    let of = |name: &&str| {
        all.iter().find(|candidate| candidate.name() == **name).copied().ok_or_else(|| {
            let known: Vec<String> = all.iter().map(Candidate::name).collect();
            let remedy = match nearest_name(name, known.iter().map(String::as_str)) {
                Some(nearest) => format!("did you mean {nearest:?}?"),
                None => format!("the learners and reference controllers are {}", word_list(&known, "and")),
            };
            StudyError::Asked(format!("there is no learner {name:?}; {remedy}"))
        })
    };
    names.iter().map(of).collect()
}

fn unique(option: &str, names: &[&str]) -> Result<(), StudyError> {
    match names.iter().enumerate().find(|(i, name)| names[..*i].contains(name)) {
        Some((_, name)) => Err(StudyError::Asked(format!("{option} names {name} twice; name each once"))),
        None => Ok(()),
    }
}
