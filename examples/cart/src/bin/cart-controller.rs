//! The controller's process.

use std::process::ExitCode;

use cart::ProportionalDerivative;
use tectum::runtime::run_controller;
use tectum::wire::Role;

fn main() -> ExitCode {
    tectum::process::main(Role::Controller, "Pushes a cart to its target", |participant| {
        run_controller(participant, |plan| {
            ProportionalDerivative::new((plan.scenario.period_ms / 1000.0) as f32)
        })
    })
}
