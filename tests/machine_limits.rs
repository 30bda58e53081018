//! Machines that give less than a run would like: few processes for a user, and a disk that is slow to sync.
//!
//! ```text
//! cargo test --test machine_limits -- --ignored      # slow disks: needs strace, and takes minutes
//! ```

mod support;

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use support::{Process, TECTUM, TestFolder, assert_no_debris, signal_process};

/// A user who has no processes, so that a limit of theirs counts the run's alone; each test has one of its own.
#[derive(Clone, Copy)]
struct User(u32);

impl User {
    /// Arguments of `setpriv` with which a program runs as this user.
    fn arguments(self) -> [String; 3] {
        [format!("--reuid={}", self.0), format!("--regid={}", self.0), "--clear-groups".to_owned()]
    }

    fn command(self, program: &str) -> Command {
        let mut command = Command::new("setpriv");
        command.args(self.arguments()).arg(program).stdin(Stdio::null());
        command
    }
}

/// A folder into which other users may write; `None` where this test may not become that user.
fn folder_of(user: User) -> Option<TestFolder> {
    let test_folder = TestFolder::new();
    fs::set_permissions(test_folder.path(), fs::Permissions::from_mode(0o777)).unwrap();
    // `setpriv` itself may still run what the user may not reach, as below a folder of root's own.
    let arguments = ["--nproc=1000", TECTUM, "--version"];
    let run_program = user.command("prlimit").args(arguments).current_dir(test_folder.path()).output();
    let may = run_program.is_ok_and(|output| output.status.success());
    if !may {
        eprintln!("skipped: this test needs root, setpriv, and programs that other users may run");
    }
    may.then_some(test_folder)
}

/// Starts `tectum run` as the user, who may have so many processes and threads.
fn run_within(test_folder: &TestFolder, user: User, processes: u32, arguments: &[&str]) -> Process {
    let (user, limit) = (user.arguments(), format!("--nproc={processes}"));
    let begin = ["prlimit", &limit, TECTUM, "run", "--out", "run", "--json"];
    let user: Vec<&str> = user.iter().map(String::as_str).collect();
    test_folder.start(Path::new("setpriv"), &[&user[..], &begin, arguments].concat())
}

/// However few processes a user may have: a run starts, or says in one sentence why it does not.
#[test]
fn a_limit_on_processes_is_named_and_nothing_is_left() {
    let (user, mut codes) = (User(54316), Vec::new());
    for processes in 1..=7 {
        let Some(test_folder) = folder_of(user) else { return };
        let scenario = test_folder.arm_scenario(&[]);
        let outcome = run_within(&test_folder, user, processes, &[&scenario, "--ticks", "300"]).wait();
        let code = outcome.code.unwrap_or(-1);
        if code != 0 {
            let said: Vec<_> = outcome.stderr.lines().filter(|line| line.starts_with("tectum: ")).collect();
            assert!(said.len() == 1 && said[0].contains("ulimit -u"), "{processes}: {outcome:#?}");
            assert!(!outcome.stderr.contains("panicked"), "{processes}: {outcome:#?}");
        }
        if test_folder.run_folder().join("run.json").exists() {
            assert_no_debris(test_folder.run_folder());
        }
        codes.push(code);
    }
    // Three processes cannot be started, then two have no thread for checkpoints, then all is there.
    assert_eq!(codes, [2, 2, 2, 4, 4, 0, 0]);
}

/// Programs of the same user that take all processes there are.
struct OtherPrograms(Vec<Child>);

impl Drop for OtherPrograms {
    fn drop(&mut self) {
        for child in &mut self.0 {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// A process that died cannot be started again, because other programs of the user have taken its place.
#[test]
fn a_restart_beyond_the_limit_ends_the_run_with_one_sentence() {
    let user = User(54317);
    let Some(test_folder) = folder_of(user) else { return };
    let scenario = test_folder.endless_scenario("lockstep");
    let mut run = run_within(&test_folder, user, 8, &[&scenario]);
    run.wait_until_ticking();
    let mut others = OtherPrograms(Vec::new());
    others.0.extend((0..8).map(|_| user.command("sleep").arg("600").spawn().unwrap()));
    let taken = |pid: u32| fs::read_to_string(format!("/proc/{pid}/comm")).is_ok_and(|name| name.trim() == "sleep");
    run.wait_until("the other programs", || others.0.iter().all(|other| taken(other.id())));
    run.kill_child("tectum-controller");
    let outcome = run.wait();
    assert!(outcome.code == Some(4), "{outcome:#?}");
    let said: Vec<_> = outcome.stderr.lines().filter(|line| line.contains("ulimit -u")).collect();
    assert!(said.len() == 1 && said[0].starts_with("tectum: the controller "), "{outcome:#?}");
    // What the others did is kept.
    let summary = outcome.json();
    assert!(summary["ticks"].as_u64() > Some(0) && summary["lost"].is_u64(), "{summary}");
    assert_no_debris(test_folder.run_folder());
}

/// Makes each sync of a process's files take so long. `None` where strace is missing or may not trace.
fn slow_syncs(run: &mut Process, pid: u32, seconds: u32) -> Option<Child> {
    let inject = format!("inject=fsync,fdatasync:delay_exit={}", 1_000_000 * seconds);
    let pid_text = pid.to_string();
    let arguments = ["-f", "-qq", "-o", "/dev/null", "-e", "signal=none", "-e", "trace=fsync,fdatasync", "-e", &inject];
    let strace = Command::new("strace").args(arguments).args(["-p", &pid_text]).stderr(Stdio::null()).spawn();
    let mut strace = strace.ok()?;
    let mut refused = false;
    run.wait_until("strace", || {
        refused = matches!(strace.try_wait(), Ok(Some(_)));
        let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
        refused || status.lines().any(|line| line.starts_with("TracerPid:\t") && !line.ends_with("\t0"))
    });
    (!refused).then_some(strace)
}

/// A run of ten seconds whose processes need `seconds` for each sync. Its outcome, if strace can be used.
fn run_with_slow_syncs(test_folder: &TestFolder, seconds: u32, programs: &[&str]) -> Option<support::ProcessOutcome> {
    let scenario = test_folder.arm_scenario(&[("period_ms", "5")]);
    let mut run = test_folder.run(&[&scenario, "--mode", "realtime", "--ticks", "2000", "--json"]);
    run.wait_until_ticking();
    let mut tracers = OtherPrograms(Vec::new());
    for program in programs {
        let pid = run.child_pid(program);
        let Some(tracer) = slow_syncs(&mut run, pid, seconds) else {
            eprintln!("skipped: strace is missing, or may not trace here");
            signal_process(run.id(), "INT");
            run.wait();
            return None;
        };
        tracers.0.push(tracer);
    }
    Some(run.wait())
}

/// A disk that takes longer to sync than a process may be silent is no hang.
#[test]
#[ignore = "needs strace"]
fn a_slow_disk_at_the_end_is_waited_for() {
    let test_folder = TestFolder::new();
    let all = ["tectum-simulator", "tectum-controller", "tectum-logger"];
    let Some(outcome) = run_with_slow_syncs(&test_folder, 12, &all) else { return };
    let summary = outcome.expect(0).json();
    assert_eq!((&summary["restarts"], &summary["lost"]), (&serde_json::json!([]), &0.into()), "{summary}");
    assert_eq!((&summary["ended"], summary["failure"].is_null()), (&"complete".into(), true), "{summary}");
    assert_no_debris(test_folder.run_folder());
}

/// One that takes more than a minute is. A process that waits for it cannot even be killed: strace holds it as the
/// kernel would. The wait has a limit, the process is named, and the others' results stay.
#[test]
#[ignore = "needs strace; takes minutes"]
fn a_disk_that_never_answers_ends_the_run_after_a_minute() {
    let test_folder = TestFolder::with_watchdog(Duration::from_secs(600));
    let Some(outcome) = run_with_slow_syncs(&test_folder, 3600, &["tectum-logger"]) else { return };
    let outcome = outcome.expect(4);
    let said = "the logger gives no sign of life and cannot be killed: it waits for a disk";
    assert!(outcome.stderr.contains(said), "{outcome:#?}");
    let killed = outcome.stderr.lines().filter(|line| line.ends_with("any more and is killed")).count();
    assert!(killed == 1, "it is said once: {outcome:#?}");
    let summary = outcome.json();
    assert!(summary["weights_hash"].is_string() && summary["lost"].is_null(), "{summary}");
}
