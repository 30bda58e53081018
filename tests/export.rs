//! `tectum log export`: tables, and a LeRobotDataset that is read back with pyarrow and, on command, by LeRobot.
//!
//! ```text
//! python3 -m venv ../lerobot && ../lerobot/bin/pip install lerobot pyarrow           # 5 GB with PyTorch
//! TECTUM_LEROBOT_PYTHON=../lerobot/bin/python TECTUM_PYTHON=... cargo test --test export lerobot_itself -- --ignored
//! ```

mod support;

use std::process::Command;

use serde_json::Value;
use support::{TECTUM, TestFolder, python};

/// A run of 300 ticks with new targets after 80 ticks.
fn recorded(folder: &TestFolder) {
    let scenario = folder.arm_scenario(&[("every", "1")]);
    folder.run(&[&scenario, "--ticks", "300"]).wait().expect(0);
}

#[test]
fn csv_is_the_table_of_log_csv_and_missing_packages_are_named() {
    let folder = TestFolder::new();
    recorded(&folder);
    folder.tectum("log", &["export", "run", "--format", "csv", "--out", "a.csv"]).expect(0);
    let table = folder.tectum("log", &["csv", "run"]).expect(0).stdout;
    assert!(std::fs::read_to_string(folder.path().join("a.csv")).unwrap() == table);
    for format in ["parquet", "lerobot"] {
        let mut command = Command::new(TECTUM);
        command.args(["log", "export", "run", "--format", format, "--out", "out"]).env("TECTUM_PYTHON", "no-python");
        let refused = folder.start_command(command).wait().refusal();
        assert!(refused.contains("no-python lacks them") && refused.contains("pip install"), "{refused}");
        assert!(!folder.path().join("out").exists());
    }
}

#[test]
#[ignore = "needs Python with tectum and pyarrow: TECTUM_PYTHON"]
fn a_dataset_holds_every_tick_whose_reward_is_known() {
    let folder = TestFolder::new();
    recorded(&folder);
    let export = |format: &str, out: &str| {
        let mut command = Command::new(TECTUM);
        command.args(["log", "export", "run", "--format", format, "--out", out]);
        folder.start_command(command).wait()
    };
    let made: Value = serde_json::from_str(&export("lerobot", "set").expect(0).stdout).unwrap();
    assert_eq!((&made["episodes"], &made["frames"]), (&4.into(), &299.into()));
    let again = export("lerobot", "set").expect(2).stderr;
    assert!(again.contains("set exists already"), "{again}");
    let table: Value = serde_json::from_str(&export("parquet", "a.parquet").expect(0).stdout).unwrap();
    assert_eq!((&table["rows"], &table["columns"]), (&300.into(), &23.into()));
    let script = python::script("check_dataset.py");
    let checked = folder.start(python::python(), &[&script, "set", "a.parquet", "run"]).wait().expect(0).json();
    assert_eq!(checked["lengths"], serde_json::json!([80, 80, 80, 59]));
    assert_eq!(checked["faults"], serde_json::json!([]));
}

#[test]
#[ignore = "needs Python with lerobot: TECTUM_LEROBOT_PYTHON, and with tectum and pyarrow: TECTUM_PYTHON"]
fn lerobot_itself_loads_the_dataset() {
    let folder = TestFolder::new();
    recorded(&folder);
    folder.tectum("log", &["export", "run", "--format", "lerobot", "--out", "set"]).expect(0);
    let lerobot = std::env::var("TECTUM_LEROBOT_PYTHON").expect("TECTUM_LEROBOT_PYTHON names an interpreter");
    let loaded = folder.start(&lerobot, &[&python::script("check_lerobot.py"), "set"]).wait().expect(0).json();
    assert_eq!((&loaded["episodes"], &loaded["frames"]), (&4.into(), &299.into()));
    assert_eq!(loaded["batch"], serde_json::json!({"observation.state": [32, 2, 6], "action": [32, 8, 4]}));
    assert_eq!(loaded["faults"], serde_json::json!([]));
}
