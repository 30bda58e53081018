//! The jobs of a comparison: one per learner and seed, and one per condition for the reference controllers.

use super::run::{self, LearnerRun};
use super::{Condition, LearnerEntry, ReferenceScores, ReferenceTable};
use crate::study::study_rows::StudyRows;
use crate::study::worker_pool::interrupted;
use crate::study::{JobProgress, KeptJob, StudyError, WorkerPool};

/// Runs all learners with all seeds, as far as `rows` do not have them. Gives the runs by learner, in the order of the
/// seeds.
pub(super) fn runs(
    pool: &WorkerPool,
    rows: &StudyRows,
    entries: &[LearnerEntry],
    seeds: &[u64],
    conditions: &[Condition],
) -> Result<Vec<Vec<LearnerRun>>, StudyError> {
    let jobs = jobs(entries, seeds);
    let work =
        |&(entry, seed): &(usize, u64), progress: &JobProgress| run::run(&entries[entry], seed, conditions, progress);
    let results = pool.run_kept("compare", rows, &jobs, work)?;
    let mut done: Vec<_> = jobs.iter().map(|job| job.job).zip(results).collect();
    done.sort_by_key(|(job, _)| *job);
    let mut runs: Vec<Vec<LearnerRun>> = vec![Vec::new(); entries.len()];
    done.into_iter().for_each(|((entry, _), run)| runs[entry].push(run));
    Ok(runs)
}

/// Measures the reference controllers in all conditions.
pub(super) fn references(
    pool: &WorkerPool,
    rows: &StudyRows,
    conditions: &[Condition],
    starts: usize,
) -> Result<ReferenceTable, StudyError> {
    let measure = |condition: &Condition, progress: &JobProgress| ReferenceScores::measure(condition, starts, progress);
    match pool.run("compare", 0, conditions, measure) {
        Ok(scores) => Ok(ReferenceTable { conditions: scores.into_iter().flatten().collect() }),
        Err(StudyError::Signal(signal)) => Err(interrupted(rows, signal, rows.count())),
        Err(error) => Err(error),
    }
}

/// All jobs, the longest first, so that no core works alone on a long one at the end.
fn jobs(entries: &[LearnerEntry], seeds: &[u64]) -> Vec<KeptJob<(usize, u64)>> {
    let job = |(number, entry): (usize, &LearnerEntry), seed: u64| KeptJob {
        name: format!("{} seed {seed}", entry.name),
        ticks: entry.plan.scenario.ticks,
        job: (number, seed),
    };
    let jobs = entries.iter().enumerate().flat_map(|entry| seeds.iter().map(move |&seed| job(entry, seed)));
    let mut jobs: Vec<_> = jobs.collect();
    jobs.sort_by_key(|job| u64::MAX - entries[job.job.0].estimated_tick_ns.saturating_mul(job.ticks));
    jobs
}
