//! Performance targets and what was measured: the table of `docs/performance.md`.

use serde::Serialize;

use super::lockstep::CaseRate;
use super::{CostsOutcome, LatencyOutcome, LockstepOutcome};
use crate::timing::WHOLE_TICK;

/// One row of the table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct TargetRow {
    /// What is measured.
    pub what: &'static str,
    /// The target.
    pub target: f64,
    /// The measured number.
    pub measured: f64,
    /// The unit of both.
    pub unit: &'static str,
    /// Measured over target.
    pub ratio: f64,
    /// Whether the measured number meets the target.
    pub met: bool,
}

impl TargetRow {
    fn at_most(what: &'static str, target: f64, unit: &'static str, measured: f64) -> Self {
        Self { what, target, measured, unit, ratio: measured / target, met: measured <= target }
    }

    fn at_least(what: &'static str, target: f64, unit: &'static str, measured: f64) -> Self {
        Self { met: measured >= target, ..Self::at_most(what, target, unit, measured) }
    }
}

/// The table: a row for every target whose number was measured.
pub(super) fn targets(
    latency: &LatencyOutcome,
    lockstep: &LockstepOutcome,
    encoder: &CostsOutcome,
    learner: &CostsOutcome,
) -> Vec<TargetRow> {
    let rows = call_rows(encoder, learner).into_iter().chain(lockstep_rows(lockstep));
    let rows = rows.chain(realtime_rows(latency)).chain([learned_reward_row(learner), memory_row(lockstep)]);
    rows.flatten().collect()
}

/// The median of one version, ns.
fn median_ns(costs: &CostsOutcome, what: &str, version: &str) -> Option<f64> {
    let cost = costs.costs.iter().find(|cost| cost.what == what && cost.version == version);
    cost.map(|cost| cost.ns.median)
}

fn call_rows(encoder: &CostsOutcome, learner: &CostsOutcome) -> [Option<TargetRow>; 7] {
    let encode = |version: &str| median_ns(encoder, "encode the arm's 320 features", version);
    let tick = |path| median_ns(learner, "paper: learn, encode, act", path);
    let ns = |what, bound, measured: Option<f64>| measured.map(|m| TargetRow::at_most(what, bound, "ns", m));
    [
        ns("encode 320 features, SSE2", 85.0, encode("final, sse2")),
        ns("encode 320 features, AVX2", 45.0, encode("final, avx2")),
        ns("encode 320 features, AVX-512", 35.0, encode("final, avx512")),
        encode("naive").zip(encode("final, sse2")).map(|(naive, kernel)| {
            TargetRow::at_least("the naive encoder over the final one, SSE2", 10.0, "times", naive / kernel)
        }),
        ns("controller's tick, paper's rule, 4 x 320, SSE2", 220.0, tick("sse2")),
        ns("controller's tick, paper's rule, 4 x 320, AVX2", 165.0, tick("avx2")),
        ns("controller's tick, paper's rule, 4 x 320, AVX-512", 140.0, tick("avx512")),
    ]
}

fn lockstep_rows(lockstep: &LockstepOutcome) -> [Option<TargetRow>; 4] {
    let case = |i: usize| lockstep.cases.get(i);
    let seconds = |case: &CaseRate| 12e6 / case.per_second.median;
    let share = |i: usize| case(i)?.share_of_bare.map(|share| share.median);
    let bare = "of bare iceoryx2";
    [
        case(2).map(|c| TargetRow::at_most("one process, 12e6 ticks", 4.0, "s", seconds(c))),
        share(0).map(|s| TargetRow::at_least("lockstep, complete log", 0.6, bare, s)),
        case(0).map(|c| TargetRow::at_most("lockstep, complete log, 12e6 ticks", 25.0, "s", seconds(c))),
        share(1).map(|s| TargetRow::at_least("lockstep, every 100th tick logged", 0.8, bare, s)),
    ]
}

fn realtime_rows(latency: &LatencyOutcome) -> [Option<TargetRow>; 3] {
    let ratio = latency.ratios.iter().find(|r| r.to == "iceoryx2-event" && r.of != r.series);
    let event = "of a bare event round trip";
    let share = latency.usage.share_of_a_core.map(|share| 100.0 * share);
    [
        ratio.map(|r| TargetRow::at_most("real time, observation to command, p50", 0.5, event, r.p50)),
        ratio.map(|r| TargetRow::at_most("real time, observation to command, p99", 1.3, event, r.p99)),
        share.map(|s| TargetRow::at_most("real time, all processes at 50 ms", 0.3, "% of one core", s)),
    ]
}

fn learned_reward_row(learner: &CostsOutcome) -> Option<TargetRow> {
    // Of the paths, the fastest is the last.
    let cost = learner.costs.iter().rfind(|cost| cost.what == format!("learned-reward: {WHOLE_TICK}"));
    cost.map(|cost| TargetRow::at_most("learned-reward's whole tick", 0.6, "ms", cost.ns.median / 1e6))
}

fn memory_row(lockstep: &LockstepOutcome) -> Option<TargetRow> {
    let processes = lockstep.cases.iter().filter_map(|case| case.usage.as_ref()).flat_map(|usage| &usage.processes);
    let kib = processes.filter(|p| p.process != "launcher").map(|p| p.last_kib).max()?;
    Some(TargetRow::at_most("resident memory, the largest process", 10.0, "MiB", kib as f64 / 1024.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_most_is_met_below_and_at_least_above_the_target() {
        let at_most = |measured| TargetRow::at_most("x", 2.0, "ns", measured).met;
        let at_least = |measured| TargetRow::at_least("x", 2.0, "times", measured).met;
        assert_eq!([at_most(1.0), at_most(3.0), at_least(1.0), at_least(3.0)], [true, false, false, true]);
        assert_eq!(TargetRow::at_least("x", 2.0, "times", 3.0).ratio, 1.5);
    }
}
