//! What was aimed at, and what was measured: the table of `docs/performance.md`.

use serde::Serialize;

use super::learner::WHOLE;
use super::{CaseRate, CostsOutcome, LatencyOutcome, LockstepOutcome};

/// One line of the table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TargetRow {
    /// What.
    pub what: &'static str,
    /// The bound.
    pub target: f64,
    /// What was measured.
    pub measured: f64,
    /// In which unit.
    pub unit: &'static str,
    /// Measured over target.
    pub ratio: f64,
    /// Whether the measured number is on the right side of the target.
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

/// The table; a line for what was measured.
pub(super) fn targets(
    latency: &LatencyOutcome,
    lockstep: &LockstepOutcome,
    encoder: &CostsOutcome,
    learner: &CostsOutcome,
) -> Vec<TargetRow> {
    let mut all = Vec::new();
    let of = |costs: &CostsOutcome, what: &str, version: &str| {
        let found = costs.costs.iter().find(|cost| cost.what == what && cost.version == version);
        found.map(|cost| cost.ns.median)
    };
    let encode = |version: &str| of(encoder, "encode the arm's 320 features", version);
    let mut put = |target: Option<TargetRow>| all.extend(target);
    let ns = |what, bound, measured: Option<f64>| measured.map(|m| TargetRow::at_most(what, bound, "ns", m));
    put(ns("encode 320 features, SSE2", 85.0, encode("final, sse2")));
    put(ns("encode 320 features, AVX2", 60.0, encode("final, avx2")));
    put(encode("naive").zip(encode("final, sse2")).map(|(naive, kernel)| {
        TargetRow::at_least("the naive encoder over the final one, SSE2", 10.0, "times", naive / kernel)
    }));
    let tick = |path| of(learner, "paper: learn, encode, act", path);
    put(ns("controller's tick, paper's rule, 4 x 320, SSE2", 220.0, tick("sse2")));
    put(ns("controller's tick, paper's rule, 4 x 320, AVX2", 160.0, tick("avx2")));
    let case = |i: usize| lockstep.cases.get(i);
    let seconds = |case: &CaseRate| 12e6 / case.per_second.median;
    put(case(2).map(|c| TargetRow::at_most("one process, 12e6 ticks", 4.0, "s", seconds(c))));
    let share = |i: usize| case(i)?.share_of_bare.map(|share| share.median);
    let bare = "of bare iceoryx2";
    put(share(0).map(|s| TargetRow::at_least("lockstep, complete log", 0.5, bare, s)));
    put(case(0).map(|c| TargetRow::at_most("lockstep, complete log, 12e6 ticks", 90.0, "s", seconds(c))));
    put(share(1).map(|s| TargetRow::at_least("lockstep, every 100th tick logged", 0.75, bare, s)));
    let ratio = latency.ratios.iter().find(|r| r.to == "iceoryx2-event" && r.of != r.series);
    if let Some(r) = ratio {
        let event = "of a bare event round trip";
        put(Some(TargetRow::at_most("real time, observation to command, p50", 1.15, event, r.p50)));
        put(Some(TargetRow::at_most("real time, observation to command, p99", 1.3, event, r.p99)));
    }
    let share = latency.usage.share_of_a_core.map(|share| 100.0 * share);
    put(share.map(|s| TargetRow::at_most("real time, all processes at 50 ms", 0.5, "% of one core", s)));
    let learned = learner.costs.iter().find(|cost| cost.what == format!("learned-reward: {WHOLE}"));
    put(learned.map(|cost| TargetRow::at_most("learned-reward's whole tick", 1.5, "ms", cost.ns.median / 1e6)));
    let used = lockstep.cases.iter().filter_map(|case| case.usage.as_ref()).flat_map(|usage| &usage.processes);
    let resident = used.filter(|p| p.process != "launcher").map(|p| p.last_kib).max();
    put(resident
        .map(|kib| TargetRow::at_most("resident memory, the largest process", 10.0, "MiB", kib as f64 / 1024.0)));
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_target_is_met_on_its_own_side() {
        let at_most = |measured| TargetRow::at_most("x", 2.0, "ns", measured).met;
        let at_least = |measured| TargetRow::at_least("x", 2.0, "times", measured).met;
        assert_eq!([at_most(1.0), at_most(3.0), at_least(1.0), at_least(3.0)], [true, false, false, true]);
        assert_eq!(TargetRow::at_least("x", 2.0, "times", 3.0).ratio, 1.5);
    }
}
