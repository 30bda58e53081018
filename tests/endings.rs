//! A run may end by a signal or by a killed process, at any time. Nothing hangs, nothing is left in shared memory,
//! and the log can be read.

mod support;

use support::{
    Process, ProcessOutcome, TECTUM, TestFolder, append, assert_no_debris, children, has_ended, read_json,
    shared_memory, signal_process,
};
use tectum::log::LogReader;

/// How far a run has come when it is interrupted.
#[derive(Debug, Clone, Copy)]
enum Progress {
    /// The run's manifest exists and its processes are being started.
    SetUp,
    /// The log exists.
    FirstTick,
    /// The log has grown.
    MidRun,
}

const PROGRESSES: [Progress; 3] = [Progress::SetUp, Progress::FirstTick, Progress::MidRun];

/// Starts a run without restarts and waits for this progress.
fn start(test_folder: &TestFolder, mode: &str, progress: Progress) -> Process {
    let scenario = test_folder.endless_scenario(mode);
    // Without restarts the end of a process ends the run. `tests/restarts.rs` tests restarts.
    append(&scenario, "\n[restart]\nplant = \"never\"\ncontroller = \"never\"\nlogger = \"never\"\n");
    let mut run = test_folder.run(&[&scenario, "--mode", mode, "--json"]);
    let (manifest, log) = (test_folder.run_folder().join("run.json"), test_folder.log_path());
    match progress {
        Progress::SetUp => run.wait_until("the run's manifest", || manifest.exists()),
        Progress::FirstTick => run.wait_until("the log", || log.exists()),
        Progress::MidRun => run.wait_until("a grown log", || {
            let enough = if mode == "lockstep" { 200_000 } else { 60_000 };
            std::fs::metadata(&log).is_ok_and(|m| m.len() > enough)
        }),
    }
    run
}

/// Checks that nothing is left in shared memory and that the log can be read.
fn check(test_folder: &TestFolder, outcome: &ProcessOutcome) {
    let folder = test_folder.run_folder();
    if folder.join("run.json").exists() {
        assert_no_debris(&folder);
    }
    let log = folder.join("log.mcap");
    if log.exists() {
        let mut reader = LogReader::open(&log).unwrap_or_else(|e| panic!("{e}\n{outcome:#?}"));
        assert!(reader.by_ref().all(|record| record.is_ok()), "{outcome:#?}");
    }
}

#[test]
fn a_signal_ends_a_run_cleanly() {
    for mode in ["lockstep", "realtime"] {
        for progress in PROGRESSES {
            for (signal, code) in [("INT", 130), ("TERM", 143), ("HUP", 129), ("QUIT", 131)] {
                let test_folder = TestFolder::new();
                let run = start(&test_folder, mode, progress);
                let launcher = run.id();
                run.signal(signal);
                let outcome = run.wait().expect(code);
                assert!(children(launcher).is_empty());
                check(&test_folder, &outcome);
                if matches!(progress, Progress::MidRun) {
                    let summary = outcome.json();
                    assert!(summary["ticks"].as_u64() > Some(0), "{summary}");
                    assert!(summary["weights_hash"].is_string(), "the controller finished its report: {summary}");
                    assert!(LogReader::open(&test_folder.log_path()).unwrap().last().is_some());
                    let mut reader = LogReader::open(&test_folder.log_path()).unwrap();
                    assert!(reader.by_ref().count() > 0 && reader.finished(), "the log is closed");
                    assert!(!reader.totals().unwrap().complete);
                }
            }
        }
    }
}

/// The reader of standard output and standard error is gone, as after a lost connection: summary and figure are in the
/// run's folder all the same.
#[test]
fn a_closed_terminal_ends_a_run_with_everything_in_its_folder() {
    let test_folder = TestFolder::new();
    let mut run = start(&test_folder, "realtime", Progress::MidRun);
    run.close_output();
    run.signal("HUP");
    let outcome = run.wait().expect(129);
    check(&test_folder, &outcome);
    let folder = test_folder.run_folder();
    assert_eq!(read_json(folder.join("summary.json"))["ended"], serde_json::json!({ "signal": 1 }));
    assert!(folder.join("figure.svg").exists() && folder.join("checkpoints").exists());
    let parts =
        std::fs::read_dir(&folder).unwrap().flatten().filter(|e| e.path().extension().is_some_and(|x| x == "part"));
    assert_eq!(parts.count(), 0, "unfinished files are left");
}

/// A run under `nohup` outlives its terminal.
#[test]
fn a_run_under_nohup_goes_on() {
    let test_folder = TestFolder::new();
    let scenario = test_folder.endless_scenario("realtime");
    let arguments = [TECTUM, "run", "--out", "run", &scenario, "--mode", "realtime", "--ticks", "200"];
    let mut run = test_folder.start("/usr/bin/nohup", &arguments);
    run.wait_until_ticking();
    run.signal("HUP");
    run.wait().expect(0);
}

#[test]
fn a_killed_process_ends_the_run_with_a_message() {
    for mode in ["lockstep", "realtime"] {
        for (program, role) in
            [("tectum-simulator", "plant"), ("tectum-controller", "controller"), ("tectum-logger", "logger")]
        {
            let test_folder = TestFolder::new();
            let mut run = start(&test_folder, mode, Progress::FirstTick);
            let pid = run.child_pid(program);
            signal_process(pid, "KILL");
            let outcome = run.wait().expect(4);
            assert!(outcome.stderr.contains(&format!("the {role} was killed by signal 9")), "{outcome:#?}");
            check(&test_folder, &outcome);
        }
    }
}

/// A process receives SIGTERM from another process than the launcher.
/// A process that does not end when the run is interrupted is killed. That it leaves no report is said.
#[test]
fn a_process_that_does_not_end_is_killed_and_named() {
    let test_folder = TestFolder::new();
    let mut run = start(&test_folder, "realtime", Progress::MidRun);
    signal_process(run.child_pid("tectum-logger"), "STOP");
    run.signal("INT");
    let outcome = run.wait().expect(130);
    let message = "tectum: the logger has not ended in time and is killed; it leaves no report";
    assert!(outcome.stderr.contains(message) && outcome.json()["lost"].is_null(), "{outcome:#?}");
    assert_no_debris(test_folder.run_folder());
}

#[test]
fn a_terminated_process_ends_the_run() {
    let test_folder = TestFolder::new();
    let mut run = start(&test_folder, "realtime", Progress::FirstTick);
    let controller = run.child_pid("tectum-controller");
    signal_process(controller, "TERM");
    let outcome = run.wait().expect(4);
    assert!(outcome.stderr.contains("the controller ended"), "{outcome:#?}");
    check(&test_folder, &outcome);
}

/// The plant ends at once while the other processes still set up.
#[test]
fn a_plant_that_never_starts_leaves_no_shared_memory() {
    let text = std::fs::read_to_string("examples/point.toml").unwrap();
    let text = text.replace("target/release/examples/point", "/bin/false");
    for _ in 0..20 {
        let test_folder = TestFolder::new();
        let scenario = test_folder.write_file("scenario.toml", &text);
        // The run's folder is removed, and with it the name of its domain. The domain is recognised as a new one that
        // no launcher of another test holds.
        let before = shared_memory("tectum_");
        test_folder.run(&[scenario.to_str().unwrap()]).wait().expect(4);
        let in_use = |name: &String| std::fs::exists(format!("/dev/shm/{}/launcher.lock", domain_of(name))).unwrap();
        let left: Vec<_> =
            shared_memory("tectum_").into_iter().filter(|name| !before.contains(name) && !in_use(name)).collect();
        let left: Vec<_> = left.iter().filter(|name| shared_memory("tectum_").contains(name)).collect();
        assert!(left.is_empty(), "{left:?}");
    }
}

/// The domain that a file in shared memory belongs to: `tectum_` and eight digits.
fn domain_of(name: &str) -> &str {
    &name[..name.len().min("tectum_00000000".len())]
}

/// Without a launcher nothing could end the processes, so they notice its end themselves.
#[test]
fn processes_end_when_their_launcher_is_killed() {
    for mode in ["lockstep", "realtime"] {
        let test_folder = TestFolder::new();
        let mut run = start(&test_folder, mode, Progress::FirstTick);
        let pids: Vec<u32> =
            ["tectum-simulator", "tectum-controller", "tectum-logger"].map(|p| run.child_pid(p)).to_vec();
        run.signal("KILL");
        assert_eq!(run.wait().code, None);
        let began = std::time::Instant::now();
        while !pids.iter().all(|&pid| has_ended(pid)) {
            assert!(began.elapsed().as_secs() < 60, "processes outlived their launcher in {mode}");
            std::thread::yield_now();
        }
        check_orphaned_log(&test_folder);
        // A killed launcher leaves its domain in shared memory; the test removes it.
        clean(&test_folder);
    }
}

fn check_orphaned_log(test_folder: &TestFolder) {
    let log = test_folder.log_path();
    assert!(LogReader::open(&log).unwrap().all(|record| record.is_ok()));
}

fn clean(test_folder: &TestFolder) {
    let manifest = read_json(test_folder.run_folder().join("run.json"));
    let name: tectum::channel::DomainName = serde_json::from_value(manifest["domain"].clone()).unwrap();
    tectum::channel::remove_domain(&name);
    assert_no_debris(test_folder.run_folder());
}
