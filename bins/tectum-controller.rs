//! The controller process: encoder, policy and learner.

use std::process::ExitCode;

use tectum::runtime::run_controller;
use tectum::wire::Role;

fn main() -> ExitCode {
    tectum::process::main(
        Role::Controller,
        "Answers a plant's observations with commands, and learns while it does",
        run_controller,
    )
}
