//! `tectum compare`: how much experience each learner needs, how it gets over changes of its body, and what a tick of it costs.
//!
//! Every learner runs with every seed, in one process without transport, on the built-in arm. Every so often the policy is
//! taken aside and tested without exploration noise on the [yardstick](super::yardstick)'s targets, which are the same for
//! all; what it learned is told by that loss alone. An instant (the level reached, a change got over) is known to the
//! spacing of the tests, [`spacing`]. Everything but the times follows from learners and seeds.

mod change;
mod entrant;
mod files;
mod outcome;
mod run;
mod table;

pub use change::{Change, What};
pub use entrant::{Changes, Entrant, LEARNERS, name_of, rule};
pub use outcome::{ChangeOutcome, Costs, DECADES, LearnerOutcome, RECOVERED, Row, Times};
pub use run::{Cost, Course, Sample, spacing};

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::{Serialize, Serializer};

use super::yardstick::{LEVEL, Score, TARGETS, TEST_SEED, TestSet, World};
use super::{Crew, StudyError, Ticks};
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
pub struct Compared {
    /// The loss to reach: [`LEVEL`].
    pub level: f64,
    /// The seeds, in the order of all lists.
    pub seeds: Vec<u64>,
    /// One entry a learner.
    pub learners: Vec<LearnerOutcome>,
    /// What the yardstick's controllers reach.
    pub references: References,
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
    rows: Vec<Vec<Row>>,
    #[serde(skip)]
    courses: Vec<Vec<Course>>,
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
pub struct References {
    /// The world of the beginning, and that after each change.
    pub worlds: Vec<WorldReferences>,
}

/// What the yardstick's controllers reach in one world.
#[derive(Debug, Clone, PartialEq)]
pub struct WorldReferences {
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

impl References {
    /// The controllers by name, the one that knows least first.
    pub fn by_controller(&self) -> [(&'static str, Vec<Score>); 4] {
        let over = |score: fn(&WorldReferences) -> Score| self.worlds.iter().map(score).collect();
        [
            ("zero", over(|w| w.zero)),
            ("random", over(|w| w.random)),
            ("damped-least-squares", over(|w| w.damped_least_squares)),
            ("trajectory-optimum", over(|w| w.trajectory_optimum)),
        ]
    }
}

impl Serialize for References {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let worlds = || self.worlds.iter().map(|w| w.world.as_str());
        serializer.collect_map(
            self.by_controller().map(|(name, scores)| (name, worlds().zip(scores).collect::<BTreeMap<_, _>>())),
        )
    }
}

/// What a member of the crew does at a time.
enum Job {
    /// The references of one world.
    References(usize),
    /// One learner (its number) with one seed.
    Run(usize, u64),
}

enum Done {
    References(WorldReferences),
    Run(Course),
}

/// Makes the comparison and leaves its files in its folder.
///
/// # Errors
/// When something that was asked for makes no sense, the folder cannot be used, or a signal ends it.
pub fn compare(comparison: &Comparison) -> Result<Compared, StudyError> {
    let entrants = entrants(comparison)?;
    let crew = Crew::new(comparison.progress).map_err(LaunchError::Signals)?;
    let folder = RunFolder::create(comparison.out.as_deref(), None, "compare")?;
    let began = monotonic_ns();
    // The changes of all learners are the same, if not at the same ticks.
    let longest = entrants.iter().max_by_key(|entrant| entrant.changes.len());
    let (worlds, names) = longest.map_or_else(Default::default, worlds);
    let seeds: Vec<u64> = (0..comparison.seeds).map(|i| comparison.first_seed.saturating_add(i)).collect();
    let mut jobs: Vec<Job> = (0..worlds.len()).map(Job::References).collect();
    jobs.extend((0..entrants.len()).flat_map(|entrant| seeds.iter().map(move |&seed| Job::Run(entrant, seed))));
    let ticks_of = |entrant: &Entrant| entrant.plan.scenario.ticks;
    // The longest first, so that no core is left with one at the end.
    jobs.sort_by_key(|job| match job {
        Job::References(_) => 0,
        Job::Run(entrant, _) => {
            let entrant = &entrants[*entrant];
            u64::MAX - entrant.rough_ns.saturating_mul(ticks_of(entrant))
        }
    });
    let ticks = entrants.iter().map(|entrant| ticks_of(entrant) * comparison.seeds).sum();
    let work = |job: &Job, progress: &Ticks| match *job {
        Job::References(world) => {
            references(&names[world], &worlds[world], comparison.starts, progress).map(Done::References)
        }
        Job::Run(entrant, seed) => run::run(&entrants[entrant], seed, &worlds, progress).map(Done::Run),
    };
    let done = crew.work("compare", ticks, &jobs, work).map_err(StudyError::Signal)?;

    let mut references: Vec<Option<WorldReferences>> = vec![None; worlds.len()];
    let mut courses: Vec<BTreeMap<u64, Course>> = vec![BTreeMap::new(); entrants.len()];
    for (job, done) in jobs.iter().zip(done) {
        match (job, done) {
            (Job::References(world), Some(Done::References(found))) => references[*world] = Some(found),
            (Job::Run(entrant, seed), Some(Done::Run(course))) => drop(courses[*entrant].insert(*seed, course)),
            _ => {}
        }
    }
    let references = References { worlds: references.into_iter().flatten().collect() };
    let courses: Vec<Vec<Course>> = courses.into_iter().map(|seeds| seeds.into_values().collect()).collect();
    let rows: Vec<Vec<Row>> = entrants
        .iter()
        .zip(&courses)
        .map(|(entrant, courses)| {
            seeds.iter().zip(courses).map(|(&seed, course)| Row::of(entrant, seed, course, &references)).collect()
        })
        .collect();
    let learners = entrants.iter().zip(rows.iter().zip(&courses)).map(|(entrant, (rows, courses))| {
        let costs: Vec<Cost> = courses.iter().flat_map(|course| course.costs.iter().copied()).collect();
        LearnerOutcome::of(entrant, rows, &costs)
    });
    let compared = Compared {
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

fn entrants(comparison: &Comparison) -> Result<Vec<Entrant>, StudyError> {
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
        .map(|&rule| Entrant::new(rule, comparison.ticks, &comparison.changes, &comparison.settings))
        .collect()
}

/// The worlds that a learner goes through, with their names.
fn worlds(entrant: &Entrant) -> (Vec<TestSet>, Vec<String>) {
    let plan = &entrant.plan;
    let period_s = plan.scenario.period_ms / 1000.0;
    let table = plan.scenario.plant.arm.clone().unwrap_or_default();
    let world = |tick| TestSet::new(plan, World::at(&table, period_s, tick));
    let name = |change: &Change| match (&entrant.changes[..], change.what) {
        ([_], What::Block(..)) => "blocked".to_owned(),
        _ => format!("{} at {}", change.what, change.tick),
    };
    let first = (world(0), "unblocked".to_owned());
    std::iter::once(first).chain(entrant.changes.iter().map(|change| (world(change.tick), name(change)))).unzip()
}

fn references(name: &str, test: &TestSet, starts: usize, progress: &Ticks) -> Option<WorldReferences> {
    Some(WorldReferences {
        world: name.to_owned(),
        trajectory_optimum: test.optimum(starts, || progress.report(0))?,
        zero: test.zero(),
        random: test.random(),
        damped_least_squares: test.damped_least_squares(),
    })
}
