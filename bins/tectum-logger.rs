//! The logger process: writes every sample of a run into one MCAP file.

use std::process::ExitCode;

use tectum::runtime::run_logger;
use tectum::wire::Role;

fn main() -> ExitCode {
    tectum::process::main(Role::Logger, "Writes every sample of a run into its log", run_logger)
}
