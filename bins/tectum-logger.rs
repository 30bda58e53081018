//! The logger process: everything that the others send, in one MCAP file.

use std::process::ExitCode;

use tectum::runtime::run_logger;
use tectum::wire::Role;

fn main() -> ExitCode {
    tectum::process::main(Role::Logger, "Writes everything that a run's processes send into its log", run_logger)
}
