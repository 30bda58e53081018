//! The jobs of a comparison: one per condition for the reference controllers, one per learner and seed.

use std::collections::BTreeMap;

use super::run::{self, LearnerRun};
use super::{Condition, LearnerEntry, ReferenceScores, ReferenceTable};
use crate::study::{JobProgress, StudyError, WorkerPool};

/// One job.
enum ComparisonJob {
    /// The reference controllers in one condition (its number).
    References(usize),
    /// One learner (its number) with one seed.
    Run(usize, u64),
}

enum JobResult {
    References(ReferenceScores),
    Run(LearnerRun),
}

/// Measures the references and runs all learners with all seeds. Gives the runs by learner, in the order of
/// the seeds.
pub(super) fn run(
    pool: &WorkerPool,
    entries: &[LearnerEntry],
    seeds: &[u64],
    conditions: &[Condition],
    starts: usize,
) -> Result<(ReferenceTable, Vec<Vec<LearnerRun>>), StudyError> {
    let jobs = jobs(entries, seeds, conditions.len());
    let ticks = entries.iter().map(|entry| entry.plan.scenario.ticks * seeds.len() as u64).sum();
    let work = |job: &ComparisonJob, progress: &JobProgress| match *job {
        ComparisonJob::References(condition) => {
            Ok(ReferenceScores::measure(&conditions[condition], starts, progress).map(JobResult::References))
        }
        ComparisonJob::Run(entry, seed) => {
            let run = run::run(&entries[entry], seed, conditions, progress);
            run.inspect_err(|_| progress.stop_all()).map(|run| run.map(JobResult::Run))
        }
    };
    let results = pool.run("compare", ticks, &jobs, work)?.into_iter().collect::<Result<Vec<_>, StudyError>>()?;

    let mut references: Vec<Option<ReferenceScores>> = vec![None; conditions.len()];
    let mut runs: Vec<BTreeMap<u64, LearnerRun>> = vec![BTreeMap::new(); entries.len()];
    for (job, result) in jobs.iter().zip(results) {
        match (job, result) {
            (ComparisonJob::References(condition), Some(JobResult::References(scores))) => {
                references[*condition] = Some(scores);
            }
            (ComparisonJob::Run(entry, seed), Some(JobResult::Run(run))) => drop(runs[*entry].insert(*seed, run)),
            _ => {}
        }
    }
    let references = ReferenceTable { conditions: references.into_iter().flatten().collect() };
    Ok((references, runs.into_iter().map(|seeds| seeds.into_values().collect()).collect()))
}

/// All jobs, the longest first, so that no core works alone on a long one at the end.
fn jobs(entries: &[LearnerEntry], seeds: &[u64], conditions: usize) -> Vec<ComparisonJob> {
    let mut jobs: Vec<ComparisonJob> = (0..conditions).map(ComparisonJob::References).collect();
    jobs.extend((0..entries.len()).flat_map(|entry| seeds.iter().map(move |&seed| ComparisonJob::Run(entry, seed))));
    jobs.sort_by_key(|job| match job {
        ComparisonJob::References(_) => 0,
        ComparisonJob::Run(entry, _) => {
            let entry = &entries[*entry];
            u64::MAX - entry.estimated_tick_ns.saturating_mul(entry.plan.scenario.ticks)
        }
    });
    jobs
}
