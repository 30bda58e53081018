//! What all experiments share: plans over seeds, runs on all cores, the folder with the results, and the
//! facts of the study.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::ReproduceSettings;
use crate::clock::{machine_facts, monotonic_ns};
use crate::runtime::{Controller, simulate};
use crate::scenario::{Plan, Scenario};
use crate::study::error::write_file;
use crate::study::opened_study::OpenedStudy;
use crate::study::{JobProgress, KeptJob, StudyEnd, StudyError, StudyHead, StudyPart, WorkerPool};
use crate::wire::Observation;

/// Ticks between two reports of progress; a power of two that the slowest learner passes within seconds.
const REPORT: u64 = 256;

impl ReproduceSettings {
    /// The seeds, in the order of all lists of a result.
    pub(super) fn seeds(&self) -> Vec<u64> {
        self.seeds.seeds()
    }

    /// One plan per seed of the built-in scenario `name`, changed by `change`. The plans have the scenario's
    /// ticks or those of the settings.
    pub(super) fn plans(&self, name: &str, change: impl Fn(&mut Scenario)) -> Result<Vec<Plan>, StudyError> {
        let plan = |seed| {
            let mut scenario = Scenario::built_in(name)?;
            scenario.seed = seed;
            change(&mut scenario);
            scenario.ticks = self.ticks.unwrap_or(scenario.ticks);
            Ok(scenario.plan()?)
        };
        self.seeds().into_iter().map(plan).collect()
    }

    /// Runs `work` for all `plans` and gives the results in their order. `name` is the experiment's name.
    ///
    /// The folder is made before the first run, so that a place that cannot be written is reported at once.
    pub(super) fn run<T: Serialize + DeserializeOwned + Send>(
        &self,
        name: &str,
        plans: Vec<Plan>,
        work: impl Fn(&Plan, &JobProgress) -> T + Sync,
    ) -> Result<StudyEnd<Experiment<T>>, StudyError> {
        let pool = WorkerPool::new(self.progress)?;
        let name = name.replace(' ', "-");
        let head =
            StudyHead::new(&format!("reproduce {name}"), json!({ "ticks": self.ticks }), json!(null), self.seeds);
        let study = OpenedStudy::open(&self.place, self.out.as_deref(), &format!("reproduce-{name}"), head)?;
        let began = monotonic_ns();
        let per_variant = self.seeds().len();
        let job = |(i, plan): (usize, &Plan)| KeptJob {
            name: format!("{} {} seed {}", i / per_variant, plan.scenario.name, plan.scenario.seed),
            ticks: plan.scenario.ticks,
            job: plan.clone(),
        };
        let jobs: Vec<_> = plans.iter().enumerate().map(job).collect();
        let whole = |plan: &Plan, progress: &JobProgress| {
            let run = work(plan, progress);
            // One that had to stop is not whole.
            Ok(progress.report(0).then_some(run))
        };
        let runs = pool.run_kept(&name, &study.rows, &jobs, whole)?;
        let Some(folder) = &study.folder else { return Ok(StudyEnd::Part(StudyPart::of(&study.rows))) };
        let seconds = (monotonic_ns() - began) as f64 / 1e9;
        folder.keep();
        let facts = ExperimentFacts { seconds, machine: machine_facts(), folder: folder.path().to_owned() };
        Ok(StudyEnd::Whole(Experiment { plans, runs, per_variant, facts }))
    }
}

/// The runs of an experiment. Its variants follow each other; each variant has one run per seed.
pub(super) struct Experiment<T> {
    pub plans: Vec<Plan>,
    pub runs: Vec<T>,
    per_variant: usize,
    pub facts: ExperimentFacts,
}

impl<T> Experiment<T> {
    /// For each variant, the plan of its first run, and its runs in the order of the seeds.
    pub fn variants(&self) -> impl Iterator<Item = (&Plan, &[T])> {
        let plans = self.plans.chunks(self.per_variant).map(|plans| &plans[0]);
        plans.zip(self.runs.chunks(self.per_variant))
    }
}

/// How long an experiment took, and where; the last keys of every result.
#[derive(Debug, Clone, Serialize)]
pub(super) struct ExperimentFacts {
    /// Seconds that all runs took together.
    pub seconds: f64,
    /// The machine.
    pub machine: BTreeMap<String, String>,
    /// The folder with the files.
    pub folder: PathBuf,
}

impl ExperimentFacts {
    /// The path of a file in the folder.
    pub fn path(&self, file: &str) -> PathBuf {
        self.folder.join(file)
    }

    /// Writes the result as JSON into the folder.
    pub fn write_json(&self, json: &str) -> Result<(), StudyError> {
        write_file(&self.path("result.json"), json)
    }
}

/// How the learner of one run ended.
#[derive(Serialize, Deserialize)]
pub(super) struct LearnerEnd {
    /// XXH3-64 of the final weights, hexadecimal.
    pub weights_hash: String,
    /// The tick at which the weights were no longer numbers; `None` if they are.
    pub diverged_at: Option<u64>,
}

impl LearnerEnd {
    /// The hashes and the ticks of divergence of several runs.
    pub fn lists<'a>(ends: impl Iterator<Item = &'a Self> + Clone) -> (Vec<String>, Vec<Option<u64>>) {
        (ends.clone().map(|end| end.weights_hash.clone()).collect(), ends.map(|end| end.diverged_at).collect())
    }
}

/// Runs `plan` in one process. `observe` gets every observation before the controller answers it.
pub(super) fn run(
    plan: &Plan,
    progress: &JobProgress,
    mut observe: impl FnMut(&Observation, &Controller),
) -> LearnerEnd {
    let Some(body) = plan.simulated_plant() else { unreachable!("the built-in scenarios use simulated plants") };
    let result = simulate(plan, body, Controller::new(plan), &mut |observation, controller| {
        observe(observation, controller);
        !observation.header.tick.is_multiple_of(REPORT) || progress.report(REPORT)
    });
    LearnerEnd { weights_hash: result.controller.weights_hash, diverged_at: result.controller.diverged_at }
}

/// `5 seeds from 1`, or `seed 1`.
pub(in crate::study) fn seeds_in_words(seeds: &[u64]) -> String {
    match seeds {
        [seed] => format!("seed {seed}"),
        seeds => format!("{} seeds from {}", seeds.len(), seeds.first().unwrap_or(&0)),
    }
}
