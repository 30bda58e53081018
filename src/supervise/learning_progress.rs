//! From tests and observed targets to the rows and the sentence of a summary.

use super::evaluation::{PhaseTests, median};
use super::history::{ArmEvent, body_changes};
use crate::report::{ProgressRow, Reached};
use crate::runtime::{FIRST_LOOK_S, TargetResult, TargetsAround, ticks_in};
use crate::scenario::Plan;

/// Changes of the arm that get rows of their own; later ones are in the figure and in the sentence.
const CHANGES_IN_ROWS: usize = 3;

/// The rows of a run; `first` names the first, before anything was learned in this run. None where the run neither was
/// tested nor saw a whole target.
pub(super) fn rows(plan: &Plan, phases: &[PhaseTests], observed: &[TargetsAround], first: &str) -> Vec<ProgressRow> {
    let table = RowMaker { phases, observed, delay: ticks_in(plan, 1) - 1 };
    let Some(last) = phases.last() else { return Vec::new() };
    let tested = phases.iter().any(|phase| !phase.tests.is_empty());
    if !tested && observed.iter().all(|around| around.before.is_empty() && around.after.is_empty()) {
        return Vec::new();
    }
    let mut rows = Vec::new();
    if tested {
        rows.push(table.row(first.into(), 0, 0, Side::After));
    }
    let first_look = ticks_in(plan, FIRST_LOOK_S);
    if first_look < phases[0].until {
        rows.push(table.row(format!("after {FIRST_LOOK_S} s"), first_look, 0, Side::After));
    }
    let events = plan.simulated_arm().map_or_else(Vec::new, body_changes);
    for (number, phase) in phases.iter().enumerate().skip(1).take(CHANGES_IN_ROWS) {
        let what = name_of_change(&events, phase.from, phases.len() > 2);
        rows.push(table.row(format!("before {what}"), phase.from, number - 1, Side::Before));
        rows.push(table.row(format!("just after {what}"), phase.from, number, Side::After));
    }
    rows.push(table.row("at the end".into(), last.until, phases.len() - 1, Side::End));
    rows
}

/// Which of the targets around a tick a row is about.
#[derive(Clone, Copy, PartialEq)]
enum Side {
    Before,
    After,
    /// Before the end of the run.
    End,
}

struct RowMaker<'a> {
    phases: &'a [PhaseTests],
    observed: &'a [TargetsAround],
    /// By how many ticks a policy may have been copied late, because ticks were passed over.
    delay: u64,
}

impl RowMaker<'_> {
    /// The row of a tick in the phase of that number.
    fn row(&self, when: String, tick: u64, phase: usize, side: Side) -> ProgressRow {
        let phase = &self.phases[phase];
        let test =
            phase.tests.iter().find(|(at, _)| (tick..=tick + self.delay).contains(at)).map(|(_, result)| *result);
        let targets: Vec<&TargetResult> = self.targets(phase, tick, side).collect();
        ProgressRow {
            when,
            tick,
            test_error_m: test.map(|test| test.error_m),
            optimum_error_m: phase.optimum.map(|optimum| optimum.error_m),
            targets: targets.len(),
            error_m: median(targets.iter().map(|target| target.end_error)),
            loss: median(targets.iter().map(|target| target.loss)),
            optimum_loss: phase.optimum.map(|optimum| optimum.loss),
            targets_follow: side == Side::After,
        }
    }

    /// The targets on one side of `tick` that lie in `phase` as a whole.
    fn targets(&self, phase: &PhaseTests, tick: u64, side: Side) -> impl Iterator<Item = &TargetResult> {
        let (from, until) = (phase.from, phase.until);
        let around = self.observed.iter().find(|around| around.tick == tick);
        let targets = match side {
            Side::Before => around.map(|around| &around.before),
            Side::After => around.map(|around| &around.after),
            Side::End => self.observed.last().map(|end| &end.before),
        };
        let targets = targets.map_or(&[][..], Vec::as_slice);
        targets.iter().filter(move |target| target.from >= from && target.from + target.ticks <= until)
    }
}

/// `the block`, or with several changes `joint 3 blocked at tick 2,400`.
fn name_of_change(events: &[ArmEvent], tick: u64, several: bool) -> String {
    let mut here = events.iter().filter(|event| event.tick == tick);
    match (here.next(), here.next()) {
        (Some(event), None) if !several => format!("the {}", event.noun),
        _ => format!("the change at tick {}", crate::text::thousands(tick)),
    }
}

/// What the tests of each phase show.
pub(super) fn reached(plan: &Plan, phases: &[PhaseTests]) -> Vec<Reached> {
    let events = plan.simulated_arm().map_or_else(Vec::new, body_changes);
    let period_s = plan.period_ns as f64 / 1e9;
    let of = |phase: &PhaseTests| {
        let what: Vec<&str> = events.iter().filter(|e| e.tick == phase.from).map(|e| e.clause.as_str()).collect();
        let event = (phase.from > 0).then(|| what.join(" and "));
        let seconds = |tick: u64| (tick - phase.from) as f64 * period_s;
        let tests: Vec<_> = phase.tests.iter().map(|(tick, result)| (seconds(*tick), result.error_m)).collect();
        Reached::of(event, phase.from, seconds(phase.until), &tests)
    };
    phases.iter().filter_map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::super::evaluation::TestResult;
    use super::*;
    use crate::scenario::Scenario;

    fn plan() -> Plan {
        Scenario::find("arm").unwrap().plan().unwrap()
    }

    fn result(error_m: f64) -> TestResult {
        TestResult { error_m, loss: 0.03 }
    }

    fn phases() -> Vec<PhaseTests> {
        let optimum = Some(result(0.03));
        let tests = |tests: &[(u64, f64)]| tests.iter().map(|(tick, error)| (*tick, result(*error))).collect();
        vec![
            PhaseTests {
                from: 0,
                until: 2400,
                optimum,
                tests: tests(&[(0, 2.5), (180, 0.06), (200, 0.04), (2380, 0.03), (2400, 0.02)]),
            },
            PhaseTests { from: 2400, until: 3600, optimum, tests: tests(&[(2400, 0.4), (2480, 0.06), (2500, 0.06)]) },
        ]
    }

    fn targets(from: u64, count: u64, loss: f64) -> Vec<TargetResult> {
        (0..count).map(|i| TargetResult { from: from + 80 * i, ticks: 80, loss, end_error: 0.1 }).collect()
    }

    fn observed() -> Vec<TargetsAround> {
        vec![
            TargetsAround { tick: 200, before: targets(0, 2, 0.2), after: targets(240, 10, 0.05) },
            TargetsAround { tick: 2400, before: targets(1600, 10, 0.03), after: targets(2400, 10, 0.04) },
            TargetsAround { tick: 3600, before: targets(2240, 17, 0.035), after: Vec::new() },
        ]
    }

    #[test]
    fn a_row_holds_what_was_measured_at_its_tick() {
        let rows = rows(&plan(), &phases(), &observed(), "untrained");
        let told: Vec<_> = rows.iter().map(|r| (r.when.as_str(), r.tick, r.test_error_m, r.loss, r.targets)).collect();
        assert_eq!(
            told,
            [
                ("untrained", 0, Some(2.5), None, 0),
                ("after 10 s", 200, Some(0.04), Some(0.05), 10),
                ("before the block", 2400, Some(0.02), Some(0.03), 10),
                ("just after the block", 2400, Some(0.4), Some(0.04), 10),
                ("at the end", 3600, None, Some(0.035), 15),
            ],
            "at the end no policy was left, and two of the targets were before the block"
        );
    }

    #[test]
    fn runs_that_ended_early_have_fewer_rows() {
        let mut short = phases()[..1].to_vec();
        short[0].until = 150;
        short[0].tests.truncate(1);
        let early = rows(&plan(), &short, &[], "untrained");
        assert_eq!(early.iter().map(|r| r.when.as_str()).collect::<Vec<_>>(), ["untrained", "at the end"]);
        assert_eq!((early[1].test_error_m, early[1].loss, early[1].targets), (None, None, 0));
        assert!(reached(&plan(), &short).is_empty());
    }

    #[test]
    fn what_was_not_tested_is_told_as_it_was_observed() {
        let mut untested = phases();
        untested.iter_mut().for_each(|phase| phase.tests.clear());
        assert!(rows(&plan(), &untested, &[], "untrained").is_empty(), "nothing was observed");
        let rows = rows(&plan(), &untested, &observed(), "untrained");
        let told: Vec<_> = rows.iter().map(|r| (r.when.as_str(), r.error_m, r.optimum_error_m, r.targets)).collect();
        assert_eq!(told[0], ("after 10 s", Some(0.1), Some(0.03), 10));
        assert_eq!((told.len(), told[3].0, told[3].3), (4, "at the end", 15));
    }

    #[test]
    fn each_phase_is_reported() {
        let told = reached(&plan(), &phases());
        assert_eq!((told[0].within_m, told[0].after_s, told[0].event.as_deref()), (Some(0.05), Some(10.0), None));
        let block = &told[1];
        assert_eq!((block.within_m, block.event.as_deref()), (None, Some("joint 3 blocked")), "two tests are too few");
    }
}
