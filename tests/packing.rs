//! The log of a run that has ended in good order is packed by itself: what is packed and what is not, and that all who
//! read it later (replay, a run that continues it) find what they need.

mod support;

use std::path::Path;

use serde_json::Value;
use support::content::read_log;
use support::{TestFolder, assert_no_debris};
use tectum_testkit::ScenarioFile;

/// The paper's arm with every tick in its log. Its rule is quick.
fn paper() -> ScenarioFile {
    ScenarioFile::built_in("paper").set("log.every", 1)
}

/// Whether a log is packed, and the topics that repeat its samples.
fn layout(log: &Path) -> (bool, usize) {
    let views = named_views(&std::fs::read(log).unwrap());
    let mut reader = tectum::log::LogReader::open(log).unwrap();
    assert!(reader.by_ref().all(|record| record.is_ok()) && reader.finished());
    (reader.packed(), views)
}

/// How many of the views' topics a file names.
fn named_views(bytes: &[u8]) -> usize {
    let named = |topic: &str| bytes.windows(topic.len()).any(|window| window == topic.as_bytes());
    let [samples, scene] = [
        &["/inputs", "/outputs", "/applied", "/measures", "/joint_states", "/loss", "/error"][..],
        &["/transforms", "/scene/links", "/scene/target", "/scene/path"],
    ];
    samples.iter().chain(scene).filter(|topic| named(topic)).count()
}

fn sizes(summary: &Value) -> (u64, Option<u64>) {
    (summary["log_bytes"].as_u64().unwrap(), summary["log_unpacked_bytes"].as_u64())
}

#[test]
fn a_log_is_packed_when_its_run_is_over_and_can_be_continued() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.write_scenario(&paper());
    let first = test_folder.run(&[&scenario, "--ticks", "2000", "--json"]).wait().expect(0).json();
    assert_no_debris(test_folder.run_folder());
    let (bytes, before) = sizes(&first);
    assert_eq!(bytes, test_folder.log_path().metadata().unwrap().len());
    assert!(before.unwrap() > bytes, "{first}");
    assert_eq!(layout(&test_folder.log_path()), (true, 11));
    let names = test_folder.run_folder().read_dir().unwrap().map(|entry| entry.unwrap().file_name());
    assert!(names.into_iter().all(|name| !name.to_string_lossy().starts_with('.')), "a draft was left");
    test_folder.tectum("replay", &["run"]).expect(0);
    assert_eq!(test_folder.tectum("log", &["info", "run", "--json"]).expect(0).json()["state"], "whole");

    // The same run goes on to another tick, as if it had been one.
    let start = |arguments: &[&str]| test_folder.tectum("run", &[arguments, &["--json"]].concat()).expect(0).json();
    let second = start(&["--resume", "run", "--ticks", "3000", "--out", "second"]);
    let one = start(&[&scenario, "--ticks", "3000", "--out", "one"]);
    assert_eq!((&second["resumed_at"], &second["weights_hash"]), (&2000.into(), &one["weights_hash"]));
    let log = |folder: &str| read_log(&test_folder.path().join(folder).join("log.mcap")).1;
    let (first, second, one) = (log("run"), log("second"), log("one"));
    assert_eq!([first.commands.len(), second.commands.len(), one.commands.len()], [2000, 1000, 3000]);
    let drawn = |commands: &[tectum::wire::Command]| commands.iter().map(|c| c.drawn).collect::<Vec<_>>();
    assert!([drawn(&first.commands), drawn(&second.commands)].concat() == drawn(&one.commands));
}

#[test]
fn the_scenario_decides_what_is_packed() {
    let test_folder = TestFolder::new();
    for (name, pack, views, expected) in [
        ("asked", Some(true), true, (true, 11)),
        ("never", Some(false), true, (false, 0)),
        ("bare", None, false, (true, 0)),
    ] {
        let scenario = pack.map_or_else(paper, |pack| paper().set("log.pack", pack)).set("log.views", views);
        let scenario = test_folder.write_scenario(&scenario);
        let outcome = test_folder.tectum("run", &[&scenario, "--ticks", "500", "--out", name]).expect(0);
        assert_eq!(layout(&test_folder.path().join(name).join("log.mcap")), expected, "{name}");
        assert_eq!(outcome.stdout.contains(" MB, packed from "), expected.0, "{}", outcome.stdout);
    }
}

#[test]
fn an_interrupted_log_is_packed_and_one_of_a_failed_run_stays_as_it_was() {
    let test_folder = TestFolder::new();
    // Every 100th tick, so that the log stays small however long the signal takes.
    let thinned = paper().set("log.every", 100).set("restart.controller", "never");
    let scenario = test_folder.write_scenario(&thinned);
    let mut run = test_folder.run(&[&scenario, "--ticks", "1e6"]);
    run.wait_until_tick(1000);
    run.signal("INT");
    run.wait().expect(130);
    assert!(layout(&test_folder.log_path()).0);

    let failed = TestFolder::new();
    let scenario = failed.write_scenario(&thinned);
    let mut run = failed.run(&[&scenario, "--ticks", "1e6"]);
    run.wait_until_tick(1000);
    run.kill_child("tectum-controller");
    run.wait().expect(4);
    assert_eq!(layout(&failed.log_path()), (false, 0));
}

#[test]
fn the_torn_segment_of_a_killed_logger_stays_and_the_next_one_is_packed() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.write_scenario(&paper().set("restart.backoff_ms", 1).set("log.pack", true));
    let mut run = test_folder.run(&[&scenario, "--ticks", "4000", "--json"]);
    run.wait_until_tick(1000);
    run.kill_child("tectum-logger");
    let summary = run.wait().expect(0).json();
    assert_eq!(summary["log_segments"], 2);
    let segment = |name: &str| tectum::log::LogReader::open(&test_folder.run_folder().join(name)).unwrap();
    let (mut torn, mut whole) = (segment("log.mcap"), segment("log-1.mcap"));
    torn.by_ref().for_each(drop);
    whole.by_ref().for_each(drop);
    assert_eq!([torn.finished(), torn.packed(), whole.finished(), whole.packed()], [false, false, true, true]);
    test_folder.tectum("replay", &["run"]).expect(0);
}
