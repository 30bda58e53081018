//! The command line of the guard, which turns torque off when another process has died or fallen silent.

use std::process::{Command, ExitCode};

use tectum::servo::guard::{Guard, GuardSettings, watch};
use tectum::servo::model::Protocol;

/// Arguments of the guard.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Id of the process to watch
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
    /// Period of heartbeats, ns
    #[arg(long)]
    period_ns: u64,
}

/// Starts this program as the guard of the current process.
///
/// # Errors
/// When it cannot be started.
pub fn start(settings: &GuardSettings) -> Result<Guard, String> {
    let ids: Vec<_> = settings.ids.iter().map(u8::to_string).collect();
    let mut command = Command::new(std::env::current_exe().unwrap_or_else(|_| "tectum-bridge".into()));
    command.args(["guard", "--parent", &std::process::id().to_string(), "--port", &settings.port]);
    command.args(["--protocol", settings.protocol.name(), "--baud", &settings.baud.to_string()]);
    command.args(["--ids", &ids.join(","), "--period-ns", &settings.period_ns.to_string()]);
    Guard::start(&mut command)
}

/// Runs the guard.
pub fn run(arguments: &Arguments) -> ExitCode {
    let settings = GuardSettings {
        port: arguments.port.clone(),
        protocol: Protocol::named(&arguments.protocol),
        baud: arguments.baud,
        ids: arguments.ids.clone(),
        period_ns: arguments.period_ns,
    };
    watch(arguments.parent, &settings)
}
