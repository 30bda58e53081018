//! The simulator process: the scenario's arm or eye in the plant's place.

use std::process::ExitCode;

use tectum::plant::Body;
use tectum::runtime::{RuntimeError, run_plant};
use tectum::wire::Role;

fn main() -> ExitCode {
    tectum::process::main(Role::Plant, "Simulates the plant that a run's scenario describes", |seat| {
        let body =
            Body::of(&seat.plan).ok_or_else(|| RuntimeError::NotSimulated(seat.plan.scenario.plant.program.clone()))?;
        run_plant(seat, body)
    })
}
