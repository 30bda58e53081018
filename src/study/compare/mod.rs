//! `tectum compare`: how much experience each learner needs, how it gets over changes of its body, and what a tick of it costs.
//!
//! Every learner runs with every seed, in one process without transport, on the built-in arm. Every so often the policy is
//! taken aside and tested without exploration noise on the [yardstick](super::yardstick)'s targets, which are the same for
//! all; what it learned is told by that loss alone. An instant (the level reached, a change got over) is known to the
//! spacing of the tests, [`spacing`]. Everything but the times follows from learners and seeds.

mod change;
mod files;
mod learner_entry;
mod outcome;
mod run;
mod table;

pub use change::{ArmChange, ArmChangeKind};
pub use learner_entry::{Changes, LEARNERS, LearnerEntry, name_of, rule};
pub use outcome::{ChangeOutcome, Costs, DECADES, LearnerOutcome, RECOVERED, SeedRow, Times};
pub use run::{LearnerRun, PolicyTest, TickCost, spacing};

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::{Serialize, Serializer};

use super::reference::{FixedArm, LEVEL, Score, TARGETS, TEST_SEED, TestSet};
use super::{ChildProcesses, JobProgress, StudyError};
use crate::clock::{facts, monotonic_ns};
use crate::scenario::Rule;
use crate::supervise::{LaunchError, RunFolder};

/// What to compare.
#[derive(Debug, Clone)]
pub struct Comparison {
    /// The rules, each once.
    pub learners: Vec<Rule>,
    /// First seed.
    pub first_seed: u64,
    /// Number of seeds.
    pub seeds: u64,
    /// Length of every run, ticks; each learner's usual one if there is none.
    pub ticks: Option<u64>,
    /// What happens to the arm.
    pub changes: Changes,
    /// Settings in TOML such as `learner.beta=0.5`, for all learners.
    pub settings: Vec<String>,
    /// First guesses for each movement of the trajectory optimum.
    pub starts: usize,
    /// The folder; `runs/compare-<n>` if there is none.
    pub out: Option<PathBuf>,
    /// Show a progress line on standard error.
    pub progress: bool,
}

/// What came of it: the object of `--json`.
#[derive(Debug, Clone, Serialize)]
pub struct ComparisonResult {
    /// The loss to reach: [`LEVEL`].
    pub level: f64,
    /// The seeds, in the order of all lists.
    pub seeds: Vec<u64>,
    /// One entry a learner.
    pub learners: Vec<LearnerOutcome>,
    /// What the yardstick's controllers reach.
    pub references: ReferenceTable,
    /// The test: targets, ticks of each, seed.
    pub test: TestFacts,
    /// Version and commit.
    pub build: &'static str,
    /// What it ran on.
    pub machine: BTreeMap<String, String>,
    /// Seconds that it took.
    pub seconds: f64,
    /// The folder with the files.
    pub folder: PathBuf,
    /// Rows by learner and seed, for the files.
    #[serde(skip)]
    rows: Vec<Vec<SeedRow>>,
    #[serde(skip)]
    courses: Vec<Vec<LearnerRun>>,
}

/// How the test was made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct TestFacts {
    /// Number of targets.
    pub targets: usize,
    /// Ticks for each.
    pub ticks_a_target: u64,
    /// Their seed.
    pub seed: u64,
}

/// What the yardstick's controllers reach in the worlds of a comparison. In JSON, an object by controller, then by world.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceTable {
    /// The world of the beginning, and that after each change.
    pub worlds: Vec<ReferenceScores>,
}

/// What the yardstick's controllers reach in one world.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceScores {
    /// Name of the world.
    pub world: String,
    /// Standing still.
    pub zero: Score,
    /// The exploration noise alone.
    pub random: Score,
    /// Classical control with the true arm.
    pub damped_least_squares: Score,
    /// The best movements.
    pub trajectory_optimum: Score,
}

impl ReferenceTable {
    /// The controllers by name, the one that knows least first.
    pub fn by_controller(&self) -> [(&'static str, Vec<Score>); 4] {
        let over = |score: fn(&ReferenceScores) -> Score| self.worlds.iter().map(score).collect();
        [
            ("zero", over(|w| w.zero)),
            ("random", over(|w| w.random)),
            ("damped-least-squares", over(|w| w.damped_least_squares)),
            ("trajectory-optimum", over(|w| w.trajectory_optimum)),
        ]
    }
}

impl Serialize for ReferenceTable {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let worlds = || self.worlds.iter().map(|w| w.world.as_str());
        serializer.collect_map(
            self.by_controller().map(|(name, scores)| (name, worlds().zip(scores).collect::<BTreeMap<_, _>>())),
        )
    }
}

/// What a member of the crew does at a time.
enum ComparisonJob {
    /// The references of one world.
    References(usize),
    /// One learner (its number) with one seed.
    Run(usize, u64),
}

enum JobResult {
    References(ReferenceScores),
    Run(LearnerRun),
}

/// Makes the comparison and leaves its files in its folder.
///
/// # Errors
/// When something that was asked for makes no sense, the folder cannot be used, or a signal ends it.
pub fn compare(comparison: &Comparison) -> Result<ComparisonResult, StudyError> {
    let entries = entries(comparison)?;
    let pool = ChildProcesses::new(comparison.progress).map_err(LaunchError::Signals)?;
    let folder = RunFolder::create(comparison.out.as_deref(), None, "compare")?;
    let began = monotonic_ns();
    // The changes of all learners are the same, if not at the same ticks.
    let longest = entries.iter().max_by_key(|entry| entry.changes.len());
    let (worlds, names) = longest.map_or_else(Default::default, worlds);
    let seeds: Vec<u64> = (0..comparison.seeds).map(|i| comparison.first_seed.saturating_add(i)).collect();
    let mut jobs: Vec<ComparisonJob> = (0..worlds.len()).map(ComparisonJob::References).collect();
    jobs.extend((0..entries.len()).flat_map(|entry| seeds.iter().map(move |&seed| ComparisonJob::Run(entry, seed))));
    let ticks_of = |entry: &LearnerEntry| entry.plan.scenario.ticks;
    // The longest first, so that no core is left with one at the end.
    jobs.sort_by_key(|job| match job {
        ComparisonJob::References(_) => 0,
        ComparisonJob::Run(entry, _) => {
            let entry = &entries[*entry];
            u64::MAX - entry.rough_ns.saturating_mul(ticks_of(entry))
        }
    });
    let ticks = entries.iter().map(|entry| ticks_of(entry) * comparison.seeds).sum();
    let work = |job: &ComparisonJob, progress: &JobProgress| match *job {
        ComparisonJob::References(world) => {
            references(&names[world], &worlds[world], comparison.starts, progress).map(JobResult::References)
        }
        ComparisonJob::Run(entry, seed) => run::run(&entries[entry], seed, &worlds, progress).map(JobResult::Run),
    };
    let done = pool.work("compare", ticks, &jobs, work).map_err(StudyError::Signal)?;

    let mut references: Vec<Option<ReferenceScores>> = vec![None; worlds.len()];
    let mut courses: Vec<BTreeMap<u64, LearnerRun>> = vec![BTreeMap::new(); entries.len()];
    for (job, done) in jobs.iter().zip(done) {
        match (job, done) {
            (ComparisonJob::References(world), Some(JobResult::References(found))) => references[*world] = Some(found),
            (ComparisonJob::Run(entry, seed), Some(JobResult::Run(course))) => {
                drop(courses[*entry].insert(*seed, course))
            }
            _ => {}
        }
    }
    let references = ReferenceTable { worlds: references.into_iter().flatten().collect() };
    let courses: Vec<Vec<LearnerRun>> = courses.into_iter().map(|seeds| seeds.into_values().collect()).collect();
    let rows: Vec<Vec<SeedRow>> = entries
        .iter()
        .zip(&courses)
        .map(|(entry, courses)| {
            seeds.iter().zip(courses).map(|(&seed, course)| SeedRow::of(entry, seed, course, &references)).collect()
        })
        .collect();
    let learners = entries.iter().zip(rows.iter().zip(&courses)).map(|(entry, (rows, courses))| {
        let costs: Vec<TickCost> = courses.iter().flat_map(|course| course.costs.iter().copied()).collect();
        LearnerOutcome::of(entry, rows, &costs)
    });
    let compared = ComparisonResult {
        level: LEVEL,
        learners: learners.collect(),
        seeds,
        references,
        test: TestFacts {
            targets: TARGETS,
            ticks_a_target: worlds.first().map_or(0, TestSet::ticks_a_target),
            seed: TEST_SEED,
        },
        build: crate::BUILD,
        machine: facts(),
        seconds: (monotonic_ns() - began) as f64 / 1e9,
        folder: folder.path().to_owned(),
        rows,
        courses,
    };
    folder.keep();
    files::write(&compared)?;
    Ok(compared)
}

fn entries(comparison: &Comparison) -> Result<Vec<LearnerEntry>, StudyError> {
    let Comparison { learners, seeds, first_seed, .. } = comparison;
    if *seeds == 0 {
        return Err(StudyError::Asked("--seeds is 0; give at least 1".to_owned()));
    }
    if first_seed.checked_add(seeds - 1).is_none() {
        return Err(StudyError::Asked(
            "--first-seed and --seeds go beyond the largest seed; give smaller ones".to_owned(),
        ));
    }
    for (i, &rule) in learners.iter().enumerate() {
        if learners[..i].contains(&rule) {
            let name = name_of(rule);
            return Err(StudyError::Asked(format!("--learners names {name} twice; name each learner once")));
        }
    }
    learners
        .iter()
        .map(|&rule| LearnerEntry::new(rule, comparison.ticks, &comparison.changes, &comparison.settings))
        .collect()
}

/// The worlds that a learner goes through, with their names.
fn worlds(entry: &LearnerEntry) -> (Vec<TestSet>, Vec<String>) {
    let plan = &entry.plan;
    let period_s = plan.scenario.period_ms / 1000.0;
    let table = plan.scenario.plant.arm.clone().unwrap_or_default();
    let world = |tick| TestSet::new(plan, FixedArm::at(&table, period_s, tick));
    let name = |change: &ArmChange| match (&entry.changes[..], change.what) {
        ([_], ArmChangeKind::Block(..)) => "blocked".to_owned(),
        _ => format!("{} at {}", change.what, change.tick),
    };
    let first = (world(0), "unblocked".to_owned());
    std::iter::once(first).chain(entry.changes.iter().map(|change| (world(change.tick), name(change)))).unzip()
}

fn references(name: &str, test: &TestSet, starts: usize, progress: &JobProgress) -> Option<ReferenceScores> {
    Some(ReferenceScores {
        world: name.to_owned(),
        trajectory_optimum: test.optimum(starts, || progress.report(0))?,
        zero: test.zero(),
        random: test.random(),
        damped_least_squares: test.damped_least_squares(),
    })
}
