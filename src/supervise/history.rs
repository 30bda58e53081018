//! From the controller's report to what table and figure show: windows put together, postures from angles.

use super::evaluation::{PhaseTests, TestResult};
use crate::plant::posture;
use crate::report::{OptimumSpan, Reach, RunHistory, TestPoint};
use crate::runtime::{ControllerReport, Mode, Snapshot};
use crate::scenario::{ArmConfig, MirrorAxis, Plan};
use crate::stats::Window;

/// Part of the run that the first and the last window of the table take.
const SHARE: u64 = 20;

/// The first and the last twentieth of a run, or as much more as it takes to see a target end.
pub(crate) fn ends(windows: &[Window]) -> Option<[Window; 2]> {
    let total = windows.iter().map(|w| w.ticks).sum();
    Some([merge(windows.iter(), total)?, merge(windows.iter().rev(), total)?])
}

/// Merges windows of a run of `total` ticks from the front of `windows` until they hold its twentieth and the
/// end of a target, but no more than half of the run.
fn merge<'a>(windows: impl Iterator<Item = &'a Window>, total: u64) -> Option<Window> {
    let mut sum: Option<Window> = None;
    for w in windows {
        sum = Some(match sum {
            None => w.clone(),
            Some(s) if s.ticks >= total / SHARE && (s.ends > 0 || s.ticks >= total / 2) => return Some(s),
            Some(s) => s.and(w),
        });
    }
    sum
}

/// What the figure shows of a run.
pub(super) fn history(plan: &Plan, mode: Mode, controller: ControllerReport, phases: &[PhaseTests]) -> RunHistory {
    let scenario = &plan.scenario;
    let arm = scenario.plant.arm.as_ref();
    let reach = |switch: &[Snapshot]| arm.and_then(|arm| reach(arm, switch));
    let done = controller.ticks + controller.unseen;
    let events = arm.map_or_else(Vec::new, body_changes).into_iter().filter(|event| event.tick < done);
    let tests = phases.iter().flat_map(|phase| &phase.tests);
    let optimum = phases.iter().filter_map(|phase| {
        let TestResult { error_m, loss } = phase.optimum?;
        Some(OptimumSpan { from: phase.from, until: phase.until, error: error_m, loss })
    });
    RunHistory {
        title: format!("{}, {}, seed {}", scenario.name, mode.name(), scenario.seed),
        unit: if arm.is_some() { "m".to_owned() } else { String::new() },
        period_s: plan.period_ns as f64 / 1e9,
        marks: events.map(|event| (event.tick, event.label)).collect(),
        first_reach: reach(&controller.first_switch),
        last_reach: reach(&controller.last_switch),
        windows: controller.windows,
        tests: tests.map(|(tick, result)| TestPoint { tick: *tick, error: result.error_m }).collect(),
        optimum: optimum.collect(),
    }
}

/// A change of the arm, in words.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ArmEvent {
    /// First tick with it.
    pub tick: u64,
    /// For a figure: `joint 3 blocked`.
    pub label: String,
    /// After "after": `joint 3 blocked`.
    pub clause: String,
    /// After "the": `block`.
    pub noun: &'static str,
}

/// The changes of the arm, in the order of their ticks.
pub(crate) fn body_changes(arm: &ArmConfig) -> Vec<ArmEvent> {
    let blocks = arm.block.iter().map(|b| {
        let label = format!("joint {} blocked", b.joint);
        ArmEvent { tick: b.tick, clause: label.clone(), label, noun: "block" }
    });
    let lengths = arm.shorten.iter().map(|s| ArmEvent {
        tick: s.tick,
        label: format!("segment {} now {} m", s.segment, s.length),
        clause: format!("segment {} became {} m long", s.segment, s.length),
        noun: "change of length",
    });
    let mirrors = arm.mirror.iter().map(|m| {
        let axis = match m.axis {
            MirrorAxis::X => "x",
            MirrorAxis::Y => "y",
        };
        let (label, clause) = (format!("{axis} mirrored"), format!("{axis} was mirrored"));
        ArmEvent { tick: m.tick, label, clause, noun: "mirroring" }
    });
    let loads = arm.payload.iter().map(|load| ArmEvent {
        tick: load.tick,
        label: format!("load of {} kg", load.mass),
        clause: format!("the load became {} kg", load.mass),
        noun: "change of load",
    });
    let mut events: Vec<_> = blocks.chain(lengths).chain(mirrors).chain(loads).collect();
    events.sort_by_key(|event| event.tick);
    events
}

/// The reach of a whole target switch; `None` where there was none, as in an open loop.
pub(crate) fn reach(arm: &ArmConfig, switch: &[Snapshot]) -> Option<Reach> {
    let first = switch.first().filter(|_| !arm.open_loop)?;
    let joints = arm.lengths.len();
    Some(Reach {
        from: first.tick,
        // Where it is, not where it is said to be.
        target: arm.reported_target(first.tick, [first.inputs[0], first.inputs[1]]).map(f64::from),
        postures: switch.iter().map(|s| posture(&arm.at(s.tick), &s.inputs[2..2 + joints])).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn window(from: u64, loss: f64, end_error: Option<f64>) -> Window {
        Window {
            from,
            ticks: 10,
            loss,
            noise_share: 0.0,
            mean_squared_error: Some(loss),
            end_error,
            ends: u64::from(end_error.is_some()),
        }
    }

    #[test]
    fn the_ends_of_a_run_are_its_first_and_last_twentieth() {
        let windows: Vec<Window> = (0..40).map(|i| window(i * 10, i as f64, Some(i as f64))).collect();
        let [first, last] = ends(&windows).unwrap();
        assert_eq!((first.from, first.ticks, first.loss, first.ends), (0, 20, 0.5, 2));
        assert_eq!((last.from, last.ticks, last.loss), (380, 20, 38.5));
        let [first, last] = ends(&windows[..1]).unwrap();
        assert_eq!(first, last);
        assert_eq!(ends(&[]), None);
        // A run that is short against its targets.
        let windows: Vec<Window> = (0..40).map(|i| window(i * 10, 1.0, (i % 8 == 7).then_some(1.0))).collect();
        let [first, last] = ends(&windows).unwrap();
        assert_eq!((first.from, first.ticks, first.ends), (0, 80, 1));
        assert_eq!((last.from, last.ticks, last.ends), (380, 20, 1));
    }
}
