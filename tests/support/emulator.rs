//! A `tectum-servo-emulator` that takes commands on standard input and reports in JSON lines.

use std::io::{BufRead as _, BufReader, Write as _};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use serde_json::Value;

use crate::support::TestFolder;

pub const EMULATOR: &str = env!("CARGO_BIN_EXE_tectum-servo-emulator");

/// A running emulator. It is killed when this is dropped.
pub struct Emulator {
    pub child: Child,
    pub commands: Option<ChildStdin>,
    pub output: BufReader<ChildStdout>,
}

impl Emulator {
    /// Starts an emulator in a test folder.
    pub fn start(test_folder: &TestFolder, arguments: &[&str]) -> Self {
        let mut child = Command::new(EMULATOR)
            .args(["--json", "--control"])
            .args(arguments)
            .current_dir(test_folder.path())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let commands = child.stdin.take();
        let output = BufReader::new(child.stdout.take().unwrap());
        Self { child, commands, output }
    }

    /// Waits for the next report.
    pub fn next_report(&mut self) -> Value {
        let mut text = String::new();
        self.output.read_line(&mut text).unwrap();
        serde_json::from_str(&text).unwrap_or_else(|e| panic!("{e}: {text:?}"))
    }

    /// Sends a command to the emulator.
    pub fn send_command(&mut self, command: &str) {
        writeln!(self.commands.as_mut().unwrap(), "{command}").unwrap();
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
