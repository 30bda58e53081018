//! The arm SO-101 on emulated servos, whole and in a plane: in lockstep it is a function of scenario and seed, in real
//! time it runs behind a pseudo-terminal, and what is held stays where it is.

#[path = "support/emulator.rs"]
mod emulator;
mod support;

use emulator::Emulator;
use serde_json::Value;
use support::{TECTUM, TestFolder, assert_no_debris, read_json};
use tectum::scenario::Scenario;

/// `scenarios/so101-emulated.toml` with a quick learner and `change` applied to its text.
fn scenario(test_folder: &TestFolder, change: impl FnOnce(String) -> String) -> String {
    changed(test_folder, "so101-emulated", change)
}

/// The same of the scenario `name`.
fn changed(test_folder: &TestFolder, name: &str, change: impl FnOnce(String) -> String) -> String {
    let text = std::fs::read_to_string(format!("scenarios/{name}.toml")).unwrap();
    let text = change(text.replace("rule = \"model-predictive\"", "rule = \"paper\""));
    test_folder.write_file("so101.toml", text).to_str().unwrap().to_owned()
}

#[test]
fn in_lockstep_it_is_a_function_of_scenario_and_seed() {
    let columns = ["target_y", "target_z", "shoulder_pan", "wrist_roll", "error", "end_z", "bus_write_us"];
    is_a_function_of_scenario_and_seed("so101-emulated", &columns, &["gripper"]);
}

#[test]
fn in_a_plane_it_is_a_function_of_scenario_and_seed() {
    let columns = ["target_x", "target_z", "shoulder_lift", "wrist_flex", "error", "end_z", "bus_write_us"];
    is_a_function_of_scenario_and_seed(
        "so101-planar",
        &columns,
        &["target_y", "shoulder_pan", "wrist_roll", "gripper"],
    );
}

fn is_a_function_of_scenario_and_seed(name: &str, columns: &[&str], missing: &[&str]) {
    let test_folder = TestFolder::new();
    let scenario = changed(&test_folder, name, |text| text);
    let result = |name: &str, seed: &str| {
        let run = ["run", &scenario, "--mode", "lockstep", "--ticks", "300", "--seed", seed, "--name", name, "--json"];
        test_folder.start(TECTUM, &run).wait().expect(0);
        let folder = test_folder.path().join("runs").join(name);
        let report = read_json(folder.join("bridge.json"));
        assert!(report["armed"] == 1 && report["blind"] == 0 && report["without_torque"] == serde_json::json!({}));
        assert_no_debris(&folder);
        let replay = test_folder.start(TECTUM, &["replay", name, "--json"]).wait().expect(0).json();
        assert!(replay["difference"].is_null() && replay["commands"] == 300, "{replay}");
        test_folder.tectum("log", &["csv", name]).expect(0).stdout
    };
    let (one, again, other) = (result("one", "1"), result("again", "1"), result("other", "2"));
    let head = one.lines().find(|line| line.contains("target_z")).expect("a head");
    for column in columns {
        assert!(head.contains(column), "{column}: {head}");
    }
    assert!(missing.iter().all(|column| !head.contains(column)), "{head}");
    // The run's id and the writer's times differ; what was measured does not.
    let samples = |text: &str| -> Vec<String> {
        let stamps = |line: &str| line.split(',').skip(2).collect::<Vec<_>>().join(",");
        text.lines().filter(|line| !line.starts_with('#')).map(stamps).collect()
    };
    assert_eq!(samples(&one), samples(&again));
    assert_ne!(samples(&one), samples(&other));
}

/// The gripper has torque and stays where it stood when torque came on; the other joints move within their stops.
#[test]
fn in_real_time_five_joints_move_and_the_gripper_is_held() {
    the_others_are_held("so101-emulated", &[1, 2, 3, 4, 5]);
}

#[test]
fn in_a_plane_pan_and_roll_are_held_too() {
    the_others_are_held("so101-planar", &[2, 3, 4]);
}

/// Runs the scenario `name` in real time: the servos `moving` move, and no other.
fn the_others_are_held(name: &str, moving: &[usize]) {
    let test_folder = TestFolder::new();
    let arguments = ["--protocol", "feetech", "--ids", "1,2,3,4,5,6", "--link", "arm", "--trace"];
    let mut emulator = Emulator::start(&test_folder, &arguments);
    assert!(emulator.next_report()["port"].is_string());
    let mut servos: [Value; 7] = Default::default();
    let mut take = |emulator: &mut Emulator| {
        for servo in emulator.next_report()["servos"].as_array().unwrap() {
            servos[servo["id"].as_u64().unwrap() as usize] = servo.clone();
        }
        servos.clone()
    };
    while take(&mut emulator)[6].is_null() {}
    emulator.send_command("hand 6 2400");
    while take(&mut emulator)[6]["position"] != 2400.0 {}
    let scenario = changed(&test_folder, name, |text| {
        text.replace("port = \"emulator\"  ", "port = \"arm\"  ").replace("sigma = 0.1 ", "sigma = 0.5 ")
    });
    let run = test_folder.run(&[&scenario, "--ticks", "60", "--json"]);
    while take(&mut emulator)[6]["torque"] != true {}
    let outcome = run.wait().expect(0);
    assert_eq!(outcome.json()["mode"], "realtime");
    while take(&mut emulator)[6]["torque"] != false {}
    emulator.send_command("state");
    let servos = take(&mut emulator);
    assert_eq!(servos[6]["position"], 2400.0, "the gripper moved");
    for id in 1..=5 {
        assert_eq!(servos[id]["position"] != 2048.0, moving.contains(&id), "servo {id}: {servos:?}");
    }
    assert!(servos[1..].iter().all(|servo| servo["torque"] == false), "{servos:?}");
    assert_no_debris(test_folder.run_folder());
}

/// A LeRobot file of all six joints takes the place of the table; the gripper in it is held.
#[test]
fn lerobots_calibration_takes_the_place_of_the_joints() {
    let names = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"];
    let joint = |(i, name): (usize, &&str)| {
        let entry = serde_json::json!({
            "id": i + 1, "drive_mode": 0, "homing_offset": 0, "range_min": 900 + i, "range_max": 3100
        });
        ((*name).to_owned(), entry)
    };
    let file: serde_json::Map<String, Value> = names.iter().enumerate().map(joint).collect();
    let test_folder = TestFolder::new();
    test_folder.write_file("own.json", Value::Object(file).to_string());
    let without_joints = |text: String| {
        let (head, tail) = text.split_once("# calibration = \"my-so101.json\"").unwrap();
        let (_, tail) = tail.split_once("[plant.emulator]").unwrap();
        format!("{head}calibration = \"own.json\"\n[plant.emulator]{tail}")
    };
    let path = scenario(&test_folder, without_joints);
    let lockstep = ["--mode", "lockstep", "--ticks", "50", "--json"];
    let outcome = test_folder.run(&[&[path.as_str()][..], &lockstep].concat()).wait().expect(0);
    assert!(outcome.stderr.contains("torque is on"), "{outcome:#?}");
    // Five joints are driven, so a sixth one must be held.
    let path = scenario(&test_folder, |text| without_joints(text).replace("held = [6]", "held = []"));
    let again = [&["run", path.as_str(), "--out", "again"][..], &lockstep].concat();
    let outcome = test_folder.start(TECTUM, &again).wait().expect(2);
    assert!(outcome.stderr.contains("plant.servos.held"), "{outcome:#?}");
}

#[test]
fn what_cannot_be_is_refused() {
    let text = std::fs::read_to_string("scenarios/so101-emulated.toml").unwrap();
    for (message, from, to) in [
        ("plant.so101 stands beside plant.arm", "[plant.so101] ", "[plant.arm]\n\n[plant.so101] "),
        ("plant.servos.held is 7", "held = [6] ", "held = [7] "),
        ("6 entries that are not held, and 5 joints", "held = [6] ", "held = [] "),
        ("plant.servos.sight is \"vision\"", "held = [6] ", "sight = \"vision\"\nheld = [6] "),
    ] {
        assert!(text.contains(from), "{from}");
        let error = match Scenario::parse(&text.replace(from, to), "x.toml").and_then(Scenario::plan) {
            Ok(_) => "accepted".to_owned(),
            Err(error) => error.to_string(),
        };
        assert!(error.contains(message), "{message}: {error}");
    }
}
