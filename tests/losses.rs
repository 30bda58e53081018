//! What is lost, is said; everything else is kept. Processes that do not return, logs and folders that somebody
//! removes, output that cannot be written, and what other programs leave in shared memory.

mod support;

use std::fs;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
use std::process::{Command, Stdio};
use std::time::Duration;

use support::{
    Process, ProcessOutcome, TECTUM, TestFolder, append, assert_no_debris, domain, has_ended, read_json,
    signal_process, stop_process_for,
};
use tectum::channel::ControllerPorts;
use tectum::log::{LogReader, LogRecord};
use tectum::runtime::Participant;
use tectum::wire::{Role, Status};

const NEVER: &str = "\n[restart]\nplant = \"never\"\ncontroller = \"never\"\nlogger = \"never\"\n";

/// Starts a run that does not end by itself, and waits until its log has grown.
fn start(test_folder: &TestFolder, mode: &str, more: &str) -> Process {
    let scenario = test_folder.endless_scenario(mode);
    append(&scenario, more);
    let mut run = test_folder.run(&[&scenario, "--mode", mode, "--json"]);
    let log = test_folder.log_path();
    let enough = if mode == "lockstep" { 200_000 } else { 60_000 };
    run.wait_until("a grown log", || fs::metadata(&log).is_ok_and(|m| m.len() > enough));
    run
}

/// The message on standard error that begins with `tectum: ` and contains `what`.
#[track_caller]
fn said(outcome: &ProcessOutcome, what: &str) {
    assert!(outcome.stderr.lines().any(|line| line.starts_with("tectum: ") && line.contains(what)), "{outcome:#?}");
}

#[test]
fn a_process_that_is_lost_for_good_leaves_the_results_of_the_others() {
    for mode in ["lockstep", "realtime"] {
        for (lost, program) in
            [("plant", "tectum-simulator"), ("controller", "tectum-controller"), ("logger", "tectum-logger")]
        {
            let test_folder = TestFolder::new();
            let mut run = start(&test_folder, mode, NEVER);
            let pid = run.child_pid(program);
            signal_process(pid, "KILL");
            let outcome = run.wait().expect(4);
            said(&outcome, &format!("the {lost} was killed by signal 9"));
            let (folder, summary) = (test_folder.run_folder(), outcome.json());
            for role in ["plant", "controller", "logger"] {
                let left = folder.join(format!("{role}.json")).exists();
                assert_eq!(left, role != lost, "{mode}: the report of the {role}, with the {lost} lost: {outcome:#?}");
            }
            // What nobody counted is not known.
            for (key, counted_by) in [("clamped", "plant"), ("unheard", "controller"), ("lost", "logger")] {
                assert_eq!(summary[key].is_null(), counted_by == lost, "{mode}, {lost}: {key} of {summary}");
            }
            assert_eq!(summary["weights_hash"].is_string(), lost != "controller", "{summary}");
            assert_eq!(folder.join("figure.svg").exists(), lost != "controller");
            if lost == "plant" {
                let checkpoints = fs::read_dir(folder.join("checkpoints")).unwrap().flatten();
                assert_eq!(checkpoints.count(), 1, "the controller's last checkpoint");
            }
            let mut reader = LogReader::open(&test_folder.log_path()).unwrap();
            assert!(reader.by_ref().all(|record| record.is_ok()));
            assert_eq!(reader.finished(), lost != "logger", "{mode}, {lost}: {outcome:#?}");
            assert_no_debris(&folder);
        }
    }
}

/// The plant has started a program that holds its standard error open, and dies. The run ends, and the program with it.
#[test]
fn a_program_that_the_plant_has_started_does_not_hold_up_the_launcher() {
    let test_folder = TestFolder::new();
    let pid_file = test_folder.path().join("pid");
    let script = format!("#!/bin/sh\nsleep 600 &\necho $! > {}\nexit 1\n", pid_file.display());
    let program = test_folder.write_file("plant.sh", script);
    fs::set_permissions(&program, fs::Permissions::from_mode(0o700)).unwrap();
    let text = fs::read_to_string("examples/point.toml").unwrap();
    let text = text.replace("target/release/examples/point", program.to_str().unwrap());
    let scenario = test_folder.write_file("scenario.toml", text + NEVER);
    let mut run = test_folder.run(&[scenario.to_str().unwrap()]);
    run.wait_until_or_end("the plant's program", || {
        fs::read_to_string(&pid_file).is_ok_and(|text| text.ends_with('\n'))
    });
    run.wait().expect(4);
    let sleeping: u32 = fs::read_to_string(&pid_file).unwrap().trim().parse().unwrap();
    let began = std::time::Instant::now();
    while !has_ended(sleeping) {
        assert!(began.elapsed().as_secs() < 60, "what the plant had started goes on");
        std::thread::yield_now();
    }
}

#[test]
fn a_log_that_is_removed_or_cut_off_is_no_success() {
    for (how, what) in [("removed", "was removed or replaced"), ("cut off", "was cut off")] {
        let test_folder = TestFolder::new();
        let scenario = test_folder.endless_scenario("realtime");
        let mut run = test_folder.run(&[&scenario, "--mode", "realtime", "--ticks", "1000", "--json"]);
        let log = test_folder.log_path();
        // Much more than what is left of it when it is cut off.
        run.wait_until("a grown log", || fs::metadata(&log).is_ok_and(|m| m.len() > 60_000));
        match how {
            "removed" => fs::remove_file(&log).unwrap(),
            _ => fs::File::options().write(true).open(&log).unwrap().set_len(30_000).unwrap(),
        }
        let outcome = run.wait().expect(2);
        said(&outcome, what);
        let summary = outcome.json();
        assert!(summary["weights_hash"].is_string() && summary["ended"] == "complete", "{summary}");
        let missing = summary["log_missing_from"].as_u64().unwrap();
        assert_eq!((missing == 0, summary["log"].is_null()), (how == "removed", how == "removed"), "{summary}");
        // What the summary counts as lost is what no reader can find.
        let observations =
            |log: LogReader| log.filter(|record| matches!(record, Ok(LogRecord::Observation(_)))).count();
        let found = LogReader::open(&test_folder.log_path()).map_or(0, observations) as u64;
        assert_eq!(summary["lost_by_channel"][0].as_u64().unwrap() + found, summary["ticks"].as_u64().unwrap());
    }
}

/// Somebody changes the log when its logger has closed it and the run is not over.
#[test]
fn the_log_is_compared_with_what_was_written_when_the_run_is_over() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.endless_scenario("realtime");
    let mut run = test_folder.run(&[&scenario, "--mode", "realtime", "--ticks", "200", "--json"]);
    run.wait_until_ticking();
    let launcher = run.id();
    let report = test_folder.run_folder().join("logger.json");
    run.wait_until("the logger's report", || {
        if !report.exists() {
            return false;
        }
        signal_process(launcher, "STOP");
        true
    });
    // The launcher may have been quicker than the signal; then there is nothing to test.
    let over = test_folder.run_folder().join("summary.json").exists();
    fs::File::options().write(true).open(test_folder.log_path()).unwrap().set_len(1000).unwrap();
    signal_process(launcher, "CONT");
    let outcome = run.wait();
    if !over {
        said(&outcome.expect(2), "bytes of the log are left");
    }
}

#[test]
fn a_folder_that_is_removed_is_made_again_and_the_loss_is_said() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.endless_scenario("realtime");
    let mut run = test_folder.run(&[&scenario, "--mode", "realtime", "--ticks", "2000", "--json"]);
    run.wait_until_ticking();
    let folder = test_folder.run_folder();
    fs::remove_dir_all(&folder).unwrap();
    run.wait_until("the new folder", || folder.join("run.json").exists());
    // A process can still come back.
    let controller = run.child_pid("tectum-controller");
    signal_process(controller, "KILL");
    let outcome = run.wait().expect(2);
    said(&outcome, "the run's folder has been removed");
    let (summary, on_disk) = (outcome.json(), read_json(folder.join("summary.json")));
    assert!(summary["failure"].as_str().unwrap().contains("was removed at about tick"), "{summary}");
    assert!(summary["weights_hash"].is_string() && summary["log"].is_null(), "{summary}");
    assert_eq!((&summary, summary["restarts"].as_array().unwrap().len()), (&on_disk, 1));
    assert!(folder.join("figure.svg").exists() && folder.join("plant.json").exists());
    assert_no_debris(&folder);
}

#[test]
fn output_that_cannot_be_written_is_no_success() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[]);
    for command in [format!("run {scenario} --ticks 50 --out run --json"), "scenario list".to_owned()] {
        let script = format!("exec {TECTUM} {command} > /dev/full");
        let outcome = test_folder.start("/bin/sh", &["-c", &script]).wait().expect(2);
        said(&outcome, "standard output cannot be written");
    }
    assert_eq!(read_json(test_folder.run_folder().join("summary.json"))["ended"], "complete");
}

#[test]
fn of_two_runs_with_one_folder_one_is_refused() {
    for _ in 0..5 {
        let test_folder = TestFolder::new();
        let scenario = test_folder.arm_scenario(&[("every", "1")]);
        let runs = [(); 2].map(|()| test_folder.run(&[&scenario, "--ticks", "300", "--json"]));
        let mut outcomes = runs.map(Process::wait);
        outcomes.sort_by_key(|outcome| outcome.code);
        let [done, refused] = outcomes;
        let (summary, message) = (done.expect(0).json(), refused.refusal());
        assert!(message.contains("another run has just begun") || message.contains("holds a run already"), "{message}");
        assert_eq!(summary, read_json(test_folder.run_folder().join("summary.json")));
        let log = LogReader::open(&test_folder.log_path()).unwrap();
        assert_eq!(log.filter(|record| record.is_ok()).count(), 900);
    }
}

/// Every tick of this run is passed over, because the plant is stopped before the first and until after the last.
#[test]
fn a_run_whose_ticks_were_all_passed_over_did_not_go_well() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[("period_ms", "5")]);
    let mut run = test_folder.run(&[&scenario, "--mode", "realtime", "--ticks", "100", "--json"]);
    let plant = run.child_pid("tectum-simulator");
    // Created 0.1 s before tick 0.
    let part = test_folder.run_folder().join("plant.json.part");
    run.wait_until("the start", || part.exists());
    stop_process_for(plant, Duration::from_millis(1500));
    let outcome = run.wait();
    let summary = outcome.json();
    // On a busy machine the plant may have begun some ticks before it was stopped.
    if summary["missed"].as_u64() >= Some(99) {
        said(&outcome.expect(4), "and no command was applied");
    }
}

/// What a run has in shared memory is open to its user alone.
#[test]
fn shared_memory_is_closed_to_other_users() {
    let test_folder = TestFolder::new();
    let run = start(&test_folder, "realtime", "");
    let prefix = domain(test_folder.run_folder());
    for entry in fs::read_dir("/dev/shm").unwrap().flatten() {
        if entry.file_name().to_str().is_some_and(|name| name.starts_with(&prefix)) {
            let mode = entry.metadata().unwrap().mode() & 0o7777;
            assert_eq!(mode & 0o077, 0, "{:?} has mode {mode:o}", entry.path());
        }
    }
    run.signal("INT");
    run.wait().expect(130);
}

/// A process that is started by hand names another process as itself. That one is not killed at the end.
#[test]
fn a_forged_process_id_is_not_killed() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.endless_scenario("realtime");
    let mut run = test_folder.run(&[&scenario, "--mode", "realtime", "--by-hand", "controller"]);
    let (folder, manifest) = (test_folder.run_folder(), test_folder.run_folder().join("run.json"));
    run.wait_until("the run's manifest", || fs::read_to_string(&manifest).is_ok_and(|text| text.trim().ends_with('}')));
    let mut bystander = Command::new("sleep").arg("600").stdin(Stdio::null()).spawn().unwrap();
    let participant = Participant::take(&folder, Role::Controller, None).unwrap();
    let (_ports, board) = participant.open(ControllerPorts::open).unwrap();
    board.status.put(Status { pid: bystander.id(), state: 1, beat: 1, ..Status::default() });
    let outcome = run.wait().expect(4);
    said(&outcome, "the controller ended before the run was over");
    let ended = bystander.try_wait().unwrap();
    let _ = bystander.kill();
    let _ = bystander.wait();
    assert_eq!(ended, None, "a process that is not part of the run was ended");
}

/// Paths are made of what `run.json` holds, so it is checked first.
#[test]
fn a_manifest_that_was_changed_is_refused() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.arm_scenario(&[]);
    test_folder.run(&[&scenario, "--ticks", "20"]).wait().expect(0);
    let manifest = test_folder.run_folder().join("run.json");
    let original = read_json(&manifest);
    for (key, value, what) in [
        ("domain", "../../../home", "eight hexadecimal digits"),
        ("domain", "0123456", "eight hexadecimal digits"),
        ("run", "xyz", "16 hexadecimal digits"),
    ] {
        let mut changed = original.clone();
        changed[key] = value.into();
        fs::write(&manifest, changed.to_string()).unwrap();
        let message = test_folder.start(env!("CARGO_BIN_EXE_tectum-controller"), &["--run", "run"]).wait().refusal();
        assert!(message.contains(what), "{message}");
    }
}

/// Somebody removes the memory of a process, as systemd-logind does at a logout, and then the process dies. In real
/// time it goes on with the numbers of its board, is heard at once, and the loss is stated.
#[test]
fn a_process_without_its_memory_goes_on_in_real_time() {
    for (role, program) in [("plant", "tectum-simulator"), ("controller", "tectum-controller")] {
        let test_folder = TestFolder::new();
        let scenario = test_folder.endless_scenario("realtime");
        let mut run = test_folder.run(&[&scenario, "--mode", "realtime", "--ticks", "1500", "--json"]);
        run.wait_until_tick(300);
        fs::remove_file(memory_of(&test_folder, role)).unwrap();
        run.kill_child(program);
        let outcome = run.wait().expect(4);
        said(&outcome, &format!("the {role} was started again at tick"));
        let summary = outcome.json();
        let warnings = summary["warnings"].as_array().unwrap();
        assert!(warnings.iter().any(|warning| warning["name"] == format!("{role}-forgot")), "{summary}");
        // Numbers that begin anew would be taken for samples that were sent twice, hundreds of them.
        let logger = read_json(test_folder.run_folder().join("logger.json"));
        let twice = logger["duplicates"][usize::from(role == "controller")].as_u64().unwrap();
        assert!(twice <= 1, "{twice} samples of the {role} were dropped: {logger}");
        let log = test_folder.log().unwrap();
        let back = match role {
            "plant" => log.observations.iter().any(|sample| sample.header.incarnation == 1),
            _ => log.commands.iter().any(|sample| sample.header.incarnation == 1),
        };
        assert!(back, "the {role} came back and was not heard");
    }
}

/// In lockstep the result would not be that of the scenario any more.
#[test]
fn a_process_without_its_memory_ends_a_lockstep_run() {
    for (role, program) in [("plant", "tectum-simulator"), ("controller", "tectum-controller")] {
        let test_folder = TestFolder::new();
        let mut run = start(&test_folder, "lockstep", "");
        fs::remove_file(memory_of(&test_folder, role)).unwrap();
        run.kill_child(program);
        let outcome = run.wait().expect(2);
        said(&outcome, "in lockstep it cannot go on without");
        assert_no_debris(test_folder.run_folder());
    }
}

/// The file in which a process keeps its state.
fn memory_of(test_folder: &TestFolder, role: &str) -> std::path::PathBuf {
    format!("/dev/shm/{}/{role}.crash-store", domain(test_folder.run_folder())).into()
}
