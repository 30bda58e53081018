//! `tectum bench`: arguments and output of the benches in [`tectum::bench`].

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Subcommand, ValueEnum};
use tectum::bench::{
    self, AllBenches, BenchError, CallsSettings, CostsOutcome, GrowthSettings, LatencySettings, LockstepSettings, Pace,
};
use tectum::process::print_error_line;
use tectum::timing::{Transport, serve};

use super::print;
use super::tick_count::tick_count;

#[derive(Debug, Args)]
#[command(
    arg_required_else_help = true,
    after_help = "\
Example: tectum bench latency --seconds 60    ticks of 50 ms, beside bare transports from process to process

Build with --release, and let no other program compute meanwhile. Every result describes the machine."
)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// From a tick's scheduled instant to the applied command, between real processes, beside bare transports
    Latency(LatencyArguments),
    /// Ticks a second as fast as the processes go, against bare iceoryx2
    Lockstep(LockstepArguments),
    /// What encoding costs: nanoseconds a call, by version, path and number of features
    Encoder(CallsArguments),
    /// What learning costs: nanoseconds a call, by version, path, rule and number of features
    Learner(CallsArguments),
    /// How costs grow with joints, watchers and the length of the log
    Growth(GrowthArguments),
    /// All benches, with a page, figures and all numbers in a folder
    All(AllArguments),
    /// The peer process of a bare transport; started by the other commands
    #[command(hide = true)]
    Peer(PeerArguments),
}

#[derive(Debug, Args)]
#[command(after_help = "\
A real run of the paper's scenario (plant, controller, logger) takes turns with the same payload over bare
iceoryx2 (event, and polling with a yield), a Unix-domain socket, a pipe, and shared memory with a futex,
each between two processes. All series count from the scheduled instant, and include the ticks that a
stall skipped.

Examples:
  tectum bench latency                              ticks of 50 ms, ten seconds of each transport
  tectum bench latency --seconds 60 --out today     a minute of each, files in `today`
  tectum bench latency --mode saturated --json      back to back, in lockstep")]
struct LatencyArguments {
    /// How exchanges follow each other
    #[arg(long, value_enum, default_value_t = Mode::Cadence)]
    mode: Mode,
    /// For how long each transport is measured, seconds; may be a fraction
    #[arg(long, value_name = "N", default_value_t = 10.0)]
    seconds: f64,
    /// Folder for the distributions and the numbers [default: runs/bench-latency-<n>]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print one JSON object instead of the tables
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Mode {
    /// Every 50 ms on the real clock
    Cadence,
    /// Back to back
    Saturated,
}

#[derive(Debug, Args)]
#[command(after_help = "\
The paper's scenario with a complete log, with every 100th tick in the log, and in one process, and bare
iceoryx2 that polls and yields with the same payload: blocks of all four take turns.

Examples:
  tectum bench lockstep                     5 blocks of 300,000 ticks of each
  tectum bench lockstep --ticks 12000000 --rounds 1
                                            a week of the arm's time; a complete log takes some GB meanwhile")]
struct LockstepArguments {
    /// Ticks of a block
    #[arg(long, value_name = "N", default_value_t = 300_000, value_parser = tick_count, allow_negative_numbers = true)]
    ticks: u64,
    /// Blocks of each case
    #[arg(long, value_name = "N", default_value_t = 5)]
    rounds: u64,
    /// Folder for the numbers [default: runs/bench-lockstep-<n>]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print one JSON object instead of the tables
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
#[command(after_help = "\
Every version on every path that this machine has, in short batches that take turns; the middle batch and
the quickest.

Examples:
  tectum bench encoder                    200 batches of each case
  tectum bench learner --batches 1000     takes longer, and is disturbed less by other programs")]
struct CallsArguments {
    /// Batches of each case, a tenth of a millisecond each
    #[arg(long, value_name = "N", default_value_t = 200)]
    batches: u64,
    /// Folder for the numbers [default: runs/bench-<what>-<n>]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print one JSON object instead of the tables
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
#[command(after_help = "\
Every learner on planar arms of 2 to 8 joints and on the SO-101, whose target has three coordinates; the paper's
arm in real time with 0 to 4 processes that watch it; in lockstep with logs of more and more ticks; and the time
from the start of a run to its first observation.

Examples:
  tectum bench growth                       about three minutes
  tectum bench growth --out runs/growth     numbers and figure in that folder")]
struct GrowthArguments {
    /// Ticks of the slowest learner on each body; quicker ones run more
    #[arg(long, value_name = "N", default_value_t = 160, value_parser = tick_count, allow_negative_numbers = true)]
    ticks: u64,
    /// For how long each number of watchers watches, seconds; may be a fraction
    #[arg(long, value_name = "N", default_value_t = 10.0)]
    seconds: f64,
    /// Ticks of the longest log
    #[arg(
        long, value_name = "N", default_value_t = 2_000_000, value_parser = tick_count, allow_negative_numbers = true
    )]
    log_ticks: u64,
    /// Folder for the numbers and the figure [default: runs/bench-growth-<n>]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print one JSON object instead of the tables
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
#[command(after_help = "\
Example: tectum bench all --report runs/performance    about four minutes; the page is performance.md in there")]
struct AllArguments {
    /// Folder for page, figures and numbers
    #[arg(long, value_name = "DIR")]
    report: PathBuf,
    /// For how long each transport is measured, seconds; may be a fraction
    #[arg(long, value_name = "N", default_value_t = 10.0)]
    seconds: f64,
    /// Ticks of a block in lockstep
    #[arg(long, value_name = "N", default_value_t = 300_000, value_parser = tick_count, allow_negative_numbers = true)]
    ticks: u64,
    /// Blocks of each case in lockstep
    #[arg(long, value_name = "N", default_value_t = 5)]
    rounds: u64,
    /// Batches of each case of calls
    #[arg(long, value_name = "N", default_value_t = 200)]
    batches: u64,
    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
struct PeerArguments {
    /// Over which transport
    #[arg(long, value_parser = transport)]
    over: Transport,
    /// Number of the iceoryx2 domain
    #[arg(long)]
    domain: Option<u64>,
    /// Process id of the bench that has started it
    #[arg(long)]
    parent: Option<u32>,
}

fn transport(name: &str) -> Result<Transport, String> {
    Transport::of(name).ok_or_else(|| format!("one of {}", Transport::ALL.map(Transport::name).join(", ")))
}

pub fn main(arguments: &Arguments) -> ExitCode {
    let result = match &arguments.command {
        Command::Latency(arguments) => latency(arguments),
        Command::Lockstep(arguments) => lockstep(arguments),
        Command::Encoder(arguments) => calls(arguments, bench::encoder),
        Command::Learner(arguments) => calls(arguments, bench::learner),
        Command::Growth(arguments) => growth(arguments),
        Command::All(arguments) => all(arguments),
        Command::Peer(arguments) => {
            serve(arguments.over, arguments.domain, arguments.parent).map(|()| String::new()).map_err(BenchError::from)
        }
    };
    match result {
        Ok(text) => print(&text),
        Err(error) => {
            print_error_line(&format!("tectum: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}

fn latency(arguments: &LatencyArguments) -> Result<String, BenchError> {
    let pace = match arguments.mode {
        Mode::Cadence => Pace::Cadence,
        Mode::Saturated => Pace::Saturated,
    };
    let (seconds, out) = (arguments.seconds, arguments.out.clone());
    let outcome = bench::latency(&LatencySettings { pace, seconds, out, progress: true })?;
    Ok(if arguments.json { outcome.to_json() + "\n" } else { outcome.to_text() })
}

fn lockstep(arguments: &LockstepArguments) -> Result<String, BenchError> {
    let (ticks, rounds) = (arguments.ticks, arguments.rounds);
    let outcome = bench::lockstep(&LockstepSettings { ticks, rounds, out: arguments.out.clone(), progress: true })?;
    Ok(if arguments.json { outcome.to_json() + "\n" } else { outcome.to_text() })
}

fn calls(
    arguments: &CallsArguments,
    bench: fn(&CallsSettings) -> Result<CostsOutcome, BenchError>,
) -> Result<String, BenchError> {
    let (batches, out) = (arguments.batches, arguments.out.clone());
    let outcome = bench(&CallsSettings { batches, out, progress: true })?;
    Ok(if arguments.json { outcome.to_json() + "\n" } else { outcome.to_text() })
}

fn growth(arguments: &GrowthArguments) -> Result<String, BenchError> {
    let outcome = bench::growth(&GrowthSettings {
        ticks: arguments.ticks,
        seconds: arguments.seconds,
        log_ticks: arguments.log_ticks,
        out: arguments.out.clone(),
        progress: true,
    })?;
    Ok(if arguments.json { outcome.to_json() + "\n" } else { outcome.to_text() })
}

fn all(arguments: &AllArguments) -> Result<String, BenchError> {
    let outcome = bench::all(&AllBenches {
        report: arguments.report.clone(),
        seconds: arguments.seconds,
        ticks: arguments.ticks,
        rounds: arguments.rounds,
        batches: arguments.batches,
        progress: true,
    })?;
    Ok(if arguments.json { outcome.to_json() + "\n" } else { outcome.to_text() })
}
