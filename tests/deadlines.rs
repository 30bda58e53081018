//! Real time when a process is held up: ticks are missed, commands held, decayed, stopped; nothing is learned from what
//! the policy did not do, and nothing is made up in a burst.

mod support;

use std::time::Duration;

use serde_json::Value;
use support::content::{Content, read};
use support::{Place, signal_process};
use tectum::wire::{Observation, flag};

const TICKS: &str = "600";

/// A run in which one program is stopped for a fifth of a second: its summary and its log.
fn stalled(program: &str) -> (Value, Content) {
    let place = Place::new();
    let scenario = place.arm(&[("every", "1"), ("period_ms", "2")]);
    let mut run = place.run(&[&scenario, "--mode", "realtime", "--ticks", TICKS, "--json"]);
    let member = run.member(program);
    run.until_ticking();
    signal_process(member, "STOP");
    std::thread::sleep(Duration::from_millis(200));
    signal_process(member, "CONT");
    let summary = run.wait().expect(0).json();
    let (_, content) = read(&place.run_folder().join("log.mcap"));
    (summary, content)
}

/// A controller that is stopped for a fifth of a second, at a period of 2 ms: a hundred ticks. A stall of the machine
/// can fall on the very ticks that are looked at; then the run is repeated.
#[test]
fn a_stalled_controller_is_missed_and_nothing_is_learned_from_it() {
    assert!((0..5).any(|_| stall_of_the_controller()), "five runs, and the machine stalled in each");
}

/// False when the machine's own stalls hide what is to be seen.
fn stall_of_the_controller() -> bool {
    let (summary, content) = stalled("tectum-controller");
    assert!(summary["missed"].as_u64() >= Some(50), "{summary}");
    let observations = &content.observations;
    let missed = |o: &Observation| o.header.flags & flag::MISSED != 0;

    // Nothing was learned from a missed tick, and no credit crossed it.
    for learning in &content.learnings {
        if observations.iter().any(|o| o.header.tick == learning.header.tick && missed(o)) {
            assert_eq!(learning.header.flags & flag::LEARNED, 0, "tick {}", learning.header.tick);
            assert_eq!(learning.trace_norm, 0.0, "tick {}", learning.header.tick);
        }
    }
    // The controller came back to the present: what it never saw is counted, not worked off.
    let (sensed, answered) = (observations.len(), content.commands.len());
    assert!(answered < sensed - 50, "{answered} answers to {sensed} observations");

    // What the plant did without commands: hold 2, decay over 4, then stand.
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
    assert_eq!(row[7].applied, [0.0; 8]);
    true
}

/// A plant that is stopped passes ticks over, says so, and goes on at the tick that is due.
#[test]
fn a_stalled_plant_passes_ticks_over() {
    let (summary, content) = stalled("tectum-simulator");
    let skipped = summary["skipped"].as_u64().unwrap();
    assert!(skipped >= 50, "{summary}");
    assert!(summary["missed"].as_u64() >= Some(skipped), "ticks passed over are ticks missed: {summary}");
    let mut told = 0;
    for pair in content.observations.windows(2) {
        let [before, after] = pair else { unreachable!() };
        let gap = after.header.tick - before.header.tick - 1;
        assert_eq!(u64::from(after.skipped), gap);
        assert_eq!(after.header.flags & flag::SKIPPED != 0, gap > 0);
        assert_eq!(after.header.sequence, before.header.sequence + 1);
        // Never before its time: no burst.
        assert!(after.header.sensed_ns >= after.header.scheduled_ns);
        told += gap;
    }
    let last = content.observations.last().unwrap().header.tick;
    assert_eq!(told + TICKS.parse::<u64>().unwrap() - 1 - last, skipped);
    for learning in &content.learnings {
        if let Some(o) = content.observations.iter().find(|o| o.header.tick == learning.header.tick)
            && o.header.flags & flag::SKIPPED != 0
        {
            assert_eq!(learning.header.flags & (flag::LEARNED | flag::TRACE_CUT), flag::TRACE_CUT);
        }
    }
}
