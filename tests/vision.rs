//! Trackers in a real run on an emulated chain: one that comes late, is killed, and is followed by another; and one too many.

mod support;

use serde_json::Value;
use support::{Place, Process, TECTUM, assert_no_debris, example, signal_process};
use tectum::runtime::Tracker;
use tectum::wire::flag;

/// Waits until the bridge says that it sees, or that it does not.
fn until(run: &mut Process, witness: &Tracker, sees: bool) {
    let what = if sees { "an arm that sees" } else { "an arm that is blind" };
    run.until(what, || {
        let Some(observation) = witness.observation().unwrap() else { return false };
        let flags = observation.header.flags;
        // The measure, since a bus that is slow on a loaded machine leaves the arm blind as well.
        let seen = flags & flag::FIRST == 0 && (0.0..=500.0).contains(&observation.measures[5]);
        assert!(seen || flags & flag::BLIND != 0, "{observation:?}");
        seen == sees
    });
}

fn scenario(place: &Place) -> String {
    let text = std::fs::read_to_string("scenarios/servo-vision.toml").unwrap();
    let text = text.replace("\"learned-reward\"", "\"paper\"").replace("= 100.0 ", "= 500.0 ");
    place.file("scenario.toml", text).to_str().unwrap().to_owned()
}

#[test]
fn trackers_come_late_are_killed_and_are_followed_by_others() {
    let place = Place::new();
    let mut run = place.run(&[&scenario(&place), "--ticks", "100000", "--json"]);
    let folder = place.run_folder();
    let mut witness = None;
    run.until("a run to look at", || {
        witness = Tracker::join(&folder).ok();
        witness.is_some()
    });
    let witness = witness.unwrap();
    until(&mut run, &witness, false);
    let track = || place.start(example("tracker"), &["--run", "run"]);
    // More of them than a run without trackers has room for.
    for _ in 0..5 {
        let tracker = track();
        until(&mut run, &witness, true);
        signal_process(tracker.id(), "KILL");
        tracker.wait();
        until(&mut run, &witness, false);
    }
    let last = track();
    until(&mut run, &witness, true);
    run.signal("INT");
    run.wait().expect(130);
    last.wait().expect(0);
    drop(witness);
    assert_no_debris(&folder);
    let account = std::fs::read_to_string(folder.join("bridge.json")).unwrap();
    let account: Value = serde_json::from_str(&account).unwrap();
    let vision = &account["vision"];
    assert_eq!((vision["spells"].as_u64(), vision["dropped"].as_u64()), (Some(6), Some(0)), "{account}");
    assert!(vision["age"]["count"].as_u64() > Some(10), "{account}");
    assert!(account["armed"].as_u64() >= Some(1), "{account}");
    // With ticks in which the arm saw nothing, stood still, or had no torque yet.
    let replay = place.start(TECTUM, &["replay", "run", "--json"]).wait().expect(0).json();
    assert!(replay["difference"].is_null() && replay["commands"].as_u64() > Some(20), "{replay}");
}

#[test]
fn who_has_nothing_to_look_at_is_told_so() {
    let place = Place::new();
    let end = place.start(example("tracker"), &["--run", "nowhere", "--wait", "0"]).wait().expect(2);
    assert!(end.stderr.lines().count() == 1 && end.stderr.contains("there is no run at nowhere"), "{end:#?}");
}
