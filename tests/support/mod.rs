//! Shared by all tests that start real processes: the real binaries, a fresh folder, a watchdog.
//!
//! Every run makes its own iceoryx2 domain, so tests run in parallel. Nothing here sleeps to let something happen: waits
//! look for the thing itself, and the watchdog's limit is far beyond any stall of a busy machine. When a test fails, it
//! prints what the processes themselves said.

#![allow(dead_code)] // Each test binary uses its own part.

pub mod bytes;
pub mod content;
pub mod slow;

use std::fs;
use std::io::Read as _;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use tempfile::TempDir;

/// A run that takes longer hangs.
pub const WATCHDOG: Duration = Duration::from_secs(120);

/// The `tectum` under test.
pub const TECTUM: &str = env!("CARGO_BIN_EXE_tectum");

/// One of the example programs, which cargo builds beside the binaries.
pub fn example(name: &str) -> PathBuf {
    Path::new(TECTUM).parent().unwrap().join("examples").join(name)
}

/// A fresh folder to start programs in.
pub struct Place {
    folder: TempDir,
}

impl Place {
    pub fn new() -> Self {
        Self { folder: tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap() }
    }

    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Writes a file into the folder and gives its path.
    pub fn file(&self, name: &str, text: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path().join(name);
        fs::write(&path, text).unwrap();
        path
    }

    /// The arm under the paper's rule, which is quick: a copy of `scenarios/paper.toml` with other values for some keys; gives
    /// its path. A key is changed where it stands first.
    #[track_caller]
    pub fn arm(&self, changes: &[(&str, &str)]) -> String {
        let mut lines: Vec<String> =
            fs::read_to_string("scenarios/paper.toml").unwrap().lines().map(str::to_owned).collect();
        for (key, value) in changes {
            let line = lines.iter_mut().find(|line| line.split(" = ").next() == Some(key));
            *line.unwrap_or_else(|| panic!("no key {key}")) = format!("{key} = {value}");
        }
        self.file("scenario.toml", lines.join("\n")).to_str().unwrap().to_owned()
    }

    /// A scenario as [`arm`](Self::arm), of a period of 5 ms, that comes to no end within a test. A run looks for room for its whole log
    /// before it starts, so that this one is thinned where ticks are quick: a machine that is short of disk can test, too.
    pub fn endless(&self, mode: &str) -> String {
        let (ticks, every) = if mode == "lockstep" { ("10_000_000", "20") } else { ("500_000", "1") };
        self.arm(&[("ticks", ticks), ("every", every), ("period_ms", "5")])
    }

    /// A `tectum run` in this folder, whose own folder will be `run`.
    pub fn run(&self, arguments: &[&str]) -> Process {
        let mut all = vec!["run", "--out", "run"];
        all.extend(arguments);
        self.start(TECTUM, &all)
    }

    /// Where `run`'s files lie.
    pub fn run_folder(&self) -> PathBuf {
        self.path().join("run")
    }

    /// Starts any program here.
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
        Process { child, folder: self.run_folder(), said: String::new() }
    }
}

/// A program under watch. One that is dropped is killed first.
pub struct Process {
    child: Child,
    folder: PathBuf,
    said: String,
}

/// How a program ended.
#[derive(Debug)]
pub struct Outcome {
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
    /// What a process of the run that failed wrote to its standard error.
    pub said: String,
}

impl Process {
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Sends a signal to this process alone.
    pub fn signal(&self, signal: &str) {
        signal_process(self.id(), signal);
    }

    /// Waits for `ready`, which looks for the thing itself.
    pub fn until(&mut self, what: &str, mut ready: impl FnMut() -> bool) {
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

    /// Waits for `ready`, or for the end of the process if that comes first.
    pub fn until_over(&mut self, what: &str, mut ready: impl FnMut() -> bool) {
        let mut over = false;
        let began = Instant::now();
        while !over && !ready() {
            over = self.child.try_wait().unwrap().is_some();
            if began.elapsed() > WATCHDOG {
                let outcome = self.collect();
                panic!("waiting for {what}, the process hung\n{outcome:#?}");
            }
            std::thread::park_timeout(Duration::from_micros(200));
        }
    }

    /// Waits until the run's log has messages in it, which is when ticks run.
    pub fn until_ticking(&mut self) {
        let log = self.folder.join("log.mcap");
        self.until("ticks in the log", || fs::metadata(&log).is_ok_and(|m| m.len() > 40_000));
    }

    /// The process id of one of the run's processes.
    pub fn member(&mut self, program: &str) -> u32 {
        let parent = self.id();
        let mut found = None;
        self.until(program, || {
            found = children(parent).into_iter().find(|(_, name)| name == program).map(|(pid, _)| pid);
            found.is_some()
        });
        found.unwrap()
    }

    /// Waits for the end.
    pub fn wait(mut self) -> Outcome {
        let began = Instant::now();
        // Read while waiting, so that no pipe fills up.
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
                return Outcome { code: status.code(), stdout, stderr, said: self.said() };
            }
            if began.elapsed() > WATCHDOG {
                let said = self.said();
                self.kill();
                panic!(
                    "hangs for {WATCHDOG:?}\nstdout: {}\nstderr: {}\n{said}",
                    stdout.join().unwrap(),
                    stderr.join().unwrap()
                );
            }
            std::thread::park_timeout(Duration::from_millis(2));
        }
    }

    fn said(&self) -> String {
        let mut said = String::new();
        for role in ["plant", "controller", "logger"] {
            if let Ok(text) = fs::read_to_string(self.folder.join(format!("{role}.stderr"))) {
                said += &format!("{role}: {text}\n");
            }
        }
        said
    }

    fn kill(&mut self) {
        for (pid, _) in children(self.id()) {
            signal_process(pid, "KILL");
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    fn collect(&mut self) -> Outcome {
        let said = self.said();
        self.kill();
        let mut outcome = Outcome { code: None, stdout: String::new(), stderr: String::new(), said };
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

impl Outcome {
    /// The end that is expected; otherwise everything that was said.
    #[track_caller]
    pub fn expect(self, code: i32) -> Self {
        assert_eq!(self.code, Some(code), "{self:#?}");
        self
    }

    /// The one JSON object on standard output.
    #[track_caller]
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.stdout).unwrap_or_else(|e| panic!("{e}\n{self:#?}"))
    }
}

pub fn signal_process(pid: u32, signal: &str) {
    // A process that is gone already is what most callers want.
    let _ = Command::new("kill").args([format!("-{signal}"), pid.to_string()]).stderr(Stdio::null()).status();
}

/// Process ids and names of the children of `parent`.
pub fn children(parent: u32) -> Vec<(u32, String)> {
    let mut children = Vec::new();
    for entry in fs::read_dir("/proc").unwrap().flatten() {
        let Some(pid) = entry.file_name().to_str().and_then(|name| name.parse().ok()) else { continue };
        let Ok(stat) = fs::read_to_string(entry.path().join("stat")) else { continue };
        // pid (name) state parent ...
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

/// Nothing of the run in `folder` may be left in shared memory.
#[track_caller]
pub fn assert_no_debris(folder: &Path) {
    let text = fs::read_to_string(folder.join("run.json")).unwrap();
    let manifest: Value = serde_json::from_str(&text).unwrap();
    let domain = format!("tectum_{}", manifest["domain"].as_str().unwrap());
    let left: Vec<_> = fs::read_dir("/dev/shm")
        .unwrap()
        .flatten()
        .map(|e| e.file_name().to_string_lossy().into_owned())
        .filter(|name| name.starts_with(&domain))
        .collect();
    assert!(left.is_empty(), "left in /dev/shm: {left:?}");
}
