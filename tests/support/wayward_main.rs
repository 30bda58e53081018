//! The plant of `tests/warnings.rs` as a program.

mod wayward;

use std::process::ExitCode;

use tectum::runtime::run_plant;
use tectum::wire::Role;

fn main() -> ExitCode {
    tectum::process::main(Role::Plant, "A plant for tests, which does something wrong", |participant| {
        let plant = wayward::Wayward::of(&participant.plan);
        run_plant(participant, plant)
    })
}
