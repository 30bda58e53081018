//! The guard: a process that waits for the end of a bridge and then turns torque off.
//!
//! A program cannot react to SIGKILL. Dynamixel's bus watchdog then stops the motors after 200 ms, with torque
//! still on; Feetech has no watchdog. The bridge therefore starts this process, which opens the port when the
//! bridge has ended. If a restarted bridge has opened the port first, the guard does nothing: the bridge turns
//! torque off before anything else.

use std::process::{Command, ExitCode};

use tectum::clock::{ProcessHandle, TerminationSignals, monotonic_ns};
use tectum::servo::bus::{Bus, BusBudget};
use tectum::servo::model::Protocol;

/// Arguments of the guard.
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

/// The command that starts this program as the guard of the current process.
pub fn command(port: &str, protocol: Protocol, baud: u32, ids: &[u8]) -> Command {
    let ids: Vec<_> = ids.iter().map(u8::to_string).collect();
    let mut command = Command::new(std::env::current_exe().unwrap_or_else(|_| "tectum-bridge".into()));
    command.args(["guard", "--parent", &std::process::id().to_string(), "--port", port, "--protocol", protocol.name()]);
    command.args(["--baud", &baud.to_string(), "--ids", &ids.join(",")]);
    command
}

/// Waits for the bridge's end, then turns torque off.
pub fn run(arguments: &Arguments) -> ExitCode {
    // Signals are received and ignored: a signal that ends the bridge must not end the guard.
    let _signals = TerminationSignals::install();
    while let Some(parent) = ProcessHandle::of(arguments.parent).filter(|parent| !parent.ended()) {
        ProcessHandle::await_any(std::iter::once(&parent), 60_000_000_000);
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
