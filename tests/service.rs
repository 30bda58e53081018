//! A run as a service, and as a library call: what a service manager hears, and what a program with a handle sees and
//! does.

mod support;

use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use support::{Process, TECTUM, TestFolder, WATCHDOG, assert_no_debris};
use tectum::runtime::Mode;
use tectum::scenario::{Plan, Scenario};
use tectum::supervise::{Launch, LaunchError, RunHandle, RunOutcome};

/// A service manager: its socket, with the test's watchdog as the limit of every wait.
struct Manager(UnixDatagram);

impl Manager {
    fn new(folder: &Path) -> Self {
        let socket = UnixDatagram::bind(folder.join("notify")).unwrap();
        socket.set_read_timeout(Some(WATCHDOG)).unwrap();
        Self(socket)
    }

    fn next(&self) -> Option<String> {
        let mut bytes = [0; 400];
        self.0.recv(&mut bytes).ok().map(|n| String::from_utf8_lossy(&bytes[..n]).into_owned())
    }

    /// Waits for a message that begins with `what`, and returns it.
    fn expect(&self, what: &str) -> String {
        std::iter::from_fn(|| self.next()).find(|text| text.starts_with(what)).unwrap_or_else(|| panic!("no {what}"))
    }
}

/// An endless run at a period of 5 ms, whose processes never count as hung; a sign of life is due every 0.1 s.
fn service(folder: &TestFolder) -> Process {
    let file = folder.arm_scenario(&[("period_ms", "5")]);
    support::append(&file, "\n[restart]\nhang_s = 0.0\n");
    let mut command = Command::new(TECTUM);
    command.args(["run", &file, "--mode", "realtime", "--ticks", "endless", "--out", "run", "--json"]);
    command.env("NOTIFY_SOCKET", folder.path().join("notify")).env("WATCHDOG_USEC", "200000");
    folder.start_command(command)
}

#[test]
fn a_service_manager_hears_of_set_up_ticks_and_the_end() {
    let folder = TestFolder::new();
    let manager = Manager::new(folder.path());
    let run = service(&folder);
    assert!(manager.next().unwrap().contains("EXTEND_TIMEOUT_USEC=40000000"));
    assert_eq!(manager.expect("READY"), "READY=1");
    manager.expect("WATCHDOG=1");
    assert!(manager.expect("STATUS=tick ").contains(", missed "));
    run.signal("TERM");
    assert!(manager.expect("STOPPING=1").contains("STATUS=closing at tick "));
    run.wait().expect(143);
}

/// The launcher lives and its plant stands still: no sign of life goes out, or the service would stand still unnoticed.
#[test]
fn a_run_that_stands_still_gives_no_sign_of_life() {
    let folder = TestFolder::new();
    let manager = Manager::new(folder.path());
    let mut run = service(&folder);
    manager.expect("WATCHDOG=1");
    let plant = run.child_pid("tectum-simulator");
    support::signal_process(plant, "STOP");
    // What is read when nothing came for ten times the interval was sent before.
    manager.0.set_read_timeout(Some(Duration::from_secs(1))).unwrap();
    while manager.next().is_some() {}
    support::signal_process(plant, "CONT");
    manager.0.set_read_timeout(Some(WATCHDOG)).unwrap();
    manager.expect("WATCHDOG=1");
    run.signal("INT");
    run.wait().expect(130);
}

#[test]
fn an_address_that_is_none_is_a_warning() {
    let folder = TestFolder::new();
    let mut command = Command::new(TECTUM);
    command.args(["run", "paper", "--ticks", "100", "--out", "run", "--json"]).env("NOTIFY_SOCKET", "vsock:2:1");
    let outcome = folder.start_command(command).wait().expect(0);
    assert!(outcome.stderr.contains("NOTIFY_SOCKET is vsock:2:1, which cannot be used"), "{}", outcome.stderr);
}

fn plan(folder: &TestFolder, ticks: &str) -> Plan {
    Scenario::load(Path::new(&folder.arm_scenario(&[("ticks", ticks), ("every", "100")]))).unwrap().plan().unwrap()
}

/// The calls of the example in the crate's documentation, on a run that would not end within a test.
#[test]
fn a_program_starts_looks_checkpoints_and_stops() {
    let folder = TestFolder::new();
    let launch = Launch { out: Some(folder.run_folder()), ..Launch::new(plan(&folder, "10_000_000"), Mode::Lockstep) };
    let run = RunHandle::start(launch).unwrap();
    let began = std::time::Instant::now();
    let wait_until = |what: &str, is_so: &dyn Fn() -> bool| {
        while !is_so() {
            assert!(!run.is_over(), "the run ended before {what}");
            assert!(began.elapsed() < WATCHDOG, "no {what}");
            std::thread::park_timeout(Duration::from_millis(2));
        }
    };
    wait_until("tick", &|| run.look().ticks > 1000);
    run.checkpoint();
    let checkpoints = folder.run_folder().join("checkpoints");
    wait_until("checkpoint", &|| std::fs::read_dir(&checkpoints).is_ok_and(|files| files.count() >= 2));
    assert_eq!(run.look().folder, Some(folder.run_folder()));
    run.stop();
    let summary = run.wait().unwrap();
    assert_eq!((summary.ended, summary.exit_code()), (RunOutcome::Signal(15), 143));
    assert_no_debris(folder.run_folder());
}

#[test]
fn a_run_that_ends_by_itself_or_cannot_start_says_so() {
    let folder = TestFolder::new();
    let launch = Launch { out: Some(folder.run_folder()), ..Launch::new(plan(&folder, "2000"), Mode::Lockstep) };
    let summary = RunHandle::start(launch.clone()).unwrap().wait().unwrap();
    assert_eq!((summary.ended, summary.exit_code()), (RunOutcome::Complete, 0));
    // The folder holds that run.
    let error = RunHandle::start(launch).unwrap().wait().unwrap_err();
    assert!(matches!(error, LaunchError::Folder { .. }), "{error}");
    // A handle that is dropped takes its run along.
    let out = folder.path().join("dropped");
    let launch = Launch { out: Some(out.clone()), ..Launch::new(plan(&folder, "10_000_000"), Mode::Lockstep) };
    let run = RunHandle::start(launch).unwrap();
    let began = std::time::Instant::now();
    while run.look().ticks == 0 && began.elapsed() < WATCHDOG {
        std::thread::park_timeout(Duration::from_millis(2));
    }
    drop(run);
    assert_no_debris(&out);
}
