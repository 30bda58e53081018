//! A program that a test has started, and what it leaves when it has ended.

use std::fs;
use std::io::Read;
use std::path::PathBuf;
use std::process::{Child, Command};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::log_content::newest_tick;
use crate::signals::child_running;
use crate::{WATCHDOG, children, signal_process};

/// How far a run has come when its ticks are certain to run.
const TICKING: u64 = 16;
/// How often a wait looks again.
const POLL: Duration = Duration::from_millis(1);

/// A started program. Its standard output and error are collected while it runs. If it still runs when this value is
/// dropped, it is killed with the processes that it has started.
#[derive(Debug)]
pub struct Process {
    child: Child,
    stdout: Option<JoinHandle<String>>,
    stderr: Option<JoinHandle<String>>,
    run_folder: PathBuf,
    watchdog: Duration,
}

/// The exit code and the output of a program.
#[derive(Debug)]
pub struct ProcessOutcome {
    /// The exit code; `None` when a signal ended the program.
    pub code: Option<i32>,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
    /// What the processes of the run that have failed wrote to their standard error.
    pub process_output: String,
}

/// Reads a pipe to its end in a thread, so that it never fills up and stops the program.
fn collect(pipe: Option<impl Read + Send + 'static>) -> Option<JoinHandle<String>> {
    let mut pipe = pipe?;
    Some(std::thread::spawn(move || {
        let mut bytes = Vec::new();
        let _ = pipe.read_to_end(&mut bytes);
        String::from_utf8_lossy(&bytes).into_owned()
    }))
}

fn collected(reader: Option<JoinHandle<String>>) -> String {
    reader.and_then(|reader| reader.join().ok()).unwrap_or_default()
}

impl Process {
    pub(crate) fn new(mut child: Child, run_folder: PathBuf, watchdog: Duration) -> Self {
        let (stdout, stderr) = (collect(child.stdout.take()), collect(child.stderr.take()));
        Self { child, stdout, stderr, run_folder, watchdog }
    }

    /// Starts a command as it is, for a test that gives it a terminal instead of pipes. `run_folder` is the folder of
    /// the run that it starts, if it starts one.
    ///
    /// # Panics
    ///
    /// If it cannot be started.
    #[track_caller]
    pub fn of_command(mut command: Command, run_folder: PathBuf) -> Self {
        let child = command.spawn();
        let child =
            child.unwrap_or_else(|e| panic!("{} cannot be started: {e}", command.get_program().to_string_lossy()));
        Self::new(child, run_folder, WATCHDOG)
    }

    /// The process id.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Sends a signal to this process alone, as [`signal_process`] does. `"INT"` ends a run in good order.
    #[track_caller]
    pub fn signal(&self, signal: &str) {
        signal_process(self.id(), signal);
    }

    /// Closes the reading ends of standard output and standard error, as a terminal does that goes away.
    pub fn close_output(&mut self) {
        (self.child.stdout, self.child.stderr) = (None, None);
    }

    /// Waits until `ready` returns true.
    ///
    /// # Panics
    ///
    /// When the process ends first, or the watchdog's time is over: with `what` was waited for and all output.
    #[track_caller]
    pub fn wait_until(&mut self, what: &str, mut ready: impl FnMut() -> bool) {
        self.wait_for(what, || ready().then_some(()));
    }

    /// Waits until `ready` returns a value, and returns that.
    ///
    /// # Panics
    ///
    /// As [`wait_until`](Self::wait_until).
    #[track_caller]
    pub fn wait_for<T>(&mut self, what: &str, mut ready: impl FnMut() -> Option<T>) -> T {
        let began = Instant::now();
        loop {
            if let Some(value) = ready() {
                return value;
            }
            // Whoever has ended may have done what is waited for just before.
            if self.has_ended() {
                return ready().unwrap_or_else(|| self.fail(&format!("waiting for {what}, the process ended")));
            }
            if began.elapsed() > self.watchdog {
                self.fail(&format!("waiting for {what}, the process hung for {:?}", self.watchdog));
            }
            std::thread::park_timeout(POLL);
        }
    }

    /// Waits until `ready` returns true or the process ends.
    ///
    /// # Panics
    ///
    /// When the watchdog's time is over.
    #[track_caller]
    pub fn wait_until_or_end(&mut self, what: &str, mut ready: impl FnMut() -> bool) {
        let began = Instant::now();
        while !ready() && !self.has_ended() {
            if began.elapsed() > self.watchdog {
                self.fail(&format!("waiting for {what}, the process hung for {:?}", self.watchdog));
            }
            std::thread::park_timeout(POLL / 5);
        }
    }

    /// Waits until the run's log has reached `tick`.
    ///
    /// # Panics
    ///
    /// As [`wait_until`](Self::wait_until).
    #[track_caller]
    pub fn wait_until_tick(&mut self, tick: u64) {
        let log = self.run_folder.join("log.mcap");
        self.wait_until(&format!("tick {tick} in the log"), || {
            let began = Instant::now();
            let reached = newest_tick(&log).is_some_and(|newest| newest >= tick);
            // A long log takes long to read, and reading must not take the processor from the run.
            std::thread::park_timeout(if reached { Duration::ZERO } else { began.elapsed() });
            reached
        });
    }

    /// Waits until the run's log has some ticks.
    ///
    /// # Panics
    ///
    /// As [`wait_until`](Self::wait_until).
    #[track_caller]
    pub fn wait_until_ticking(&mut self) {
        self.wait_until_tick(TICKING);
    }

    /// Waits until the run has started `program`, and returns its process id. The name is that of the program's file
    /// (`"tectum-controller"`), or of the script that an interpreter runs (`"plant.py"`).
    ///
    /// # Panics
    ///
    /// As [`wait_until`](Self::wait_until).
    #[track_caller]
    pub fn child_pid(&mut self, program: &str) -> u32 {
        let parent = self.id();
        self.wait_for(program, || child_running(parent, program, None))
    }

    /// Waits until the run has started `program` once more, and returns the new process id. Process `previous` does
    /// not count.
    ///
    /// # Panics
    ///
    /// As [`wait_until`](Self::wait_until).
    #[track_caller]
    pub fn next_child_pid(&mut self, program: &str, previous: u32) -> u32 {
        let parent = self.id();
        self.wait_for(&format!("{program} after process {previous}"), || child_running(parent, program, Some(previous)))
    }

    /// Waits until the run has started `program`, kills it (SIGKILL), and returns its process id.
    ///
    /// # Panics
    ///
    /// As [`wait_until`](Self::wait_until).
    #[track_caller]
    pub fn kill_child(&mut self, program: &str) -> u32 {
        let pid = self.child_pid(program);
        signal_process(pid, "KILL");
        pid
    }

    /// Waits for the end of the program.
    ///
    /// # Panics
    ///
    /// When the watchdog's time is over.
    #[track_caller]
    pub fn wait(mut self) -> ProcessOutcome {
        let began = Instant::now();
        while !self.has_ended() {
            if began.elapsed() > self.watchdog {
                self.fail(&format!("the process hangs for {:?}", self.watchdog));
            }
            std::thread::park_timeout(2 * POLL);
        }
        let code = self.child.wait().ok().and_then(|status| status.code());
        self.outcome(code)
    }

    fn has_ended(&mut self) -> bool {
        !matches!(self.child.try_wait(), Ok(None))
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

    /// All output. The program has ended.
    fn outcome(&mut self, code: Option<i32>) -> ProcessOutcome {
        ProcessOutcome {
            code,
            stdout: collected(self.stdout.take()),
            stderr: collected(self.stderr.take()),
            process_output: self.process_output(),
        }
    }

    /// Kills the program and the processes that it has started.
    fn kill(&mut self) {
        // A launcher that is stopped starts no successor of a killed process.
        self.signal("STOP");
        let children = children(self.id());
        let _ = self.child.kill();
        for (pid, _) in children {
            signal_process(pid, "KILL");
        }
        let _ = self.child.wait();
    }

    /// Kills the program and panics with its output.
    #[track_caller]
    fn fail(&mut self, why: &str) -> ! {
        let code = self.child.try_wait().ok().flatten().and_then(|status| status.code());
        self.kill();
        panic!("{why}\n{:#?}", self.outcome(code));
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if !self.has_ended() {
            self.kill();
        }
    }
}

impl ProcessOutcome {
    /// Requires this exit code.
    ///
    /// # Panics
    ///
    /// With the complete output if the code is another one.
    #[track_caller]
    pub fn expect(self, code: i32) -> Self {
        assert_eq!(self.code, Some(code), "{self:#?}");
        self
    }

    /// The JSON object on standard output.
    ///
    /// # Panics
    ///
    /// If there is none.
    #[track_caller]
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.stdout).unwrap_or_else(|error| panic!("{error}\n{self:#?}"))
    }

    /// Requires that the input was refused: exit code 2, nothing on standard output, and a message of one line, which
    /// is returned.
    ///
    /// # Panics
    ///
    /// With the complete output otherwise.
    #[track_caller]
    pub fn refusal(self) -> String {
        let outcome = self.expect(2);
        assert_eq!((outcome.stderr.lines().count(), outcome.stdout.as_str()), (1, ""), "{outcome:#?}");
        outcome.stderr.trim().to_owned()
    }
}
