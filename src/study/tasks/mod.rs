//! `tectum tasks`: every learner on every task, beside controllers that know nothing and controllers that know the true
//! plant.
//!
//! A task is a simulated plant with its settings ([`crate::plant::task`]). Every learner runs on every task with every
//! seed, in one process without transport. At intervals what it has learned is tested without exploration noise on the
//! same starts and targets for all; the test decides when the task's level (`levels`) is reached. Everything but
//! times is a function of tasks, controllers and seeds.

mod candidate;
mod files;
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
use std::path::PathBuf;

use serde::Serialize;

use super::{StudyError, WorkerPool};
use crate::clock::{machine_facts, monotonic_ns};
use crate::plant::task::{self, Task};
use crate::scenario::{nearest_name, word_list};
use crate::supervise::RunFolder;
use files::TaskRuns;
use outcome::RunResult;
use plan::TaskPlan;

/// What to measure.
#[derive(Debug, Clone)]
pub struct TaskStudy {
    /// Names of tasks; empty for the usual ones.
    pub tasks: Vec<String>,
    /// Names of learners and reference controllers, or paths of scenarios with a controller or settings of one's own;
    /// empty for all that have names.
    pub candidates: Vec<String>,
    /// Number of seeds.
    pub seeds: u64,
    /// First seed.
    pub first_seed: u64,
    /// Length of every run, ticks; `None` for each task's usual length.
    pub ticks: Option<u64>,
    /// The folder for table, curves and figures; none without one.
    pub out: Option<PathBuf>,
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
    /// The runs of each entry, for the files.
    #[serde(skip)]
    runs: Vec<TaskRuns>,
    /// The folder with the files.
    #[serde(skip_serializing_if = "Option::is_none")]
    folder: Option<PathBuf>,
}

/// One job of the pool: a controller on a task, with one seed.
struct Job<'a> {
    task: &'a TaskPlan,
    candidate: &'a Candidate,
    /// The controller's place among those that were asked for.
    place: usize,
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
    let folder = study.out.as_deref().map(|out| RunFolder::create(Some(out), None, "tasks")).transpose()?;
    let began = monotonic_ns();
    let jobs = jobs(study, &plans, &candidates);
    let ticks = jobs.iter().map(|job| job.candidate.ticks(job.task)).sum();
    let results = pool.run("tasks", ticks, &jobs, |job, progress| {
        let result = job.candidate.run(job.task, job.seed, progress);
        if result.is_err() {
            progress.stop_all();
        }
        result
    })?;
    // Several programs may have failed at once: the first says why.
    let results = results.into_iter().collect::<Result<Vec<_>, _>>()?;
    let seconds = (monotonic_ns() - began) as f64 / 1e9;
    let (tasks, runs) = outcomes(&jobs, results).into_iter().unzip();
    let path = folder.as_ref().map(|folder| folder.path().to_owned());
    let table = TaskTable { tasks, build: crate::BUILD, machine: machine_facts(), seconds, runs, folder: path };
    if let Some(folder) = folder {
        folder.keep();
        files::write(&table, folder.path())?;
    }
    Ok(table)
}

/// All jobs: the references, which are the same for all seeds, and then seed by seed.
fn jobs<'a>(study: &TaskStudy, plans: &'a [TaskPlan], candidates: &'a [Candidate]) -> Vec<Job<'a>> {
    let mut jobs = Vec::new();
    for task in plans {
        for (place, candidate) in candidates.iter().enumerate().filter(|(_, candidate)| candidate.serves(task)) {
            let seeds = if candidate.is_reference() { 1 } else { study.seeds };
            jobs.extend((0..seeds).map(|i| Job { task, candidate, place, seed: study.first_seed + i }));
        }
    }
    // The longest first, so that no core works alone on a long one at the end. The sort keeps the order of equal ones.
    jobs.sort_by_key(|job| std::cmp::Reverse(job.candidate.estimated_ns(job.task)));
    jobs
}

/// The results by task and controller, in the order in which they were asked for.
fn outcomes(jobs: &[Job], results: Vec<Option<RunResult>>) -> Vec<(TaskOutcome, TaskRuns)> {
    let mut found: BTreeMap<(usize, usize), Vec<(&Job, RunResult)>> = BTreeMap::new();
    for (job, result) in jobs.iter().zip(results) {
        if let Some(result) = result {
            found.entry((job.task.number, job.place)).or_default().push((job, result));
        }
    }
    let of = |mut runs: Vec<(&Job, RunResult)>| {
        runs.sort_by_key(|(job, _)| job.seed);
        let job = runs.first()?.0;
        let runs: TaskRuns = runs.into_iter().map(|(job, result)| (job.seed, result)).collect();
        Some((TaskOutcome::of(job.task, job.candidate, &runs), runs))
    };
    found.into_values().filter_map(of).collect()
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
    let of = |name: &String| match Candidate::of_path(name)? {
        Some(own) => Ok(own),
        None => named(&all, name),
    };
    let candidates: Vec<Candidate> = study.candidates.iter().map(of).collect::<Result<_, _>>()?;
    let names: Vec<String> = candidates.iter().map(Candidate::name).collect();
    unique("--learner", &names.iter().map(String::as_str).collect::<Vec<_>>())?;
    Ok(candidates)
}

/// The one of `all` with this name.
fn named(all: &[Candidate], name: &str) -> Result<Candidate, StudyError> {
    all.iter().find(|candidate| candidate.name() == name).cloned().ok_or_else(|| {
        let known: Vec<String> = all.iter().map(Candidate::name).collect();
        let remedy = match nearest_name(name, known.iter().map(String::as_str)) {
            Some(nearest) => format!("did you mean {nearest:?}?"),
            None => format!(
                "the learners and reference controllers are {}, and a scenario file (NAME.toml) is one of your own",
                word_list(&known, "and")
            ),
        };
        StudyError::Asked(format!("there is no learner {name:?}; {remedy}"))
    })
}

fn unique(option: &str, names: &[&str]) -> Result<(), StudyError> {
    match names.iter().enumerate().find(|(i, name)| names[..*i].contains(name)) {
        Some((_, name)) => Err(StudyError::Asked(format!("{option} names {name} twice; name each once"))),
        None => Ok(()),
    }
}
