//! The simulator process: the plant of a run, simulated as the scenario describes (arm or eye).

use std::process::ExitCode;

use tectum::runtime::{RuntimeError, run_plant};
use tectum::wire::Role;

fn main() -> ExitCode {
    tectum::process::main(Role::Plant, "Simulates the plant that a run's scenario describes", |participant| {
        let body = participant
            .plan
            .simulated_plant()
            .ok_or_else(|| RuntimeError::NotSimulated(participant.plan.scenario.plant.program.clone()))?;
        run_plant(participant, body)
    })
}
