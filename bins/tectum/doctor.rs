//! `tectum doctor`: checks whether this machine is fit for real time.

use std::io::IsTerminal as _;
use std::path::Path;
use std::process::ExitCode;

use clap::Args;
use tectum::doctor::{Verdict, examine};
use tectum::process::print_error_line;
use tectum::runtime::exit;

use super::print;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  tectum doctor                 checks everything, and measures wake-up lateness for ten seconds
  tectum doctor --seconds 0     without measuring
  tectum doctor --clean         also removes what killed runs have left in shared memory

The exit code is 0 when nothing is a problem, and 1 otherwise.")]
pub struct Arguments {
    /// Remove from shared memory what belongs to no living run
    #[arg(long)]
    clean: bool,
    /// For how long wake-up lateness is measured; 0 leaves it out
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(0..=3600))]
    seconds: u32,
    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

pub fn main(arguments: &Arguments) -> ExitCode {
    if arguments.seconds > 0 && std::io::stderr().is_terminal() {
        print_error_line(&format!("measuring wake-up lateness for {} s", arguments.seconds));
    }
    // The default folder of runs, whose disk must have room.
    let runs = Path::new("runs");
    let folder = if runs.is_dir() { runs } else { Path::new(".") };
    let found = examine(arguments.clean, arguments.seconds, folder);
    let printed = print(&if arguments.json { found.to_json() + "\n" } else { found.to_text() });
    if found.verdict == Verdict::Problem { ExitCode::from(exit::ERROR) } else { printed }
}
