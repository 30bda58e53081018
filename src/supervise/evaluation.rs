//! The test of what a run learned: the policies that it left, without exploration noise, on a fixed set of
//! targets, in the arm as it was at each time, beside the optimum.
//!
//! The launcher does this when the run is over. It takes some tenths of a second on two cores: a policy takes
//! about a millisecond, an optimum some fifty.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use crate::policy::LinearPolicy;
use crate::reference::{FixedArm, Score, TARGETS, TestSet};
use crate::runtime::{FIRST_LOOK_S, PolicySnapshot, change_ticks, ticks_in};
use crate::scenario::{Angles, ArmConfig, Plan};

/// First guesses for each movement of the optimum: enough to come within 1 % of the loss that many more find.
const STARTS: usize = 3;
/// Features times ticks that all tests together may take: about half a second of a core. Beyond, fewer
/// policies are tested.
const MOST_WORK: u64 = 500_000_000;
/// The same for a single test: beyond, none is made.
const MOST_WORK_A_TEST: u64 = 100_000_000;

/// The result of a policy's test: medians over the test's targets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct TestResult {
    /// Distance from the target at its end, m.
    pub error_m: f64,
    /// Loss a tick.
    pub loss: f64,
}

/// One phase of the run: the arm does not change in it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PhaseTests {
    /// First tick.
    pub from: u64,
    /// First tick of the next phase, or the ticks done.
    pub until: u64,
    /// The movements of least loss; `None` for an arm that the reference does not know.
    pub optimum: Option<TestResult>,
    /// Ticks done and result, in order. At a change the same policy is the last of one phase and the first of
    /// the next.
    pub tests: Vec<(u64, TestResult)>,
}

/// One thing to do, in the phase of that number.
enum TestJob<'a> {
    Optimum(usize),
    Untrained(usize),
    Policy(usize, &'a PolicySnapshot),
}

/// Tests the policies of a run of `done` ticks, phase by phase, beside the optimum. A controller without a linear
/// policy is not tested: a planner takes milliseconds for each of the many thousand ticks of a test. `None` where the
/// plant is not the simulator's arm, or where the test would take too long. `snapshots` are in the order of ticks.
/// `start` is the policy with which the run began; without one, its weights were 0.
pub(super) fn evaluate(
    plan: &Plan,
    done: u64,
    snapshots: &[PolicySnapshot],
    start: Option<&LinearPolicy>,
) -> Option<Vec<PhaseTests>> {
    let linear = plan.scenario.controller.is_shipped() && plan.scenario.learner.rule.is_linear();
    // The test set has no delays, so that it does not test what a late plant was learned with.
    let in_time = plan.scenario.plant.timing.is_nothing();
    let arm = plan.simulated_arm().filter(|arm| !arm.open_loop && in_time)?;
    let features = plan.encoder().len().max(1) as u64;
    let work = features.saturating_mul(TARGETS as u64).saturating_mul(arm.target_every);
    if work > MOST_WORK_A_TEST {
        return None;
    }
    let mut phases = phases(arm, done);
    let period_s = plan.scenario.period_ms / 1000.0;
    let sets: Vec<TestSet> =
        phases.iter().map(|phase| TestSet::new(plan, FixedArm::at(arm, period_s, phase.from))).collect();
    let first_look = ticks_in(plan, FIRST_LOOK_S);
    let mut jobs = jobs(&phases, snapshots, known_to_reference(arm), (MOST_WORK / work.max(1), first_look));
    jobs.retain(|job| linear || matches!(job, TestJob::Optimum(_)));
    let results = in_parallel(&jobs, |job| match *job {
        TestJob::Optimum(phase) => sets[phase].optimum_targets(STARTS),
        TestJob::Untrained(phase) => Some(match start {
            Some(policy) => sets[phase].score_targets(policy),
            None => sets[phase].zero_targets(),
        }),
        TestJob::Policy(phase, snapshot) => Some(sets[phase].score_targets(&snapshot.policy)),
    });
    for (job, scores) in jobs.iter().zip(results) {
        let result = scores.map(|scores| medians(&scores));
        match job {
            TestJob::Optimum(phase) => phases[*phase].optimum = result,
            TestJob::Untrained(phase) => phases[*phase].tests.extend(result.map(|result| (0, result))),
            TestJob::Policy(phase, snapshot) => {
                phases[*phase].tests.extend(result.map(|result| (snapshot.tick, result)));
            }
        }
    }
    phases.iter_mut().for_each(|phase| phase.tests.sort_by_key(|(tick, _)| *tick));
    Some(phases)
}

/// The phases of a run of `done` ticks, without tests.
fn phases(arm: &ArmConfig, done: u64) -> Vec<PhaseTests> {
    let mut edges = vec![0];
    edges.extend(change_ticks(arm, done));
    edges.push(done);
    let phase = |edge: &[u64]| PhaseTests { from: edge[0], until: edge[1], optimum: None, tests: Vec::new() };
    edges.windows(2).map(phase).collect()
}

/// Optima first, because they take longest. Where `most` policies are fewer than there are, some between the
/// first and the last of each phase are left out, but not that of the tick `first_look`.
fn jobs<'a>(
    phases: &[PhaseTests],
    snapshots: &'a [PolicySnapshot],
    has_optimum: bool,
    (most, first_look): (u64, u64),
) -> Vec<TestJob<'a>> {
    let stride = (snapshots.len() as u64).div_ceil(most.max(1)).max(1) as usize;
    let mut jobs: Vec<TestJob> =
        if has_optimum { (0..phases.len()).map(TestJob::Optimum).collect() } else { Vec::new() };
    jobs.push(TestJob::Untrained(0));
    for (number, phase) in phases.iter().enumerate() {
        let inside = |s: &&PolicySnapshot| (phase.from.max(1)..=phase.until).contains(&s.tick);
        let inside: Vec<&PolicySnapshot> = snapshots.iter().filter(inside).collect();
        let last = inside.len().saturating_sub(1);
        let kept = |i: usize, tick: u64| i.is_multiple_of(stride) || i == last || tick == first_look;
        let kept = inside.into_iter().enumerate().filter(|(i, snapshot)| kept(*i, snapshot.tick));
        jobs.extend(kept.map(|(_, snapshot)| TestJob::Policy(number, snapshot)));
    }
    jobs
}

/// Whether the reference controllers know everything about this arm: absolute angles without stops, and the
/// reward of error, speed and posture.
fn known_to_reference(arm: &ArmConfig) -> bool {
    let as_in_the_paper = arm.angles == Angles::Absolute && arm.limits.is_empty() && arm.payload.is_empty();
    as_in_the_paper && arm.reward.near.is_none() && arm.reward.collision == 0.0
}

fn medians(scores: &[Score]) -> TestResult {
    TestResult {
        error_m: median(scores.iter().map(|score| score.miss_m)).unwrap_or(f64::NAN),
        loss: median(scores.iter().map(|score| score.loss)).unwrap_or(f64::NAN),
    }
}

/// The median: of an even number of values the mean of the two in the middle. Not a number if a value is
/// none; `None` without values.
pub(super) fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_unstable_by(f64::total_cmp);
    let (low, high) = (values.get(values.len().checked_sub(1)? / 2)?, values.get(values.len() / 2)?);
    let no_number = values.iter().any(|value| value.is_nan());
    Some(if no_number { f64::NAN } else { 0.5 * (low + high) })
}

/// The results of `work` for each of `jobs`, in their order, on all cores.
fn in_parallel<J: Sync, T: Send>(jobs: &[J], work: impl Fn(&J) -> T + Sync) -> Vec<T> {
    let (next, results) = (AtomicUsize::new(0), Mutex::new(Vec::with_capacity(jobs.len())));
    let take_jobs = || {
        while let Some((at, job)) = {
            let at = next.fetch_add(1, Ordering::Relaxed);
            jobs.get(at).map(|job| (at, job))
        } {
            let result = work(job);
            results.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push((at, result));
        }
    };
    let others = thread::available_parallelism().map_or(1, usize::from).min(jobs.len()).saturating_sub(1);
    thread::scope(|scope| {
        // A thread that cannot be made leaves its jobs to the others.
        for _ in 0..others {
            let _ = thread::Builder::new().spawn_scoped(scope, take_jobs);
        }
        take_jobs();
    });
    let mut results = results.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    results.sort_unstable_by_key(|(at, _)| *at);
    results.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::{LearnerConfig, Rule, Scenario};

    fn plan(name: &str) -> Plan {
        let mut scenario = Scenario::find(name).unwrap();
        if name == "arm" {
            scenario.learner = LearnerConfig::preset(Rule::LearnedReward);
        }
        scenario.plan().unwrap()
    }

    #[test]
    fn medians_are_of_numbers() {
        assert_eq!(median([3.0, 1.0, 2.0].into_iter()), Some(2.0));
        assert_eq!(median([3.0, 1.0].into_iter()), Some(2.0));
        assert_eq!(median(std::iter::empty()), None);
        assert!(median([3.0, f64::NAN, 1.0].into_iter()).unwrap().is_nan());
    }

    #[test]
    fn a_run_is_tested_in_the_arm_of_each_phase() {
        let phases = evaluate(&plan("arm"), 3600, &[], None).unwrap();
        assert_eq!(phases.iter().map(|p| (p.from, p.until)).collect::<Vec<_>>(), [(0, 2400), (2400, 3600)]);
        let untrained = phases[0].tests[0];
        assert!(untrained.0 == 0 && untrained.1.error_m > 1.0, "{untrained:?}");
        let optima: Vec<_> = phases.iter().map(|p| p.optimum.unwrap()).collect();
        assert!(optima.iter().all(|o| o.error_m < 0.1 && o.loss < 0.03), "{optima:?}");
        assert!(phases[1].tests.is_empty(), "no policy was left");
        assert_eq!(evaluate(&plan("arm"), 2400, &[], None).unwrap().len(), 1, "the block did not come");
        let planner = Scenario::find("arm").unwrap().plan().unwrap();
        let untested = evaluate(&planner, 3600, &[], None).unwrap();
        assert!(untested.iter().all(|phase| phase.optimum.is_some() && phase.tests.is_empty()), "a planner");
    }

    #[test]
    fn other_plants_have_no_test() {
        for name in ["eye", "open-loop-3", "servo-emulated"] {
            assert_eq!(evaluate(&plan(name), 1000, &[], None), None, "{name}");
        }
        let relative = evaluate(&plan("relative"), 1000, &[], None).unwrap();
        assert_eq!(relative[0].optimum, None, "the reference does not know relative angles");
        assert_eq!(relative[0].tests.len(), 1);
    }

    #[test]
    fn fewer_policies_are_tested_where_a_test_is_long() {
        let mut snapshots = Vec::new();
        let plan = plan("arm");
        let encoder = plan.encoder();
        let policy = crate::policy::LinearPolicy::new(encoder.len(), encoder.positions().collect(), 4);
        for tick in [20, 40, 60, 80, 100, 120] {
            snapshots.push(PolicySnapshot { tick, policy: policy.clone() });
        }
        let arm = plan.simulated_arm().unwrap();
        let ticks = |most| -> Vec<u64> {
            let jobs = jobs(&phases(arm, 120), &snapshots, true, (most, 40));
            jobs.iter().filter_map(|job| if let TestJob::Policy(_, s) = job { Some(s.tick) } else { None }).collect()
        };
        assert_eq!(ticks(6), [20, 40, 60, 80, 100, 120]);
        assert_eq!(ticks(3), [20, 40, 60, 100, 120]);
        assert_eq!(ticks(0), [20, 40, 120]);
    }

    #[test]
    fn results_stand_in_the_order_of_the_jobs() {
        let jobs: Vec<u64> = (0..50).collect();
        assert_eq!(in_parallel(&jobs, |job| job * job), jobs.iter().map(|job| job * job).collect::<Vec<_>>());
    }
}
