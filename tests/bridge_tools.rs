//! The tools of the real `tectum-bridge` on an emulated chain behind a pseudo-terminal: what they find and write, and
//! that bad input gives one clear sentence and never turns torque on.

#[path = "support/emulator.rs"]
mod emulator;
mod support;

use std::io::{BufRead as _, BufReader, Write as _};
use std::process::{Command, Output, Stdio};

use emulator::Emulator;
use serde_json::Value;
use support::TestFolder;
use tectum::servo::model::Protocol;
use tectum::servo::tools::Calibration;

const BRIDGE: &str = env!("CARGO_BIN_EXE_tectum-bridge");

/// Starts an emulator with its port at `arm` in the test folder.
fn start(test_folder: &TestFolder, arguments: &[&str]) -> Emulator {
    let mut emulator = Emulator::start(test_folder, &[&["--link", "arm"], arguments].concat());
    assert!(emulator.next_report()["port"].is_string());
    emulator
}

/// Sends a command to the emulator and returns the state of all servos.
fn servos_after(emulator: &mut Emulator, command: &str) -> Vec<Value> {
    emulator.send_command(command);
    emulator.next_report()["servos"].as_array().unwrap().clone()
}

/// Runs `tectum-bridge` to its end.
fn tool(test_folder: &TestFolder, arguments: &[&str]) -> Output {
    Command::new(BRIDGE).args(arguments).current_dir(test_folder.path()).stdin(Stdio::null()).output().unwrap()
}

/// What the user has asked for or set up is wrong.
const INPUT: i32 = 2;

/// A cable, a servo or another program is in the way.
const FAILURE: i32 = 4;

/// The error message of a tool that ended with this exit code, which must be one line.
#[track_caller]
fn refused(code: i32, output: &Output) -> String {
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "{text}");
    assert_eq!(text.trim_end().lines().count(), 1, "{text}");
    text
}

const PORT: [&str; 4] = ["--port", "arm", "--protocol", "feetech"];

#[test]
fn scan_reports_ids_models_and_duplicate_ids() {
    let test_folder = TestFolder::new();
    for (protocol, model) in [("feetech", "STS3215"), ("dynamixel", "XL330-M288")] {
        let _emulator = start(&test_folder, &["--protocol", protocol, "--ids", "1,3"]);
        let scan = ["scan", "--port", "arm", "--protocol", protocol, "--baud", "1000000", "--max-id", "5", "--json"];
        let output = tool(&test_folder, &scan);
        let found: Value = serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {output:?}"));
        let servos: Vec<_> = found["servos"].as_array().unwrap().iter().map(|one| &one["servo"]).collect();
        assert_eq!(servos.iter().map(|s| s["id"].as_u64().unwrap()).collect::<Vec<_>>(), [1, 3]);
        assert!(servos.iter().all(|servo| servo["model"] == model), "{found}");
    }
    let _emulator = start(&test_folder, &["--protocol", "feetech", "--ids", "1,2,2"]);
    let scan = ["scan", "--port", "arm", "--baud", "1000000", "--max-id", "3", "--protocol"];
    assert!(refused(INPUT, &tool(&test_folder, &[&scan[..], &["feetech"]].concat())).contains("two servos"));
    let output = tool(&test_folder, &[&scan[..], &["dynamixel"]].concat());
    assert!(refused(FAILURE, &output).contains("no servo answers"));
}

/// An adapter that holds answers back or sends back what it is sent, and a servo that answers pings alone, are told
/// apart from an empty bus.
#[test]
fn scan_says_what_adapter_and_servo_do() {
    let text = std::fs::read_to_string("scenarios/servo-emulated.toml").unwrap();
    let scan = ["scan", "--port", "arm", "--protocol", "dynamixel", "--baud", "1000000", "--max-id", "4"];
    for (with, set, found, said) in [
        ("latency_us = 16000.0", "3:9:1:0", "servo 3, XL330-M288", "holds answers back"),
        ("echo = true", "3:9:1:0", "servo 3, XL330-M288", "sends back what it is sent"),
        ("latency_us = 250.0", "3:68:1:0", "servo 3, answers pings alone", ""),
    ] {
        let test_folder = TestFolder::new();
        test_folder.write_file("scenario.toml", text.replace("latency_us = 250.0", with));
        let emulator = ["--protocol", "dynamixel", "--ids", "3", "--scenario", "scenario.toml", "--set", set];
        let _emulator = start(&test_folder, &emulator);
        let output = tool(&test_folder, &scan);
        let [out, err] = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned());
        assert!(output.status.success() && out.contains(found), "{with}: {output:?}");
        assert_eq!(out.lines().count(), 1, "{out}");
        assert!(err.contains(said) && err.is_empty() == said.is_empty(), "{with}: {err}");
    }
}

#[test]
fn a_calibration_by_hand_can_be_read_by_a_scenario() {
    let test_folder = TestFolder::new();
    let mut emulator = start(&test_folder, &["--protocol", "feetech", "--ids", "1,2"]);
    let mut child = Command::new(BRIDGE)
        .args(["calibrate", "--ids", "1,2", "--out", "arm.toml", "--max-speed", "4.5"])
        .args(PORT)
        .current_dir(test_folder.path())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut answers = child.stdin.take().unwrap();
    let mut output_lines = BufReader::new(child.stdout.take().unwrap()).lines();
    // The second joint is mounted in the opposite direction, and its zero is near the end of the turn.
    let steps = [
        (1, 2000, ""),
        (1, 2200, ""),
        (1, 1000, ""),
        (1, 3000, ""),
        (2, 4000, ""),
        (2, 3800, ""),
        (2, 900, ""),
        (2, 3000, ""),
        // Its range lies across the encoder's 0, so the tool asks whether to write a homing offset.
        (2, 3000, ""),
    ];
    for (id, at, answer) in steps {
        // The tool asks for each step before the joint is moved.
        output_lines.by_ref().map(Result::unwrap).find(|line| line.contains(&format!("(servo {id})"))).unwrap();
        let state = servos_after(&mut emulator, &format!("hand {id} {at}"));
        assert!(state.iter().all(|servo| servo["torque"] == false));
        writeln!(answers, "{answer}").unwrap();
    }
    assert!(child.wait().unwrap().success());
    let found = Calibration::load(&test_folder.path().join("arm.toml"), Protocol::Feetech).unwrap();
    let [one, two] = &found.joints[..] else { panic!("{found:?}") };
    assert_eq!((one.id, one.direction, one.zero, one.max_speed), (1, 1, 2000, 4.5));
    // From 3000 to 4996 steps: the middle, 3998, is now at 2048.
    assert_eq!((two.id, two.direction, two.zero), (2, -1, 2050));
    assert_eq!((one.registers["homing_offset"], two.registers["homing_offset"]), (0, 1950));
    let step = tectum::servo::model::STEP;
    for (range, ends) in [(one.range, [-1000.0, 1000.0]), (two.range, [-996.0, 1000.0])] {
        assert!(
            range.iter().zip(ends).all(|(end, expected): (&f64, f64)| (end - expected * step).abs() < 1e-9),
            "{range:?}"
        );
    }
    // The file is overwritten only with --force.
    let again = [&["calibrate", "--ids", "1,2", "--out", "arm.toml"], &PORT[..]].concat();
    assert!(refused(INPUT, &tool(&test_folder, &again)).contains("--force"));
}

/// A joint whose range lies across the encoder's 0: `calibrate` writes a homing offset into a Feetech, and `jog` moves
/// the joint with that calibration. A Dynamixel's offset does not move the 0, so it is refused there.
#[test]
fn a_range_across_the_encoders_zero_gets_a_homing_offset() {
    for protocol in ["feetech", "dynamixel"] {
        let test_folder = TestFolder::new();
        let mut emulator = start(&test_folder, &["--protocol", protocol, "--ids", "2"]);
        let bus = ["--port", "arm", "--protocol", protocol];
        let mut child = Command::new(BRIDGE)
            .args(["calibrate", "--ids", "2", "--out", "arm.toml"])
            .args(bus)
            .current_dir(test_folder.path())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut answers = child.stdin.take().unwrap();
        let mut output_lines = BufReader::new(child.stdout.take().unwrap()).lines();
        // From 1200 to 4300 steps, which the encoder calls 204; then the question whether to write the offset.
        let steps = [3000, 3200, 1200, 204, 204];
        for at in &steps[..if protocol == "feetech" { 5 } else { 4 }] {
            output_lines.by_ref().map(Result::unwrap).find(|line| line.contains("(servo 2)")).unwrap();
            servos_after(&mut emulator, &format!("hand 2 {at}"));
            writeln!(answers).unwrap();
        }
        drop(answers);
        let output = child.wait_with_output().unwrap();
        let file = test_folder.path().join("arm.toml");
        if protocol == "dynamixel" {
            assert!(refused(INPUT, &output).contains("take its horn off") && !file.exists());
            continue;
        }
        assert!(output.status.success(), "{output:?}");
        let found = Calibration::load(&file, Protocol::named(protocol)).unwrap();
        let joint = &found.joints[0];
        assert_eq!((joint.zero, joint.registers["homing_offset"]), (3000 - 702, 702), "{protocol}");
        assert_eq!(joint.raw_ends(), Some([1200 - 702, 4300 - 702]), "{protocol}");
        // Back from its upper end, and not the long way round; the offset is in the servo.
        let jog = ["jog", "--id", "2", "--by", "-0.3", "--speed", "2", "--calibration", "arm.toml"];
        let output = tool(&test_folder, &[&jog[..], &bus].concat());
        assert!(output.status.success(), "{protocol}: {output:?}");
        let at = servos_after(&mut emulator, "state")[0]["position"].as_f64().unwrap().rem_euclid(4096.0);
        assert!((at - (4300.0 - 4096.0 - 0.3 / tectum::servo::model::STEP)).abs() < 20.0, "{protocol}: {at}");
    }
}

/// A LeRobot file is taken over if the servos have its homing offsets, and written back as it was.
#[test]
fn a_lerobot_calibration_is_imported_and_exported() {
    let test_folder = TestFolder::new();
    let joint = |id: u8, offset: i32| {
        format!(r#"{{"id": {id}, "drive_mode": 0, "homing_offset": {offset}, "range_min": 900, "range_max": 3100}}"#)
    };
    test_folder.write_file("so.json", format!(r#"{{"base": {}, "hand": {}}}"#, joint(1, -300), joint(2, 44)));
    let import = ["calibrate", "--import", "so.json", "--export", "back.json", "--out"];
    let start_with = |second: &str| {
        // Bit 11 is the sign: 2348 is -300.
        start(&test_folder, &["--protocol", "feetech", "--ids", "1,2", "--set", "1:31:2:2348", "--set", second])
    };
    let emulator = start_with("2:31:2:44");
    let output = tool(&test_folder, &[&import[..], &["arm.toml"], &PORT[..]].concat());
    assert!(output.status.success(), "{output:?}");
    let found = Calibration::load(&test_folder.path().join("arm.toml"), Protocol::Feetech).unwrap();
    assert_eq!((found.joints[0].zero, found.joints[0].registers["homing_offset"]), (2000, -300));
    let back = Calibration::load(&test_folder.path().join("back.json"), Protocol::Feetech).unwrap();
    assert_eq!(back.joints[1].raw_ends(), Some([900, 3100]));
    drop(emulator);
    let _emulator = start_with("2:31:2:45");
    let text = refused(INPUT, &tool(&test_folder, &[&import[..], &["other.toml"], &PORT[..]].concat()));
    assert!(text.contains("servo 2: homing_offset (address 31) is 45 and should be 44"), "{text}");
}

#[test]
fn jog_moves_a_joint_and_turns_torque_off_afterwards() {
    for protocol in ["feetech", "dynamixel"] {
        let test_folder = TestFolder::new();
        let mut emulator = start(&test_folder, &["--protocol", protocol, "--ids", "1,2"]);
        let jog = ["jog", "--port", "arm", "--protocol", protocol, "--id", "2", "--by", "-0.5", "--speed", "2"];
        let output = tool(&test_folder, &[&jog[..], &["--json"]].concat());
        assert!(output.status.success(), "{output:?}");
        let after: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert!(after["id"] == 2 && after["torque"] == false, "{after}");
        let servos = servos_after(&mut emulator, "state");
        let at = servos[1]["position"].as_f64().unwrap();
        assert!((at - (2048.0 - 0.5 / tectum::servo::model::STEP)).abs() < 20.0, "{at}");
        assert_eq!(servos[0]["position"], 2048.0);
        assert!(servos.iter().all(|servo| servo["torque"] == false));
        let watch = ["watch", "--port", "arm", "--protocol", protocol, "--ids", "1,2", "--once", "--json"];
        let output = tool(&test_folder, &watch);
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        let reports: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        assert_eq!(reports.len(), 2, "{output:?}");
        assert!(reports[1]["position"].as_f64().is_some_and(|is| (is - at).abs() <= 1.0), "{text}");
    }
}

#[test]
fn bad_input_is_refused_in_one_sentence_and_torque_stays_off() {
    let test_folder = TestFolder::new();
    let mut emulator = start(&test_folder, &["--protocol", "feetech", "--ids", "1,2,2", "--trace"]);
    // With --trace every servo is reported once, and again only when its torque changes.
    for _ in 0..3 {
        assert_eq!(emulator.next_report()["servos"][0]["torque"], false);
    }
    let other = "protocol = \"feetech\"\n[[joints]]\nid = 9\n";
    let narrow = "protocol = \"feetech\"\n[[joints]]\nid = 1\nrange = [-0.2, 0.2]\n";
    let dynamixel = "protocol = \"dynamixel\"\n[[joints]]\nid = 1\n";
    for (name, text) in [("other.toml", other), ("narrow.toml", narrow), ("dxl.toml", dynamixel), ("bad.toml", "x = ")]
    {
        test_folder.write_file(name, text);
    }
    let jog = |rest: &[&str]| tool(&test_folder, &[&["jog", "--by", "0.3"], &PORT[..], rest].concat());
    for (code, output, text) in [
        (FAILURE, jog(&["--id", "7"]), "no servo answers at id 7"),
        (INPUT, jog(&["--id", "2"]), "two servos"),
        (INPUT, jog(&["--id", "1", "--speed", "50"]), "0.01 to 2 rad/s"),
        (INPUT, jog(&["--id", "1", "--baud", "12345"]), "12345"),
        (INPUT, jog(&["--id", "1", "--calibration", "other.toml"]), "another arm's"),
        (INPUT, jog(&["--id", "1", "--calibration", "dxl.toml"]), "another arm's"),
        (INPUT, jog(&["--id", "1", "--calibration", "narrow.toml"]), "outside its range"),
        (INPUT, jog(&["--id", "1", "--calibration", "bad.toml"]), "bad.toml"),
        (INPUT, jog(&["--id", "1", "--calibration", "none.toml"]), "none.toml"),
        (
            FAILURE,
            tool(&test_folder, &["watch", "--port", "none", "--protocol", "feetech", "--ids", "1"]),
            "no such port",
        ),
        (INPUT, tool(&test_folder, &[&["watch", "--ids", "1,1"], &PORT[..]].concat()), "given twice"),
        (
            FAILURE,
            tool(&test_folder, &[&["watch", "--ids", "7,1,9"], &PORT[..]].concat()),
            "no servo answers at id 7, 9, and one does at 1",
        ),
        (INPUT, tool(&test_folder, &[&["calibrate", "--ids", "1"], &PORT[..]].concat()), "answers end"),
    ] {
        let message = refused(code, &output);
        assert!(message.contains(text), "{text}: {message}");
    }
    // A port that is in use.
    let bus = tectum::servo::bus::Bus::open(
        test_folder.path().join("arm").to_str().unwrap(),
        tectum::servo::model::Protocol::Feetech,
        1_000_000,
        tectum::servo::tools::BUDGET,
        Box::new(tectum::clock::monotonic_ns),
    );
    assert!(refused(FAILURE, &jog(&["--id", "1"])).contains("another program has the port"));
    drop(bus);
    let state = servos_after(&mut emulator, "state");
    assert_eq!(state.len(), 3, "torque went on in between: {state:?}");
    assert!(state.iter().all(|servo| servo["torque"] == false));
    // The trace does report torque when a tool turns it on.
    assert!(tool(&test_folder, &[&["jog", "--by", "0.1", "--id", "1"], &PORT[..]].concat()).status.success());
    assert_eq!(emulator.next_report()["servos"][0]["torque"], true);
}

/// `watch` says that a servo is silent, and goes on.
#[test]
fn watch_goes_on_after_a_silence() {
    let test_folder = TestFolder::new();
    let text = std::fs::read_to_string("scenarios/servo-emulated.toml").unwrap();
    let fault = "[[plant.emulator.faults]]\nkind = \"no-reply\"\nprobability = 0.3\n\n[encoder]\n";
    test_folder.write_file("scenario.toml", text.replacen("[encoder]\n", fault, 1));
    let _emulator = start(&test_folder, &["--protocol", "feetech", "--ids", "1", "--scenario", "scenario.toml"]);
    let mut later = false;
    // Its first question may be lost as well; then it is started again.
    while !later {
        let mut watch = Command::new(BRIDGE)
            .args([&["watch", "--ids", "1", "--json"], &PORT[..]].concat())
            .current_dir(test_folder.path())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut silent = false;
        for line in BufReader::new(watch.stdout.take().unwrap()).lines() {
            let line: Value = serde_json::from_str(&line.unwrap()).unwrap();
            silent |= line["error"].as_str().is_some_and(|error| error.contains("no answer in time"));
            later = silent && line["position"].is_number();
            if later {
                break;
            }
        }
        let _ = watch.kill();
        watch.wait().unwrap();
    }
}

#[test]
fn every_tool_has_help_with_an_example() {
    for (name, first) in [
        ("scan", "--port"),
        ("calibrate", "--port"),
        ("jog", "--port"),
        ("watch", "--port"),
        ("teleop", "/dev/ttyACM0 /dev/ttyACM1"),
    ] {
        let help = Command::new(BRIDGE).args([name, "--help"]).output().unwrap();
        let text = String::from_utf8(help.stdout).unwrap();
        assert!(help.status.success() && text.contains(&format!("tectum-bridge {name} {first}")), "{name}: {text}");
        assert!(text.contains("--json"), "{name}: {text}");
    }
}

/// A missing permission for the port is reported. A test that runs as root changes to another user for this; where that
/// is not possible, the test is skipped.
#[test]
fn a_port_without_permission_is_named() {
    let test_folder = TestFolder::new();
    let port = test_folder.write_file("port", "");
    std::fs::set_permissions(&port, std::os::unix::fs::PermissionsExt::from_mode(0o000)).unwrap();
    let arguments = ["watch", "--port", port.to_str().unwrap(), "--protocol", "feetech", "--ids", "1", "--once"];
    let mut command = Command::new("setpriv");
    command.args(["--reuid", "65534", "--clear-groups", "--bounding-set", "-all", "--inh-caps", "-all"]);
    let output = match std::fs::File::open(&port) {
        Err(_) => tool(&test_folder, &arguments),
        Ok(_) => {
            // The other user may not read the folders of the build and of the test, so the program is passed on
            // standard input.
            let program = std::fs::File::open(BRIDGE).unwrap();
            command.args(["--", "/proc/self/fd/0"]).args(arguments).stdin(program).output().unwrap()
        }
    };
    let text = String::from_utf8_lossy(&output.stderr);
    if output.status.code() != Some(2) && !text.contains("tectum-bridge:") {
        eprintln!("skipped: the test cannot change to another user here: {text}");
        return;
    }
    assert!(refused(INPUT, &output).contains("ermission"), "{text}");
}
