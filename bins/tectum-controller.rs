//! The controller process: encoder, policy and learner.

use std::process::ExitCode;

use tectum::process;
use tectum::runtime::run_shipped_controller;
use tectum::wire::Role;

fn main() -> ExitCode {
    process::main(
        Role::Controller,
        "Answers a plant's observations with commands, and learns while it does",
        |participant| run_shipped_controller(participant, process::shipped_agent),
    )
}
