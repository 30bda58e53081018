//! Trackers in a real run on an emulated chain: they join late, are killed and are replaced, more of them than a run
//! without trackers has room for. A tracker without a run is refused.

mod support;

use support::{Process, TECTUM, TestFolder, assert_no_debris, example, read_json, signal_process};
use tectum::runtime::Tracker;
use tectum::wire::flag;

/// Waits until the arm's observations are based on vision, or until they are blind.
fn wait_for_vision(run: &mut Process, observer: &Tracker, sees: bool) {
    let what = if sees { "an arm that sees" } else { "an arm that is blind" };
    run.wait_until(what, || {
        let Some(observation) = observer.observation().unwrap() else { return false };
        let flags = observation.header.flags;
        // The age of the vision sample decides: a slow bus on a loaded machine makes the arm blind as well.
        let seen = flags & flag::FIRST == 0 && (0.0..=500.0).contains(&observation.measures[5]);
        assert!(seen || flags & flag::BLIND != 0, "{observation:?}");
        seen == sees
    });
}

fn scenario(test_folder: &TestFolder) -> String {
    let text = std::fs::read_to_string("scenarios/servo-vision.toml").unwrap();
    let text = text.replace("\"learned-reward\"", "\"paper\"").replace("= 100.0 ", "= 500.0 ");
    test_folder.write_file("scenario.toml", text).to_str().unwrap().to_owned()
}

#[test]
fn trackers_may_join_late_be_killed_and_be_replaced() {
    let test_folder = TestFolder::new();
    let mut run = test_folder.run(&[&scenario(&test_folder), "--ticks", "100000", "--json"]);
    let folder = test_folder.run_folder();
    let mut observer = None;
    run.wait_until("a run to join", || {
        observer = Tracker::join(&folder).ok();
        observer.is_some()
    });
    let observer = observer.unwrap();
    wait_for_vision(&mut run, &observer, false);
    let track = || test_folder.start(example("tracker"), &["--run", "run"]);
    // These are more trackers than a run without trackers has room for.
    for _ in 0..5 {
        let tracker = track();
        wait_for_vision(&mut run, &observer, true);
        signal_process(tracker.id(), "KILL");
        tracker.wait();
        wait_for_vision(&mut run, &observer, false);
    }
    let last = track();
    wait_for_vision(&mut run, &observer, true);
    run.signal("INT");
    run.wait().expect(130);
    last.wait().expect(0);
    drop(observer);
    assert_no_debris(&folder);
    let report = read_json(folder.join("bridge.json"));
    let vision = &report["vision"];
    assert_eq!((vision["spells"].as_u64(), vision["dropped"].as_u64()), (Some(6), Some(0)), "{report}");
    assert!(vision["age"]["count"].as_u64() > Some(10), "{report}");
    assert!(report["armed"].as_u64() >= Some(1), "{report}");
    // The log replays, although there are ticks in which the arm was blind, stood still, or had no torque yet.
    let replay = test_folder.start(TECTUM, &["replay", "run", "--json"]).wait().expect(0).json();
    assert!(replay["difference"].is_null() && replay["commands"].as_u64() > Some(20), "{replay}");
}

#[test]
fn a_tracker_without_a_run_is_refused() {
    let test_folder = TestFolder::new();
    let outcome = test_folder.start(example("tracker"), &["--run", "nowhere", "--wait", "0"]).wait().expect(2);
    assert!(
        outcome.stderr.lines().count() == 1 && outcome.stderr.contains("there is no run at nowhere"),
        "{outcome:#?}"
    );
}
