//! What is left of a bridge that was killed: a process that waits for its end and then turns torque off.
//!
//! A SIGKILL leaves a program no last word. Dynamixel's bus watchdog then stops the motors after 200 ms, with
//! torque still on; Feetech has none. So the bridge starts this, which takes the port when the bridge is dead.
//! A successor that has the port by then keeps it: it turns torque off by itself before it does anything else.

use std::process::{Command, ExitCode};

use tectum::clock::{ProcessHandle, TerminationSignals, monotonic_ns};
use tectum::servo::bus::{Bus, BusBudget};
use tectum::servo::model::Protocol;

/// What the guard is told.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The bridge's process id
    #[arg(long)]
    parent: u32,
    #[arg(long)]
    port: String,
    #[arg(long, value_parser = Protocol::NAMES)]
    protocol: String,
    #[arg(long)]
    baud: u32,
    #[arg(long, value_delimiter = ',')]
    ids: Vec<u8>,
}

/// This program as the guard of this process.
pub fn command(port: &str, protocol: Protocol, baud: u32, ids: &[u8]) -> Command {
    let ids: Vec<_> = ids.iter().map(u8::to_string).collect();
    let mut command = Command::new(std::env::current_exe().unwrap_or_else(|_| "tectum-bridge".into()));
    command.args(["guard", "--parent", &std::process::id().to_string(), "--port", port, "--protocol", protocol.name()]);
    command.args(["--baud", &baud.to_string(), "--ids", &ids.join(",")]);
    command
}

/// Waits for the bridge's end, then turns torque off.
pub fn run(arguments: &Arguments) -> ExitCode {
    // Taken and never looked at: what ends the bridge must not end its guard.
    let _signals = TerminationSignals::install();
    while let Some(life) = ProcessHandle::of(arguments.parent).filter(|life| !life.ended()) {
        ProcessHandle::await_any(std::iter::once(&life), 60_000_000_000);
    }
    let protocol = Protocol::named(&arguments.protocol);
    let budget = BusBudget { read_ns: 20_000_000, write_ns: 20_000_000 };
    match Bus::open(&arguments.port, protocol, arguments.baud, budget, Box::new(monotonic_ns)) {
        Ok(mut bus) => {
            bus.torque_off(&arguments.ids);
            ExitCode::SUCCESS
        }
        Err(_) => ExitCode::FAILURE,
    }
}
