//! The simulator process: the plant of a run, simulated as the scenario describes (arm or eye).

use std::process::ExitCode;

use tectum::runtime::run_simulator;
use tectum::wire::Role;

fn main() -> ExitCode {
    tectum::process::main(Role::Plant, "Simulates the plant that a run's scenario describes", run_simulator)
}
