//! A controller of one's own (`examples/pd.rs`): in three processes and in one, killed, resumed, replayed, and refused
//! with a sentence.

mod support;

use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;

use support::{Process, TestFolder, assert_no_debris, example, signal_process};

/// So many that they take much longer than a restart.
const TICKS: &str = "12000";

/// The scenario of a joint that turns towards an input, with the controller of the example.
fn scenario(learner: &str) -> String {
    format!(
        r#"name = "pd"
ticks = 100_000

[plant.arm]
lengths = [1.0, 0.5]

[controller]
program = {:?}

[learner]
{learner}

[gate]
max_command = 0.05

[log]
hash_every = 100

[restart]
backoff_ms = 1
hang_s = 2
"#,
        example("pd").to_str().unwrap()
    )
}

const PD: &str = "rule = \"pd\"\nposition = \"theta_1\"\ntarget = \"target_x\"\ngain = 0.01\ndamping = 0.002";

fn write(test_folder: &TestFolder, learner: &str) -> String {
    test_folder.write_file("pd.toml", scenario(learner)).to_str().unwrap().to_owned()
}

fn in_process_hash(scenario: &str, ticks: &str) -> serde_json::Value {
    let test_folder = TestFolder::new();
    let outcome = test_folder.run(&[scenario, "--mode", "in-process", "--ticks", ticks, "--json"]).wait().expect(0);
    assert_eq!(outcome.json()["ticks"].to_string(), ticks);
    outcome.json()["weights_hash"].clone()
}

fn size(log: &Path) -> u64 {
    std::fs::metadata(log).map_or(0, |m| m.len())
}

fn kill_controller(run: &mut Process, log: &Path, sizes: &[u64]) {
    let mut pid = 0;
    for bytes in sizes {
        run.wait_until("a grown log", || size(log) > *bytes);
        pid = run.next_child_pid("pd", pid);
        signal_process(pid, "KILL");
    }
}

#[test]
fn it_gives_the_same_numbers_in_lockstep_in_one_process_and_in_a_replay_and_survives_kills() {
    let test_folder = TestFolder::new();
    let scenario = write(&test_folder, PD);
    let hash = in_process_hash(&scenario, TICKS);
    let mut run = test_folder.run(&[&scenario, "--ticks", TICKS, "--json"]);
    kill_controller(&mut run, &test_folder.log_path(), &[200_000, 2_000_000]);
    let summary = run.wait().expect(0).json();
    assert_eq!(summary["weights_hash"], hash, "{summary}");
    assert_eq!(summary["restarts"].as_array().unwrap().len(), 2, "{summary}");
    assert_no_debris(&test_folder.run_folder());

    let replay = test_folder.tectum("replay", &["run", "--json"]).expect(0).json();
    assert_eq!((&replay["weights_hash"], &replay["difference"]), (&hash, &serde_json::Value::Null));
    assert_eq!(replay["hashes"], 121, "{replay}");

    // The agent's own columns have names.
    let csv = test_folder.tectum("log", &["csv", "run", "--channel", "learning"]).expect(0).stdout;
    let mut lines = csv.lines();
    assert!(lines.next().unwrap().ends_with("trace norm,gain,best gain,weights hash"), "{csv:.400}");
    assert!(lines.next().unwrap().contains(",0.01,0.01,"), "{csv:.800}");
}

#[test]
fn a_resumed_run_continues_with_the_agents_state() {
    let test_folder = TestFolder::new();
    let scenario = write(&test_folder, PD);
    let hash = in_process_hash(&scenario, "6000");
    // A run of its full length and one that is stopped in the middle and resumed, from the same checkpoint.
    let run = test_folder.run(&[&scenario, "--ticks", "6000", "--checkpoint-every", "2000", "--json"]);
    assert_eq!(run.wait().expect(0).json()["weights_hash"], hash);
    for tick in ["4000", "6000"] {
        for role in ["plant", "controller"] {
            let _ =
                std::fs::remove_file(test_folder.run_folder().join(format!("checkpoints/{tick}.{role}.safetensors")));
        }
    }
    let resumed = test_folder.start(support::TECTUM, &["run", "--resume", "run", "--out", "rest", "--json"]);
    let summary = resumed.wait().expect(0).json();
    assert_eq!((&summary["weights_hash"], summary["resumed_at"].as_u64()), (&hash, Some(2000)), "{summary}");
}

#[test]
fn it_runs_in_real_time() {
    let test_folder = TestFolder::new();
    let scenario = write(&test_folder, PD);
    let run = test_folder.run(&[&scenario, "--ticks", "20", "--mode", "realtime", "--json"]);
    let summary = run.wait().expect(0).json();
    assert_eq!((summary["ticks"].as_u64(), summary["lost"].as_u64()), (Some(20), Some(0)), "{summary}");
    test_folder.tectum("replay", &["run"]).expect(0);
}

#[test]
fn what_the_program_refuses_is_said_with_file_line_and_key() {
    for (learner, expected) in [
        ("rule = \"pid\"", "pd.toml:11: learner.rule is \"pid\"; pd has \"pd\""),
        ("rule = 3", "pd.toml:11: learner.rule is 3; give one of \"pd\""),
        ("rule = \"pd\"\ngain = -1", "pd.toml:12: learner.gain is -1; give more than 0"),
        ("gain = \"high\"", "pd.toml:11: learner.gain is \"high\"; give"),
        ("gain = 1\ngian = 2", "pd.toml:12: unknown key \"learner.gian\"; did you mean \"learner.gain\"?"),
        ("damping = 1", "pd.toml:10: learner.gain is missing; this key has no default, so add it"),
        ("gain = 1\nposition = \"elbow\"", "pd.toml:12: learner.position is \"elbow\"; give the name of one of the"),
    ] {
        for mode in ["lockstep", "in-process"] {
            let test_folder = TestFolder::new();
            let scenario = write(&test_folder, learner);
            let message = test_folder.run(&[&scenario, "--ticks", "100", "--mode", mode]).wait().expect(2).stderr;
            assert!(message.contains(expected), "{mode}: {message}");
        }
    }
}

#[test]
fn a_program_that_is_no_controller_ends_the_run_with_its_name() {
    let test_folder = TestFolder::new();
    let scenario = std::fs::read_to_string(write(&test_folder, PD)).unwrap();
    let other = |program: &str| {
        let text = scenario.replace(example("pd").to_str().unwrap(), program);
        test_folder.write_file("other.toml", text).to_str().unwrap().to_owned()
    };
    let script = |name: &str, text: &str| {
        let path = test_folder.write_file(name, format!("#!/bin/sh\n{text}\n"));
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let (talks, hangs) =
        (script("talks", "echo this is no frame at all; exec sleep 60"), script("hangs", "exec sleep 60"));
    for (program, code, expected) in [
        ("./nothing", 2, "the controller cannot be started: ./nothing"),
        ("/bin/false", 4, "the controller /bin/false ended with exit code 1 at tick 0"),
        (&talks, 4, "does not speak the protocol of a pipe"),
        (&hangs, 4, "gave no answer to tick 0 for 2 s and was killed; `hang_s` under [restart]"),
    ] {
        let scenario = other(program);
        let out = format!("run{}", program.len());
        let arguments = ["run", &scenario, "--out", &out, "--ticks", "100", "--mode", "in-process"];
        let outcome = test_folder.start(support::TECTUM, &arguments).wait().expect(code);
        assert!(outcome.stderr.contains(expected), "{outcome:#?}");
    }
}

#[test]
fn its_help_names_its_learners() {
    let test_folder = TestFolder::new();
    let help = test_folder.start(example("pd"), &["--help"]).wait().expect(0).stdout;
    assert!(help.contains("Learners ([learner] rule): pd"), "{help}");
}
