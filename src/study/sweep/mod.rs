//! `tectum sweep`: a scenario with all combinations of some settings, over seeds.
//!
//! Any key of the scenario can be set, and any plant can be swept: a simulated one runs in this process, and a program
//! of one's own runs in lockstep with its own processes, one run at a time. A row has what the run's report says:
//! losses, errors, and the hash of what was learned. So a row is a function of scenario, settings and seed.

mod definition;
mod labels;
mod run;
mod settings;
mod table;

pub use settings::SweepSetting;

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::Serialize;

use super::opened_study::OpenedStudy;
use super::{KeptJob, SeedRange, StudyEnd, StudyError, StudyHead, StudyPart, StudyPlace, WorkerPool};
use crate::clock::{machine_facts, monotonic_ns};
use crate::report::figure::{SweepFigure, SweepFigureRow, draw_sweep};
use crate::scenario::{Plan, Scenario};
use crate::stats::Spread;
use labels::labels;
use run::SweepRun;
use settings::{Combination, combinations};

/// The name of this study in its rows.
const STUDY: &str = "sweep";

/// What to sweep.
#[derive(Debug, Clone)]
pub struct Sweep {
    /// The scenario.
    pub scenario: Scenario,
    /// The settings, each with its values.
    pub settings: Vec<SweepSetting>,
    /// The seeds.
    pub seeds: SeedRange,
    /// Ticks of each run; `None` for the scenario's.
    pub ticks: Option<u64>,
    /// Folder for the files; `None` for `runs/sweep-<scenario>-<n>`.
    pub out: Option<PathBuf>,
    /// Where the runs are kept.
    pub place: StudyPlace,
    /// Show a progress line on standard error, if that is a terminal.
    pub progress: bool,
}

/// One combination of settings over all seeds.
#[derive(Debug, Clone, Default, Serialize)]
struct SweepRow {
    /// Values by key, in TOML.
    settings: BTreeMap<String, String>,
    /// Ticks of each run.
    ticks: u64,
    /// Mean loss a tick (reward with its sign turned) over the first twentieth of the run.
    first_loss: Option<Spread>,
    /// The same over the last twentieth,
    loss: Option<Spread>,
    /// and without what exploration noise alone costs, where that is known.
    loss_without_noise: Option<Spread>,
    /// Mean error at the end of a target over the last twentieth, in the plant's unit; null where it measures none.
    end_error: Option<Spread>,
    /// Ticks without a command that was applied.
    missed: Vec<u64>,
    /// The tick at which the learner was no longer finite, one per seed; null where it is.
    diverged: Vec<Option<u64>>,
    /// Hash of what was learned, one per seed.
    weights_hash: Vec<String>,
}

/// The result of [`sweep`].
#[derive(Debug, Clone, Serialize)]
pub struct SweepResult {
    /// The scenario's name.
    scenario: String,
    /// The seeds, in the order of all lists.
    seeds: Vec<u64>,
    /// One row for each combination.
    rows: Vec<SweepRow>,
    /// Version and commit.
    build: &'static str,
    /// Seconds that it took.
    seconds: f64,
    /// The machine.
    machine: BTreeMap<String, String>,
    /// The folder with the files.
    folder: PathBuf,
    /// The figure.
    figure: PathBuf,
    /// The tables.
    csv: Vec<PathBuf>,
    #[serde(skip)]
    error_unit: &'static str,
    /// Period of a tick, s; 0 where the combinations have different ones, whose curves are drawn over ticks.
    #[serde(skip)]
    period_s: f64,
    #[serde(skip)]
    names: Vec<String>,
    #[serde(skip)]
    runs: Vec<Vec<SweepRun>>,
}

/// Runs all combinations with all seeds.
///
/// # Errors
/// When a setting is invalid, a run fails, a file cannot be written, or a signal ends the sweep.
pub fn sweep(sweep: &Sweep) -> Result<StudyEnd<SweepResult>, StudyError> {
    let combinations = combinations(sweep)?;
    let pool = WorkerPool::new(sweep.progress)?;
    let head = StudyHead::new(STUDY, definition::of(sweep), definition::origin(sweep), sweep.seeds);
    let name = format!("sweep-{}", sweep.scenario.name);
    let study = OpenedStudy::open(&sweep.place, sweep.out.as_deref(), &name, head)?;
    let began = monotonic_ns();
    let seeds = sweep.seeds.seeds();
    let mut jobs: Vec<KeptJob<Plan>> = Vec::new();
    for Combination { name, plan, .. } in &combinations {
        for &seed in &seeds {
            let plan = with_seed(plan, seed)?;
            let name = format!("{name} seed {seed}").trim().to_owned();
            jobs.push(KeptJob { name, ticks: plan.scenario.ticks, job: plan });
        }
    }
    let runner = run::SweepRunner::new(pool.signals());
    let runs = pool.run_kept("sweep", &study.rows, &jobs, |plan, progress| runner.run(plan, progress))?;
    let Some(folder) = &study.folder else { return Ok(StudyEnd::Part(StudyPart::of(&study.rows))) };
    folder.keep();
    let runs: Vec<Vec<SweepRun>> = runs.chunks(seeds.len().max(1)).map(<[SweepRun]>::to_vec).collect();
    let path = |name: &str| folder.path().join(name);
    let result = SweepResult {
        scenario: sweep.scenario.name.clone(),
        seeds,
        rows: combinations.iter().zip(&runs).map(|(one, runs)| SweepRow::of(one, runs)).collect(),
        build: crate::BUILD,
        seconds: (monotonic_ns() - began) as f64 / 1e9,
        machine: machine_facts(),
        folder: folder.path().to_owned(),
        figure: path("figure.svg"),
        csv: vec![path("sweep.csv"), path("curves.csv")],
        error_unit: combinations.first().map_or("", |one| one.plan.error_unit()),
        period_s: common_period_s(&combinations).unwrap_or(0.0),
        names: combinations.iter().map(|one| one.name.clone()).collect(),
        runs,
    };
    result.write()?;
    Ok(StudyEnd::Whole(result))
}

/// The period of a tick that all combinations have, s.
fn common_period_s(combinations: &[Combination]) -> Option<f64> {
    let (first, rest) = combinations.split_first()?;
    let period_ns = first.plan.period_ns;
    rest.iter().all(|one| one.plan.period_ns == period_ns).then_some(period_ns as f64 / 1e9)
}

/// The plan with another seed.
fn with_seed(plan: &Plan, seed: u64) -> Result<Plan, StudyError> {
    let scenario = Scenario { seed, ..plan.scenario.clone() };
    let (name, folder) = (scenario.source.name().to_owned(), scenario.source.folder().map(std::path::Path::to_owned));
    Ok(scenario.plan()?.with_origin(&name, folder.as_deref()))
}

impl SweepRow {
    fn of(combination: &Combination, runs: &[SweepRun]) -> Self {
        let over = |value: &dyn Fn(&SweepRun) -> Option<f64>| Spread::of(runs.iter().filter_map(value));
        Self {
            settings: combination.values.iter().cloned().collect(),
            ticks: combination.plan.scenario.ticks,
            first_loss: over(&|run| Some(run.ends()?[0].loss)),
            loss: over(&|run| Some(run.ends()?[1].loss)),
            loss_without_noise: over(&|run| Some(run.ends()?[1].loss_without_noise())),
            end_error: over(&|run| run.ends()?[1].end_error),
            missed: runs.iter().map(|run| run.missed).collect(),
            diverged: runs.iter().map(|run| run.diverged_at).collect(),
            weights_hash: runs.iter().map(|run| run.weights_hash.clone()).collect(),
        }
    }
}

impl SweepResult {
    fn write(&self) -> Result<(), StudyError> {
        table::write_tables(self)?;
        let seeds = super::reproduce::seeds_in_words(&self.seeds);
        let loss = |run: &SweepRun| run.ends().map_or(f64::NAN, |ends| ends[1].loss);
        let rows = labels(&self.rows).into_iter().zip(&self.runs).map(|(name, runs)| SweepFigureRow {
            name,
            values: runs.iter().map(loss).collect(),
            runs: runs.iter().map(|run| run.windows.clone()).collect(),
        });
        let title = format!("Sweep over {}, {seeds}: a dot per seed, a bar at the median", self.scenario);
        let (unit, period_s) = (self.error_unit.to_owned(), self.period_s);
        draw_sweep(&SweepFigure { title, unit, period_s, rows: rows.collect() }, &self.figure)?;
        super::error::write_file(&self.folder.join("result.json"), self.to_json())
    }

    /// The result as one JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }
}
