//! A fresh folder in which a test starts programs.

use std::fs;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use serde_json::Value;
use tectum::clock::let_children_hear_hangup;
use tectum::log::LogError;
use tempfile::TempDir;

use crate::programs::target_folder;
use crate::{LogContent, Process, ProcessOutcome, ScenarioFile, assert_no_debris, program};

/// A process that takes longer than this is considered to hang, unless the test sets another limit. It is far beyond
/// any stall of a busy machine.
pub const WATCHDOG: Duration = Duration::from_secs(120);

/// The environment variable that keeps the folders of tests: set it to look at the logs of a test that failed.
pub const KEEP_VARIABLE: &str = "TECTUM_KEEP";

/// A fresh folder in which a test starts programs. It is removed when this value is dropped, unless the environment
/// has [`TECTUM_KEEP`](KEEP_VARIABLE). Each run that is started in it has an iceoryx2 domain of its own, so that tests
/// run in parallel.
#[derive(Debug)]
pub struct TestFolder {
    folder: TempDir,
    watchdog: Duration,
}

impl Default for TestFolder {
    fn default() -> Self {
        Self::new()
    }
}

impl TestFolder {
    /// Makes a folder in cargo's target folder, or in the system's folder for temporary files if there is none.
    ///
    /// # Panics
    ///
    /// If it cannot be made.
    #[track_caller]
    pub fn new() -> Self {
        let_children_hear_hangup();
        let parent = target_folder().map_or_else(std::env::temp_dir, |target| target.join("tmp"));
        let made = fs::create_dir_all(&parent).and_then(|()| tempfile::tempdir_in(&parent));
        let mut folder = made.unwrap_or_else(|error| panic!("no folder can be made in {}: {error}", parent.display()));
        if std::env::var_os(KEEP_VARIABLE).is_some() {
            folder.disable_cleanup(true);
            eprintln!("{KEEP_VARIABLE} is set: {} is kept", folder.path().display());
        }
        Self { folder, watchdog: WATCHDOG }
    }

    /// The same folder, whose programs may take this long instead of [`WATCHDOG`].
    #[must_use]
    pub fn with_watchdog(self, watchdog: Duration) -> Self {
        Self { watchdog, ..self }
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Writes a file into the folder and returns its path.
    ///
    /// # Panics
    ///
    /// If it cannot be written.
    #[track_caller]
    pub fn write_file(&self, name: &str, text: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path().join(name);
        fs::write(&path, text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        path
    }

    /// Writes `scenario.toml` into the folder and returns its path, as an argument of [`run`](Self::run).
    ///
    /// # Panics
    ///
    /// If it cannot be written.
    #[track_caller]
    pub fn write_scenario(&self, scenario: &ScenarioFile) -> String {
        self.write_file("scenario.toml", scenario.to_toml()).to_string_lossy().into_owned()
    }

    /// Starts `tectum run` in this folder with these arguments. The run's own folder is
    /// [`run_folder`](Self::run_folder).
    ///
    /// # Panics
    ///
    /// If `tectum` is not found ([`program`]).
    #[track_caller]
    pub fn run(&self, arguments: &[&str]) -> Process {
        self.start(program("tectum"), &[&["run", "--out", "run"], arguments].concat())
    }

    /// Starts a subcommand of `tectum` in this folder and waits for its end.
    ///
    /// # Panics
    ///
    /// If `tectum` is not found, or hangs.
    #[track_caller]
    pub fn tectum(&self, command: &str, arguments: &[&str]) -> ProcessOutcome {
        self.start(program("tectum"), &[&[command], arguments].concat()).wait()
    }

    /// Starts any program in this folder.
    ///
    /// # Panics
    ///
    /// If it cannot be started.
    #[track_caller]
    pub fn start(&self, program: impl AsRef<Path>, arguments: &[&str]) -> Process {
        let mut command = Command::new(program.as_ref());
        command.args(arguments);
        self.start_command(command)
    }

    /// Starts a command that has settings of its own, such as its environment. It runs in this folder unless it names
    /// another, without standard input; its output is collected.
    ///
    /// # Panics
    ///
    /// If it cannot be started.
    #[track_caller]
    pub fn start_command(&self, mut command: Command) -> Process {
        // In a process group of its own, Ctrl-C at the terminal does not reach it before the test.
        command.process_group(0);
        if command.get_current_dir().is_none() {
            command.current_dir(self.path());
        }
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let child = command.spawn();
        let child =
            child.unwrap_or_else(|e| panic!("{} cannot be started: {e}", command.get_program().to_string_lossy()));
        Process::new(child, self.run_folder(), self.watchdog)
    }

    /// The folder of the run that [`run`](Self::run) starts.
    pub fn run_folder(&self) -> PathBuf {
        self.path().join("run")
    }

    /// The first segment of that run's log.
    pub fn log_path(&self) -> PathBuf {
        self.run_folder().join("log.mcap")
    }

    /// Reads that run's log, all of its segments.
    ///
    /// # Errors
    ///
    /// As [`LogContent::read`].
    pub fn log(&self) -> Result<LogContent, LogError> {
        LogContent::read(self.run_folder())
    }

    /// Requires that nothing of that run is left in shared memory.
    ///
    /// # Panics
    ///
    /// As [`assert_no_debris`].
    #[track_caller]
    pub fn assert_no_debris(&self) {
        assert_no_debris(self.run_folder());
    }
}

/// Reads a JSON file.
///
/// # Panics
///
/// If it cannot be read, or is not JSON.
#[track_caller]
pub fn read_json(path: impl AsRef<Path>) -> Value {
    let path = path.as_ref();
    let text = fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    serde_json::from_str(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}
