//! A `tectum-servo-emulator` that is told what to do on standard input and says all as JSON lines.

use std::io::{BufRead as _, BufReader, Write as _};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use serde_json::Value;

use crate::support::Place;

pub const EMULATOR: &str = env!("CARGO_BIN_EXE_tectum-servo-emulator");

/// A running emulator; dropped, it is killed.
pub struct Emulator {
    pub child: Child,
    pub commands: Option<ChildStdin>,
    pub lines: BufReader<ChildStdout>,
}

impl Emulator {
    /// Starts one in `place`.
    pub fn start(place: &Place, arguments: &[&str]) -> Self {
        let mut child = Command::new(EMULATOR)
            .args(["--json", "--control"])
            .args(arguments)
            .current_dir(place.path())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let commands = child.stdin.take();
        let lines = BufReader::new(child.stdout.take().unwrap());
        Self { child, commands, lines }
    }

    /// The next line that it says.
    pub fn line(&mut self) -> Value {
        let mut text = String::new();
        self.lines.read_line(&mut text).unwrap();
        serde_json::from_str(&text).unwrap_or_else(|e| panic!("{e}: {text:?}"))
    }

    /// Tells it something.
    pub fn say(&mut self, command: &str) {
        writeln!(self.commands.as_mut().unwrap(), "{command}").unwrap();
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
