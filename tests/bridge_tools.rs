//! The tools of `tectum-bridge`, the real program, on an emulated chain behind a real terminal: what they find and write, and that bad
//! input ends in one clear sentence with torque never on.

#[path = "support/emulator.rs"]
mod emulator;
mod support;

use std::io::{BufRead as _, BufReader, Write as _};
use std::process::{Command, Output, Stdio};

use emulator::Emulator;
use serde_json::Value;
use support::Place;
use tectum::servo::tools::Calibration;

const BRIDGE: &str = env!("CARGO_BIN_EXE_tectum-bridge");

/// An emulator at `arm` in a place.
fn start(place: &Place, arguments: &[&str]) -> Emulator {
    let mut emulator = Emulator::start(place, &[&["--link", "arm"], arguments].concat());
    assert!(emulator.line()["port"].is_string());
    emulator
}

/// What it answers: how all servos are.
fn ask(emulator: &mut Emulator, command: &str) -> Vec<Value> {
    emulator.say(command);
    emulator.line()["servos"].as_array().unwrap().clone()
}

fn tool(place: &Place, arguments: &[&str]) -> Output {
    Command::new(BRIDGE).args(arguments).current_dir(place.path()).stdin(Stdio::null()).output().unwrap()
}

/// What a tool said on its way out, which must be one line and the exit code of bad input.
#[track_caller]
fn refused(output: &Output) -> String {
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert_eq!(text.trim_end().lines().count(), 1, "{text}");
    text
}

const ON: [&str; 4] = ["--port", "arm", "--protocol", "feetech"];

#[test]
fn scan_finds_ids_and_models_and_says_when_there_are_none_or_twins() {
    let place = Place::new();
    for (protocol, model) in [("feetech", "STS3215"), ("dynamixel", "XL330-M288")] {
        let _emulator = start(&place, &["--protocol", protocol, "--ids", "1,3"]);
        let scan = ["scan", "--port", "arm", "--protocol", protocol, "--baud", "1000000", "--max-id", "5", "--json"];
        let output = tool(&place, &scan);
        let found: Value = serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {output:?}"));
        let servos: Vec<_> = found["servos"].as_array().unwrap().iter().map(|one| &one["servo"]).collect();
        assert_eq!(servos.iter().map(|s| s["id"].as_u64().unwrap()).collect::<Vec<_>>(), [1, 3]);
        assert!(servos.iter().all(|servo| servo["model"] == model), "{found}");
    }
    let _emulator = start(&place, &["--protocol", "feetech", "--ids", "1,2,2"]);
    let scan = ["scan", "--port", "arm", "--baud", "1000000", "--max-id", "3", "--protocol"];
    assert!(refused(&tool(&place, &[&scan[..], &["feetech"]].concat())).contains("two servos"));
    assert!(refused(&tool(&place, &[&scan[..], &["dynamixel"]].concat())).contains("no servo answers"));
}

#[test]
fn calibration_by_hand_is_written_as_a_scenario_reads_it() {
    let place = Place::new();
    let mut emulator = start(&place, &["--protocol", "feetech", "--ids", "1,2"]);
    let mut child = Command::new(BRIDGE)
        .args(["calibrate", "--ids", "1,2", "--out", "arm.toml", "--max-speed", "4.5"])
        .args(ON)
        .current_dir(place.path())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut answers = child.stdin.take().unwrap();
    let mut said = BufReader::new(child.stdout.take().unwrap()).lines();
    // The second joint is mounted the other way round, with its zero near the end of the turn.
    let steps = [
        (1, 2000, ""),
        (1, 2200, ""),
        (1, 1000, ""),
        (1, 3000, ""),
        (2, 4000, ""),
        (2, 3800, ""),
        (2, 900, ""),
        (2, 3000, ""),
    ];
    for (id, at, answer) in steps {
        // Each step is asked for before the hand does it.
        said.by_ref().map(Result::unwrap).find(|line| line.contains(&format!("(servo {id})"))).unwrap();
        let state = ask(&mut emulator, &format!("hand {id} {at}"));
        assert!(state.iter().all(|servo| servo["torque"] == false));
        writeln!(answers, "{answer}").unwrap();
    }
    assert!(child.wait().unwrap().success());
    let found = Calibration::load(&place.path().join("arm.toml")).unwrap();
    let [one, two] = &found.joints[..] else { panic!("{found:?}") };
    assert_eq!((one.id, one.direction, one.zero, one.max_speed), (1, 1, 2000, 4.5));
    assert_eq!((two.id, two.direction, two.zero), (2, -1, 4000));
    let step = tectum::servo::model::STEP;
    for (range, ends) in [(one.range, [-1000.0, 1000.0]), (two.range, [-996.0, 1000.0])] {
        assert!(range.iter().zip(ends).all(|(is, ought): (&f64, f64)| (is - ought * step).abs() < 1e-9), "{range:?}");
    }
    // It is not written over without being asked to.
    let again = [&["calibrate", "--ids", "1,2", "--out", "arm.toml"], &ON[..]].concat();
    assert!(refused(&tool(&place, &again)).contains("--force"));
}

#[test]
fn a_joint_is_moved_by_as_much_and_has_no_torque_afterwards() {
    for protocol in ["feetech", "dynamixel"] {
        let place = Place::new();
        let mut emulator = start(&place, &["--protocol", protocol, "--ids", "1,2"]);
        let jog = ["jog", "--port", "arm", "--protocol", protocol, "--id", "2", "--by", "-0.5", "--speed", "2"];
        let output = tool(&place, &[&jog[..], &["--json"]].concat());
        assert!(output.status.success(), "{output:?}");
        let after: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert!(after["id"] == 2 && after["torque"] == false, "{after}");
        let servos = ask(&mut emulator, "state");
        let at = servos[1]["position"].as_f64().unwrap();
        assert!((at - (2048.0 - 0.5 / tectum::servo::model::STEP)).abs() < 20.0, "{at}");
        assert_eq!(servos[0]["position"], 2048.0);
        assert!(servos.iter().all(|servo| servo["torque"] == false));
        let watch = ["watch", "--port", "arm", "--protocol", protocol, "--ids", "1,2", "--once", "--json"];
        let output = tool(&place, &watch);
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        let looks: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        assert_eq!(looks.len(), 2, "{output:?}");
        assert!(looks[1]["position"].as_f64().is_some_and(|is| (is - at).abs() <= 1.0), "{text}");
    }
}

#[test]
fn what_cannot_be_is_refused_in_a_sentence_and_torque_is_never_on() {
    let place = Place::new();
    let mut emulator = start(&place, &["--protocol", "feetech", "--ids", "1,2,2", "--trace"]);
    // With --trace every servo is told of once, and then again only when its torque changes.
    for _ in 0..3 {
        assert_eq!(emulator.line()["servos"][0]["torque"], false);
    }
    let other = "protocol = \"feetech\"\n[[joints]]\nid = 9\n";
    let narrow = "protocol = \"feetech\"\n[[joints]]\nid = 1\nrange = [-0.2, 0.2]\n";
    let dynamixel = "protocol = \"dynamixel\"\n[[joints]]\nid = 1\n";
    for (name, text) in [("other.toml", other), ("narrow.toml", narrow), ("dxl.toml", dynamixel), ("bad.toml", "x = ")]
    {
        place.file(name, text);
    }
    let jog = |rest: &[&str]| refused(&tool(&place, &[&["jog", "--by", "0.3"], &ON[..], rest].concat()));
    for (said, text) in [
        (jog(&["--id", "7"]), "no servo answers at id 7"),
        (jog(&["--id", "2"]), "two servos"),
        (jog(&["--id", "1", "--speed", "50"]), "0.01 to 2 rad/s"),
        (jog(&["--id", "1", "--baud", "12345"]), "12345"),
        (jog(&["--id", "1", "--calibration", "other.toml"]), "another arm's"),
        (jog(&["--id", "1", "--calibration", "dxl.toml"]), "another arm's"),
        (jog(&["--id", "1", "--calibration", "narrow.toml"]), "outside its range"),
        (jog(&["--id", "1", "--calibration", "bad.toml"]), "bad.toml"),
        (jog(&["--id", "1", "--calibration", "none.toml"]), "none.toml"),
        (refused(&tool(&place, &["watch", "--port", "none", "--protocol", "feetech", "--ids", "1"])), "no such port"),
        (refused(&tool(&place, &[&["watch", "--ids", "1,1"], &ON[..]].concat())), "given twice"),
        (refused(&tool(&place, &[&["calibrate", "--ids", "1"], &ON[..]].concat())), "answers end"),
    ] {
        assert!(said.contains(text), "{text}: {said}");
    }
    // A port that another has.
    let held = tectum::servo::bus::Bus::open(
        place.path().join("arm").to_str().unwrap(),
        tectum::servo::model::Protocol::Feetech,
        1_000_000,
        tectum::servo::tools::BUDGET,
        Box::new(tectum::clock::monotonic_ns),
    );
    assert!(jog(&["--id", "1"]).contains("another program has the port"));
    drop(held);
    let state = ask(&mut emulator, "state");
    assert_eq!(state.len(), 3, "torque went on in between: {state:?}");
    assert!(state.iter().all(|servo| servo["torque"] == false));
    // The trace would have told: with torque it does.
    assert!(tool(&place, &[&["jog", "--by", "0.1", "--id", "1"], &ON[..]].concat()).status.success());
    assert_eq!(emulator.line()["servos"][0]["torque"], true);
}

#[test]
fn every_tool_has_help_with_an_example() {
    for name in ["scan", "calibrate", "jog", "watch"] {
        let help = Command::new(BRIDGE).args([name, "--help"]).output().unwrap();
        let text = String::from_utf8(help.stdout).unwrap();
        assert!(help.status.success() && text.contains(&format!("tectum-bridge {name} --port")), "{name}: {text}");
        assert!(text.contains("--json"), "{name}: {text}");
    }
}

/// Who may not open the port is told so. A test that runs as root becomes somebody else for it; where nobody can, it cannot be shown.
#[test]
fn a_port_without_permission_is_named() {
    let place = Place::new();
    let port = place.file("port", "");
    std::fs::set_permissions(&port, std::os::unix::fs::PermissionsExt::from_mode(0o000)).unwrap();
    let arguments = ["watch", "--port", port.to_str().unwrap(), "--protocol", "feetech", "--ids", "1", "--once"];
    let mut command = Command::new("setpriv");
    command.args(["--reuid", "65534", "--clear-groups", "--bounding-set", "-all", "--inh-caps", "-all"]);
    let output = match std::fs::File::open(&port) {
        Err(_) => tool(&place, &arguments),
        Ok(_) => {
            // Somebody else may not look into the folders of the build and of the test; the program goes along on standard input.
            let program = std::fs::File::open(BRIDGE).unwrap();
            command.args(["--", "/proc/self/fd/0"]).args(arguments).stdin(program).output().unwrap()
        }
    };
    let text = String::from_utf8_lossy(&output.stderr);
    if output.status.code() != Some(2) && !text.contains("tectum-bridge:") {
        eprintln!("skipped: nobody else can be had here: {text}");
        return;
    }
    assert!(refused(&output).contains("ermission"), "{text}");
}
