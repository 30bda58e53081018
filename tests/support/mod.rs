//! Shared by all tests that start real processes: the real programs, a fresh folder and a watchdog.
//!
//! Every run creates its own iceoryx2 domain, so tests run in parallel. No helper sleeps and hopes that something has
//! happened meanwhile: each wait checks for the event itself. The watchdog's limit is far beyond any stall of a busy
//! machine. When a test fails, it prints what the processes of the run wrote to their standard error.

#![allow(dead_code)] // Each test binary uses only a part of this module.

pub mod bytes;
pub mod content;
pub mod python;
pub mod slow;
pub mod snapshot;

use std::fs;
use std::io::Read as _;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use tempfile::TempDir;

/// A process that takes longer than this is considered to hang.
pub const WATCHDOG: Duration = Duration::from_secs(120);

/// The `tectum` program under test.
pub const TECTUM: &str = env!("CARGO_BIN_EXE_tectum");

/// The path of an example program; cargo builds the examples beside the binaries.
pub fn example(name: &str) -> PathBuf {
    Path::new(TECTUM).parent().unwrap().join("examples").join(name)
}

/// A fresh folder in which a test starts programs. Each run that is started in it has an iceoryx2 domain of its own.
pub struct TestFolder {
    folder: TempDir,
}

impl TestFolder {
    pub fn new() -> Self {
        Self { folder: tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap() }
    }

    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Writes a file into the folder and returns its path.
    pub fn write_file(&self, name: &str, text: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path().join(name);
        fs::write(&path, text).unwrap();
        path
    }

    /// Writes a copy of `scenarios/paper.toml` with other values for some keys, and returns its path. The paper's
    /// rule is quick. Of a key that occurs several times, the first occurrence is changed.
    #[track_caller]
    pub fn arm_scenario(&self, changes: &[(&str, &str)]) -> String {
        self.scenario("paper", changes, "")
    }

    /// Like [`arm_scenario`](Self::arm_scenario) for any shipped scenario, with `more` appended to its text.
    #[track_caller]
    pub fn scenario(&self, name: &str, changes: &[(&str, &str)], more: &str) -> String {
        let text = fs::read_to_string(format!("scenarios/{name}.toml")).unwrap() + more;
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        for (key, value) in changes {
            let line = lines.iter_mut().find(|line| line.split(" = ").next() == Some(key));
            *line.unwrap_or_else(|| panic!("no key {key}")) = format!("{key} = {value}");
        }
        self.write_file("scenario.toml", lines.join("\n")).to_str().unwrap().to_owned()
    }

    /// A scenario like that of [`arm_scenario`](Self::arm_scenario), with a period of 5 ms, that does not end within a
    /// test. A run checks before it starts that there is disk space for its whole log. So this log is thinned where
    /// ticks are quick, and a machine that is short of disk space can still run the tests.
    pub fn endless_scenario(&self, mode: &str) -> String {
        let (ticks, every) = if mode == "lockstep" { ("10_000_000", "20") } else { ("500_000", "1") };
        self.arm_scenario(&[("ticks", ticks), ("every", every), ("period_ms", "5")])
    }

    /// Starts `tectum run` in this folder; the run's own folder is `run`.
    pub fn run(&self, arguments: &[&str]) -> Process {
        let mut all = vec!["run", "--out", "run"];
        all.extend(arguments);
        self.start(TECTUM, &all)
    }

    /// Starts a subcommand of `tectum` in this folder and waits for its end.
    pub fn tectum(&self, command: &str, arguments: &[&str]) -> ProcessOutcome {
        let mut all = vec![command];
        all.extend(arguments);
        self.start(TECTUM, &all).wait()
    }

    /// Starts a subcommand of `tectum` that must refuse its input, and returns the message.
    #[track_caller]
    pub fn refused(&self, command: &str, arguments: &[&str]) -> String {
        self.tectum(command, arguments).refusal()
    }

    /// The folder of the run that [`run`](Self::run) starts.
    pub fn run_folder(&self) -> PathBuf {
        self.path().join("run")
    }

    /// The first segment of that run's log.
    pub fn log_path(&self) -> PathBuf {
        self.run_folder().join("log.mcap")
    }

    /// Starts any program in this folder.
    pub fn start(&self, program: impl AsRef<Path>, arguments: &[&str]) -> Process {
        let child = Command::new(program.as_ref())
            .args(arguments)
            .current_dir(self.path())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .process_group(0)
            .spawn()
            .unwrap_or_else(|e| panic!("{} cannot be started: {e}", program.as_ref().display()));
        Process { child, run_folder: self.run_folder() }
    }
}

/// A started program. It is killed when this is dropped.
pub struct Process {
    child: Child,
    run_folder: PathBuf,
}

/// The exit code and the output of a program.
#[derive(Debug)]
pub struct ProcessOutcome {
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
    /// The standard error of the run's processes.
    pub process_output: String,
}

impl Process {
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Sends a signal to this process alone.
    pub fn signal(&self, signal: &str) {
        signal_process(self.id(), signal);
    }

    /// Waits until `ready` returns true. Panics when the process ends first, or hangs.
    pub fn wait_until(&mut self, what: &str, mut ready: impl FnMut() -> bool) {
        let began = Instant::now();
        while !ready() {
            let ended = self.child.try_wait().unwrap();
            if ended.is_some() || began.elapsed() > WATCHDOG {
                let outcome = self.collect();
                panic!("waiting for {what}, the process ended or hung: {ended:?}\n{outcome:#?}");
            }
            std::thread::yield_now();
            std::thread::park_timeout(Duration::from_millis(1));
        }
    }

    /// Waits until `ready` returns true or the process ends.
    pub fn wait_until_or_end(&mut self, what: &str, mut ready: impl FnMut() -> bool) {
        let mut ended = false;
        let began = Instant::now();
        while !ended && !ready() {
            ended = self.child.try_wait().unwrap().is_some();
            if began.elapsed() > WATCHDOG {
                let outcome = self.collect();
                panic!("waiting for {what}, the process hung\n{outcome:#?}");
            }
            std::thread::park_timeout(Duration::from_micros(200));
        }
    }

    /// Waits until the run's log contains messages, which means that ticks run.
    pub fn wait_until_ticking(&mut self) {
        let log = self.run_folder.join("log.mcap");
        self.wait_until("ticks in the log", || fs::metadata(&log).is_ok_and(|m| m.len() > 40_000));
    }

    /// Waits until the run has started `program`, and returns its process id.
    pub fn child_pid(&mut self, program: &str) -> u32 {
        self.wait_for_child(program, program, None)
    }

    /// Waits until the run has started `program` once more, and returns the new process id. Process `previous` does not
    /// count.
    pub fn next_child_pid(&mut self, program: &str, previous: u32) -> u32 {
        self.wait_for_child("the process, or its successor", program, Some(previous))
    }

    fn wait_for_child(&mut self, what: &str, program: &str, except: Option<u32>) -> u32 {
        let parent = self.id();
        let mut found = None;
        self.wait_until(what, || {
            let child = children(parent).into_iter().find(|(pid, name)| name == program && Some(*pid) != except);
            found = child.map(|(pid, _)| pid);
            found.is_some()
        });
        found.unwrap()
    }

    /// Waits for the end of the program.
    pub fn wait(mut self) -> ProcessOutcome {
        let began = Instant::now();
        // The pipes are read during the wait, so that they do not fill up.
        let (stdout, stderr) = (self.child.stdout.take(), self.child.stderr.take());
        let read = |pipe: Option<Box<dyn std::io::Read + Send>>| {
            std::thread::spawn(move || {
                let mut bytes = Vec::new();
                let _ = pipe.map(|mut p| p.read_to_end(&mut bytes));
                String::from_utf8_lossy(&bytes).into_owned()
            })
        };
        let stdout = read(stdout.map(|p| Box::new(p) as _));
        let stderr = read(stderr.map(|p| Box::new(p) as _));
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                let (stdout, stderr) = (stdout.join().unwrap(), stderr.join().unwrap());
                return ProcessOutcome { code: status.code(), stdout, stderr, process_output: self.process_output() };
            }
            if began.elapsed() > WATCHDOG {
                let process_output = self.process_output();
                self.kill();
                panic!(
                    "hangs for {WATCHDOG:?}\nstdout: {}\nstderr: {}\n{process_output}",
                    stdout.join().unwrap(),
                    stderr.join().unwrap()
                );
            }
            std::thread::park_timeout(Duration::from_millis(2));
        }
    }

    fn process_output(&self) -> String {
        let mut output = String::new();
        for role in ["plant", "controller", "logger"] {
            if let Ok(text) = fs::read_to_string(self.run_folder.join(format!("{role}.stderr"))) {
                output += &format!("{role}: {text}\n");
            }
        }
        output
    }

    fn kill(&mut self) {
        for (pid, _) in children(self.id()) {
            signal_process(pid, "KILL");
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// Kills the program and returns its output so far.
    fn collect(&mut self) -> ProcessOutcome {
        let process_output = self.process_output();
        self.kill();
        let mut outcome = ProcessOutcome { code: None, stdout: String::new(), stderr: String::new(), process_output };
        let _ = self.child.stdout.take().map(|mut p| p.read_to_string(&mut outcome.stdout));
        let _ = self.child.stderr.take().map(|mut p| p.read_to_string(&mut outcome.stderr));
        outcome
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if self.child.try_wait().is_ok_and(|status| status.is_none()) {
            self.kill();
        }
    }
}

impl ProcessOutcome {
    /// Requires this exit code; otherwise panics with the complete output.
    #[track_caller]
    pub fn expect(self, code: i32) -> Self {
        assert_eq!(self.code, Some(code), "{self:#?}");
        self
    }

    /// The JSON object on standard output.
    #[track_caller]
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.stdout).unwrap_or_else(|e| panic!("{e}\n{self:#?}"))
    }

    /// Requires that the input was refused: exit code 2, nothing on standard output, and a message of one line, which
    /// is returned.
    #[track_caller]
    pub fn refusal(self) -> String {
        let outcome = self.expect(2);
        assert_eq!((outcome.stderr.lines().count(), outcome.stdout.as_str()), (1, ""), "{outcome:#?}");
        outcome.stderr.trim().to_owned()
    }
}

/// Sends a signal to a process.
pub fn signal_process(pid: u32, signal: &str) {
    // An error is ignored: most callers do not mind when the process has ended already.
    let _ = Command::new("kill").args([format!("-{signal}"), pid.to_string()]).stderr(Stdio::null()).status();
}

/// Stops a process for this long.
pub fn stop_process_for(pid: u32, duration: Duration) {
    signal_process(pid, "STOP");
    std::thread::sleep(duration);
    signal_process(pid, "CONT");
}

/// Whether a process has ended. Its parent may not have collected it yet.
pub fn has_ended(pid: u32) -> bool {
    fs::read_to_string(format!("/proc/{pid}/stat")).map_or(true, |stat| stat.contains(") Z "))
}

/// Process ids and names of the children of `parent`.
pub fn children(parent: u32) -> Vec<(u32, String)> {
    let mut children = Vec::new();
    for entry in fs::read_dir("/proc").unwrap().flatten() {
        let Some(pid) = entry.file_name().to_str().and_then(|name| name.parse().ok()) else { continue };
        let Ok(stat) = fs::read_to_string(entry.path().join("stat")) else { continue };
        // The format is: pid (name) state parent ...
        let Some((_, rest)) = stat.rsplit_once(") ") else { continue };
        if rest.split(' ').nth(1) != Some(&parent.to_string()) {
            continue;
        }
        let Ok(command) = fs::read_to_string(entry.path().join("cmdline")) else { continue };
        let program = Path::new(command.split('\0').next().unwrap_or_default());
        let name = program.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        children.push((pid, name));
    }
    children
}

/// Reads a JSON file.
#[track_caller]
pub fn read_json(path: impl AsRef<Path>) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

/// Appends text to a file.
#[track_caller]
pub fn append(path: impl AsRef<Path>, more: &str) {
    let text = fs::read_to_string(&path).unwrap() + more;
    fs::write(path, text).unwrap();
}

/// The prefix of everything that the run in `folder` has in shared memory.
#[track_caller]
pub fn domain(folder: &Path) -> String {
    format!("tectum_{}", read_json(folder.join("run.json"))["domain"].as_str().unwrap())
}

/// The names of files and folders in shared memory that begin with `prefix`.
pub fn shared_memory(prefix: &str) -> Vec<String> {
    let names = fs::read_dir("/dev/shm").unwrap().flatten().map(|e| e.file_name().to_string_lossy().into_owned());
    names.filter(|name| name.starts_with(prefix)).collect()
}

/// Requires that nothing of the run in `folder` is left in shared memory.
#[track_caller]
pub fn assert_no_debris(folder: &Path) {
    let left = shared_memory(&domain(folder));
    assert!(left.is_empty(), "left in /dev/shm: {left:?}");
}
