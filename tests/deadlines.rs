//! Real time with a stalled process: ticks are missed; commands are held, then decayed, then stopped. Commands that the
//! policy did not choose are not learned from, and missed ticks are not made up in a burst.

mod support;

use std::time::Duration;

use serde_json::Value;
use support::content::{LogContent, read_log};
use support::{TestFolder, stop_process_for};
use tectum::wire::{MAX_OUTPUTS, Observation, flag};

const TICKS: &str = "600";

/// The summary and the log of a run in which one program is stopped for a fifth of a second.
fn stalled(program: &str) -> (Value, LogContent) {
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[("every", "1"), ("period_ms", "2")]);
    let mut run = test_folder.run(&[&scenario, "--mode", "realtime", "--ticks", TICKS, "--json"]);
    let pid = run.child_pid(program);
    run.wait_until_ticking();
    stop_process_for(pid, Duration::from_millis(200));
    let summary = run.wait().expect(0).json();
    let (_, content) = read_log(&test_folder.log_path());
    (summary, content)
}

/// A controller is stopped for a fifth of a second, which is a hundred ticks of 2 ms. A stall of the machine may hit
/// the ticks that are checked; then the run is repeated.
#[test]
fn ticks_of_a_stalled_controller_are_missed_and_not_learned_from() {
    assert!((0..5).any(|_| check_stalled_controller()), "the machine stalled in each of five runs");
}

/// Checks one run with a stalled controller. Returns false when stalls of the machine leave no ticks to check.
fn check_stalled_controller() -> bool {
    let (summary, content) = stalled("tectum-controller");
    assert!(summary["missed"].as_u64() >= Some(50), "{summary}");
    let observations = &content.observations;
    let missed = |o: &Observation| o.header.flags & flag::MISSED != 0;

    // Nothing was learned from a missed tick, and the trace was cut there.
    for learning in &content.learnings {
        if observations.iter().any(|o| o.header.tick == learning.header.tick && missed(o)) {
            assert_eq!(learning.header.flags & flag::LEARNED, 0, "tick {}", learning.header.tick);
            assert_eq!(learning.trace_norm, 0.0, "tick {}", learning.header.tick);
        }
    }
    // The controller continued with the newest observation: the ones it did not receive are counted, not processed.
    let (sensed, answered) = (observations.len(), content.commands.len());
    assert!(answered < sensed - 50, "{answered} answers to {sensed} observations");

    // Without commands the plant holds for 2 ticks, decays over 4, and then stands still.
    let rows = observations.windows(9);
    let Some(row) = rows
        .into_iter()
        .find(|row| !missed(&row[0]) && row[1..].iter().all(missed) && row[1..].iter().all(|o| o.skipped == 0))
    else {
        return false;
    };
    let (held, decayed, stopped) = (flag::HELD, flag::DECAYED, flag::STOPPED);
    let policy: Vec<u32> = row[1..8].iter().map(|o| o.header.flags & (held | decayed | stopped)).collect();
    assert_eq!(policy, [held, held, decayed, decayed, decayed, decayed, stopped]);
    let last = row[0].applied;
    assert_eq!((row[1].applied, row[2].applied), (last, last));
    for (steps, observation) in (1..5).zip(&row[3..7]) {
        let share = observation.applied[0] / last[0];
        assert!((share - (1.0 - steps as f32 / 5.0)).abs() < 1e-3, "{steps} of five steps down: {share}");
    }
    assert_eq!(row[7].applied, [0.0; MAX_OUTPUTS]);
    true
}

/// A stopped plant skips ticks, reports that, and continues at the tick that is due.
#[test]
fn a_stalled_plant_skips_ticks() {
    let (summary, content) = stalled("tectum-simulator");
    let skipped = summary["skipped"].as_u64().unwrap();
    assert!(skipped >= 50, "{summary}");
    assert!(summary["missed"].as_u64() >= Some(skipped), "skipped ticks count as missed: {summary}");
    // On a machine that stands still at the start, the first observation is not that of tick 0.
    let mut reported = content.observations[0].header.tick;
    for pair in content.observations.windows(2) {
        let [before, after] = pair else { unreachable!() };
        let gap = after.header.tick - before.header.tick - 1;
        assert_eq!(u64::from(after.skipped), gap);
        assert_eq!(after.header.flags & flag::SKIPPED != 0, gap > 0);
        assert_eq!(after.header.sequence, before.header.sequence + 1);
        // No tick begins before its scheduled time, so there is no burst.
        assert!(after.header.sensed_ns >= after.header.scheduled_ns);
        reported += gap;
    }
    let last = content.observations.last().unwrap().header.tick;
    assert_eq!(reported + TICKS.parse::<u64>().unwrap() - 1 - last, skipped);
    for learning in &content.learnings {
        if let Some(o) = content.observations.iter().find(|o| o.header.tick == learning.header.tick)
            && o.header.flags & flag::SKIPPED != 0
        {
            assert_eq!(learning.header.flags & (flag::LEARNED | flag::TRACE_CUT), flag::TRACE_CUT);
        }
    }
}
