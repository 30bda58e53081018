//! Packed logs in readers that are not this project's: `@mcap/core`, which reads by the index alone, with the decoder
//! of Foxglove and Lichtblick, and the Python packages `mcap`, `mcap-ros2-support` and `rosbags`.
//!
//! ```text
//! npm install --prefix target/node @mcap/core fzstd @foxglove/rosmsg @foxglove/rosmsg2-serialization
//! TECTUM_NODE_MODULES=$PWD/target/node/node_modules TECTUM_PYTHON=... cargo test --test readers -- --ignored
//! ```

mod support;

use serde_json::{Value, json};
use support::{TestFolder, python};
use tectum_testkit::ScenarioFile;

/// A run of 400 ticks of the paper's arm in the folder `run`, packed at its end.
fn packed(folder: &TestFolder) {
    let scenario = folder.write_scenario(&ScenarioFile::built_in("paper").set("log.every", 1));
    folder.tectum("run", &[&scenario, "--ticks", "400", "--out", "run"]).expect(0);
}

#[test]
#[ignore = "needs node with @mcap/core, fzstd and Foxglove's decoder"]
fn the_indexed_reader_finds_every_message_in_the_order_of_time() {
    let folder = TestFolder::new();
    packed(&folder);
    let modules = std::env::var("TECTUM_NODE_MODULES").expect("TECTUM_NODE_MODULES names the folder node_modules");
    let script = folder.write_file("indexed.mjs", include_str!("node/indexed.mjs"));
    std::os::unix::fs::symlink(modules, folder.path().join("node_modules")).unwrap();
    let seen = folder.start("node", &[script.to_str().unwrap(), "run/log.mcap"]).wait().expect(0).json();
    assert_eq!(seen["ordered"], true);
    for (topic, count) in [("/observation", 400), ("/learning", 400), ("/loss", 399), ("/scene/path", 100)] {
        assert_eq!(seen["counts"][topic], count, "{topic}: {seen}");
    }
    assert_eq!(seen["frames"], json!(["link_1", "link_2", "link_3", "link_4", "end_effector"]));
    assert_eq!(seen["markers"][7], "joints 3 in link_4", "{seen}");
}

#[test]
#[ignore = "needs Python with mcap, mcap-ros2-support and rosbags: TECTUM_PYTHON"]
fn python_readers_decode_every_topic() {
    let folder = TestFolder::new();
    packed(&folder);
    let script = python::script("check_views.py");
    let arguments = [script.as_str(), "run/log.mcap"];
    let seen: Value = folder.start(python::python(), &arguments).wait().expect(0).json();
    assert_eq!(seen["faults"], json!([]));
    assert_eq!(seen["rosbags"], seen["counts"]);
    assert_eq!(seen["names"], json!(["theta_1", "theta_2", "theta_3", "theta_4"]));
    let frames = ["link_1", "link_2", "link_3", "link_4", "end_effector"].map(|frame| seen["frames"][frame].as_u64());
    assert_eq!(frames, [Some(400); 5]);
    for topic in ["/inputs", "/outputs", "/applied", "/measures", "/joint_states", "/transforms"] {
        assert_eq!(seen["counts"][topic], 400, "{topic}: {seen}");
    }
    assert_eq!(seen["counts"]["/scene/path"], 100, "{seen}");
}
