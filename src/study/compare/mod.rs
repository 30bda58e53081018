//! `tectum compare`: how many ticks each learner needs, how it recovers from changes of the arm, and what a
//! tick costs.
//!
//! Every learner runs with every seed, in one process without transport, on the built-in arm. At intervals
//! the policy is tested without exploration noise on the [test set](crate::reference), which is the same for
//! all learners; the loss in this test is the only measure of learning. A controller's program of one's own is
//! a child, and is tested over the same pipe (`study/subject.rs`). The tick at which the level is reached, or a
//! change is recovered from, is known to the interval between tests, `test_interval` in `run.rs`. Everything
//! except times is a function of learners and seeds.

mod change;
mod cost;
mod definition;
mod files;
mod jobs;
mod learner_entry;
mod outcome;
mod references;
mod run;
mod table;

pub use change::{ArmChange, ArmChangeKind};
use cost::TickCost;
pub(super) use learner_entry::without_line;
pub use learner_entry::{Changes, ComparedLearner, LEARNERS, learner};
pub(crate) use learner_entry::{LearnerEntry, colour_number, is_path, name_of};
use outcome::{DECADES, LearnerOutcome, SeedRow};
use references::{Condition, ReferenceScores, ReferenceTable, conditions};
use run::LearnerRun;

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::Serialize;

use super::opened_study::OpenedStudy;
use super::{SeedRange, StudyEnd, StudyError, StudyHead, StudyPart, StudyPlace, WorkerPool};
use crate::clock::{machine_facts, monotonic_ns};
use crate::reference::{LEVEL, TARGETS};

/// The name of this study in its rows.
pub(super) const STUDY: &str = "compare";

/// What to compare.
#[derive(Debug, Clone)]
pub struct Comparison {
    /// The learners, each once.
    pub learners: Vec<ComparedLearner>,
    /// The seeds.
    pub seeds: SeedRange,
    /// Length of every run, ticks; `None` for each learner's usual length.
    pub ticks: Option<u64>,
    /// The changes of the arm.
    pub changes: Changes,
    /// Settings in TOML such as `learner.beta=0.5`, for all learners.
    pub settings: Vec<String>,
    /// First guesses for each movement of the trajectory optimum.
    pub starts: usize,
    /// Seed of the test's targets; [`TEST_SEED`](crate::reference::TEST_SEED) is the one that learners were tuned with.
    pub test_seed: u64,
    /// The folder; `None` for `runs/compare-<n>`.
    pub out: Option<PathBuf>,
    /// Where the runs are kept.
    pub place: StudyPlace,
    /// Show a progress line on standard error, if that is a terminal.
    pub progress: bool,
}

/// The result of a comparison: the object of `--json`.
#[derive(Debug, Clone, Serialize)]
pub struct ComparisonResult {
    /// The loss to reach: [`LEVEL`].
    level: f64,
    /// The seeds, in the order of all lists.
    seeds: Vec<u64>,
    /// One entry per learner.
    learners: Vec<LearnerOutcome>,
    /// The scores of the reference controllers.
    references: ReferenceTable,
    /// The test: targets, ticks of each, seed.
    test: TestFacts,
    /// Version and commit.
    build: &'static str,
    /// The machine.
    machine: BTreeMap<String, String>,
    /// Seconds that the comparison took.
    seconds: f64,
    /// The folder with the files.
    folder: PathBuf,
    /// Rows by learner and seed, for the files.
    #[serde(skip)]
    rows: Vec<Vec<SeedRow>>,
    /// Runs by learner and seed, for the files.
    #[serde(skip)]
    runs: Vec<Vec<LearnerRun>>,
}

/// How the test was made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
struct TestFacts {
    /// Number of targets.
    targets: usize,
    /// Ticks for each.
    ticks_a_target: u64,
    /// Their seed.
    seed: u64,
}

/// Makes the comparison and writes its files into its folder.
///
/// # Errors
/// When an argument is invalid, the folder cannot be used, or a signal ends the comparison.
pub fn compare(comparison: &Comparison) -> Result<StudyEnd<ComparisonResult>, StudyError> {
    let entries = entries(comparison)?;
    let pool = WorkerPool::new(comparison.progress)?;
    let head = StudyHead::new(STUDY, definition::of(comparison), definition::origin(comparison), comparison.seeds);
    let study = OpenedStudy::open(&comparison.place, comparison.out.as_deref(), "compare", head)?;
    let began = monotonic_ns();
    // All learners meet the same changes, but maybe at different ticks, and a short run may have none.
    let most_changes = entries.iter().max_by_key(|entry| entry.changes.len());
    let conditions = most_changes.map_or_else(|| Ok(Vec::new()), |entry| conditions(entry, comparison.test_seed))?;
    let seeds = comparison.seeds.seeds();
    let runs = jobs::runs(&pool, &study.rows, &entries, &seeds, &conditions)?;
    let Some(folder) = &study.folder else { return Ok(StudyEnd::Part(StudyPart::of(&study.rows))) };
    let references = jobs::references(&pool, &study.rows, &conditions, comparison.starts)?;
    let rows = rows(&entries, &seeds, &runs, &references);
    let result = ComparisonResult {
        level: LEVEL,
        learners: learners(&entries, &rows, &runs),
        seeds,
        references,
        test: TestFacts {
            targets: TARGETS,
            ticks_a_target: conditions.first().map_or(0, |condition| condition.test.ticks_a_target()),
            seed: comparison.test_seed,
        },
        build: crate::BUILD,
        machine: machine_facts(),
        seconds: (monotonic_ns() - began) as f64 / 1e9,
        folder: folder.path().to_owned(),
        rows,
        runs,
    };
    folder.keep();
    files::write(&result)?;
    Ok(StudyEnd::Whole(result))
}

/// The learners, after a check of the arguments.
fn entries(comparison: &Comparison) -> Result<Vec<LearnerEntry>, StudyError> {
    let entry = |one| LearnerEntry::of(one, comparison.ticks, &comparison.changes, &comparison.settings);
    let entries: Vec<LearnerEntry> = comparison.learners.iter().map(entry).collect::<Result<_, _>>()?;
    for (i, LearnerEntry { name, .. }) in entries.iter().enumerate() {
        if entries[..i].iter().any(|before| before.name == *name) {
            let remedy = "name each learner once, and give each scenario a name of its own";
            return Err(StudyError::Asked(format!("--learners names {name} twice; {remedy}")));
        }
    }
    Ok(entries)
}

/// One row per learner and seed.
fn rows(
    entries: &[LearnerEntry],
    seeds: &[u64],
    runs: &[Vec<LearnerRun>],
    references: &ReferenceTable,
) -> Vec<Vec<SeedRow>> {
    let of_learner = |(entry, runs): (&LearnerEntry, &Vec<LearnerRun>)| {
        seeds.iter().zip(runs).map(|(&seed, run)| SeedRow::of(entry, seed, run, references)).collect()
    };
    entries.iter().zip(runs).map(of_learner).collect()
}

/// One outcome per learner, over all its seeds.
fn learners(entries: &[LearnerEntry], rows: &[Vec<SeedRow>], runs: &[Vec<LearnerRun>]) -> Vec<LearnerOutcome> {
    let outcome = |(entry, (rows, runs)): (&LearnerEntry, (&Vec<SeedRow>, &Vec<LearnerRun>))| {
        let costs: Vec<TickCost> = runs.iter().flat_map(|run| run.costs.iter().copied()).collect();
        LearnerOutcome::of(entry, rows, &costs)
    };
    entries.iter().zip(rows.iter().zip(runs)).map(outcome).collect()
}
