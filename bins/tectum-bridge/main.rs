//! Servos on a serial bus: the tools that find, calibrate, move and watch them.

mod tools;

use std::io::Write as _;
use std::process::ExitCode;

use clap::Parser;

const EXAMPLE: &str = "With no hardware:\n  \
    tectum-servo-emulator --protocol feetech --ids 1,2,3,4 --link /tmp/arm &\n  \
    tectum-bridge scan --port /tmp/arm --protocol feetech --baud 1000000\n  \
    tectum-bridge jog --port /tmp/arm --protocol feetech --id 1 --by 0.3";

/// Servos on a serial bus
#[derive(Debug, Parser)]
#[command(version = tectum::BUILD, after_help = EXAMPLE)]
struct Arguments {
    #[command(subcommand)]
    tool: tools::Tool,
}

fn main() -> ExitCode {
    match tools::run(&Arguments::parse().tool) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let _ = writeln!(std::io::stderr(), "tectum-bridge: {error}");
            ExitCode::FAILURE
        }
    }
}
