//! The `main` function of every program that joins a run: arguments, error messages and exit codes. The
//! programs in `bins/`, and the program of your own plant, consist of this function and a loop of [`runtime`].
//!
//! [`runtime`]: crate::runtime
//!
//! ```no_run
//! use std::process::ExitCode;
//! use tectum::{process, runtime::run_controller, wire::Role};
//!
//! fn main() -> ExitCode {
//!     process::main(Role::Controller, "Runs the controller of a run", run_controller)
//! }
//! ```

use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{CommandFactory as _, FromArgMatches as _, Parser};
use serde::Serialize;

use crate::runtime::{Participant, RuntimeError};
use crate::wire::Role;

/// The command line of every process of a run.
#[derive(Debug, Parser)]
#[command(version = crate::BUILD)]
struct Arguments {
    /// The run to join: its folder, or its name under runs/
    #[arg(long, value_name = "RUN")]
    run: PathBuf,
    /// Read this scenario instead of the run's own copy; it must be the same
    #[arg(long, value_name = "FILE")]
    scenario: Option<PathBuf>,
    /// Print the process's report as one JSON object when its loop has ended
    #[arg(long)]
    json: bool,
}

/// Runs one process of a run: parses the command line, joins the run as `role`, and calls `work`. `about` is
/// one sentence for `--help`. On an error, prints it and returns its exit code ([`RuntimeError::exit_code`]).
pub fn main<R: Serialize>(
    role: Role,
    about: &'static str,
    work: impl FnOnce(Participant) -> Result<R, RuntimeError>,
) -> ExitCode {
    let example = format!(
        "A run's launcher starts this program by itself. To start it in a terminal of its own:\n  \
         tectum run --name demo --by-hand {role}\n  {program} --run demo",
        role = role.name(),
        program = program(),
    );
    let command = Arguments::command().name(program()).about(about).after_help(example);
    let matches = command.get_matches();
    let arguments = match Arguments::from_arg_matches(&matches) {
        Ok(arguments) => arguments,
        Err(error) => error.exit(),
    };
    let result = Participant::take(&arguments.run, role, arguments.scenario.as_deref()).and_then(work);
    match result {
        Ok(report) => {
            if arguments.json {
                let text = serde_json::to_string(&report).unwrap_or_default();
                let _ = writeln!(std::io::stdout(), "{text}");
            }
            ExitCode::SUCCESS
        }
        Err(error) => {
            print_error_line(&format!("{}: {error}", program()));
            ExitCode::from(error.exit_code())
        }
    }
}

/// Writes a line to standard error. Unlike `eprintln!`, it does not panic when standard error cannot be written
/// (the disk is full, the reader of a pipe has closed it), so that the process still ends with its exit code.
pub fn print_error_line(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// The name under which the program was started.
fn program() -> String {
    let path = std::env::args_os().next().map(PathBuf::from).unwrap_or_default();
    path.file_name().map_or_else(|| "tectum".to_owned(), |name| name.to_string_lossy().into_owned())
}
