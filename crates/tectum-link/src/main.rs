//! `tectum-link`: plant on one machine, controller on another.
//!
//! On each machine it launches a run as `tectum run` does, with a process of its own in the place of the one that runs
//! on the other machine: on the plant's machine it takes the controller's place, and on the controller's machine the
//! plant's. The two exchange samples over zenoh. Plant, controller and logger notice nothing of it.

#![warn(missing_docs)]

mod bad_network;
mod carrier;
mod clock_offset;
mod connection;
mod controller_side;
mod error;
mod handshake;
mod legs;
mod message;
mod plant_side;
mod round_trip;
mod seal;
mod silence_notice;
mod stand_in;
#[cfg(feature = "zenoh")]
mod zenoh_carrier;

use std::net::SocketAddr;
use std::ops::Range;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::{Args, Parser, Subcommand, ValueEnum};
use tectum::clock::TerminationSignals;
use tectum::process::{print_error_line, print_result};
use tectum::runtime::{Mode, Participant, exit};
use tectum::scenario::{Plan, Scenario};
use tectum::supervise::{Launch, LearnedState, RunSummary, StandIn, run};

use bad_network::BadNetwork;
use carrier::Endpoint;
use error::LinkError;
use round_trip::PingSettings;
use seal::{LinkSide, SharedKey, random};
use stand_in::StandInSettings;

/// Runs plant and controller on two machines: start it on both
#[derive(Debug, Parser)]
#[command(name = "tectum-link", version = tectum::BUILD, arg_required_else_help = true, after_help = "\
Examples:
  tectum-link key > link.key            a key; copy it to the other machine
  tectum-link plant arm --mode realtime --listen udp/192.168.7.2:7447 --key link.key
                                        on the machine that has the plant
  tectum-link controller arm --mode realtime --connect udp/192.168.7.2:7447 --key link.key
                                        on the one that has the controller
  tectum-link ping --listen udp/192.168.7.2:7447
  tectum-link ping --connect udp/192.168.7.2:7447
                                        what the network takes, before there is a run
  tectum-link network --listen 127.0.0.1:7448 --to 127.0.0.1:7447 --loss 0.05 --delay-ms 20
                                        a bad network between two ends, to try a link on

Exit codes are those of tectum run.")]
struct Arguments {
    #[command(subcommand)]
    command: LinkCommand,
}

#[derive(Debug, Subcommand)]
enum LinkCommand {
    /// Run the plant here; its controller runs on the other machine
    Plant(RunArguments),
    /// Run the controller here; its plant runs on the other machine
    Controller(RunArguments),
    /// Print a new shared key
    Key,
    /// Measure how long a datagram takes to the other machine and back, without a run
    Ping(PingArguments),
    /// Carry the datagrams of a link, and lose and delay some of them: a bad network to try it on
    Network(NetworkArguments),
    /// Take the place of the process on the other machine, in a run that the launcher has made
    #[command(hide = true)]
    StandIn(StandInArguments),
}

/// Where the two ends meet.
#[derive(Debug, Clone, Args)]
struct Meeting {
    /// Wait at this address of this machine: udp/IP:PORT (zenoh), or raw/IP:PORT (bare UDP)
    #[arg(long, value_name = "ADDRESS", conflicts_with = "connect", required_unless_present = "connect")]
    listen: Option<String>,
    /// Go to this address of the other machine
    #[arg(long, value_name = "ADDRESS")]
    connect: Option<String>,
    /// The file of the key that both machines have; without one only loopback and link.hosts of the scenario
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// How long to wait for the other machine before the run begins, s
    #[arg(long, value_name = "S", default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..=86400))]
    wait: u64,
}

#[derive(Debug, Args)]
struct RunArguments {
    /// A scenario file, or the name of a built-in one; the same on both machines
    scenario: PathBuf,
    #[command(flatten)]
    meeting: Meeting,
    /// How ticks follow each other; the same on both machines
    #[arg(long, value_enum, default_value = "realtime")]
    mode: LinkMode,
    /// Number of ticks in place of the scenario's; the same on both machines
    #[arg(long, value_name = "N")]
    ticks: Option<u64>,
    /// Seed in place of the scenario's; the same on both machines
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    /// Folder for log, figure and reports [default: runs/<scenario>-<n>]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Controller's machine: begin with what another run has learned: its folder, its name, or a checkpoint
    #[arg(long, value_name = "RUN|CHECKPOINT")]
    from: Option<PathBuf>,
    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum LinkMode {
    /// As fast as the two machines go
    Lockstep,
    /// At the scenario's period on the real clock
    Realtime,
}

#[derive(Debug, Args)]
struct StandInArguments {
    /// Which machine this is
    #[arg(long, value_enum)]
    side: LinkSide,
    #[command(flatten)]
    meeting: Meeting,
    /// The run to join
    #[arg(long, value_name = "RUN")]
    run: PathBuf,
}

#[derive(Debug, Args)]
struct PingArguments {
    /// Send back what comes to this address of this machine, until Ctrl-C
    #[arg(long, value_name = "ADDRESS", conflicts_with = "connect", required_unless_present = "connect")]
    listen: Option<String>,
    /// Measure to this address of the other machine, where `ping --listen` runs: udp/IP:PORT (zenoh), raw/IP:PORT
    #[arg(long, value_name = "ADDRESS")]
    connect: Option<String>,
    /// Number of datagrams
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    count: u64,
    /// Time from one datagram to the next, ms
    #[arg(long, value_name = "MS", default_value_t = 50, value_parser = clap::value_parser!(u64).range(1..=60_000))]
    every_ms: u64,
    /// Size of each, bytes; an observation has about as many
    #[arg(long, value_name = "N", default_value_t = 600, value_parser = clap::value_parser!(u64).range(16..=8000))]
    bytes: u64,
    /// How long to wait for the other end, s
    #[arg(long, value_name = "S", default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..=86400))]
    wait: u64,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
struct NetworkArguments {
    /// Where the end that connects goes to: IP:PORT
    #[arg(long, value_name = "ADDRESS")]
    listen: SocketAddr,
    /// The end that listens: IP:PORT
    #[arg(long, value_name = "ADDRESS")]
    to: SocketAddr,
    /// Share of the datagrams that are lost, each way: 0 to 1
    #[arg(long, value_name = "SHARE", default_value = "0", value_parser = share)]
    loss: f64,
    /// Delay each way, ms
    #[arg(long, value_name = "MS", default_value_t = 0, value_parser = clap::value_parser!(u64).range(0..=60_000))]
    delay_ms: u64,
    /// Nothing passes in this time, s after the first datagram
    #[arg(long, value_name = "FROM..UNTIL", value_parser = seconds_range)]
    cut: Option<Range<f64>>,
    /// Seed of what is lost
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Print one JSON object at the end
    #[arg(long)]
    json: bool,
}

fn share(text: &str) -> Result<f64, String> {
    let share: Option<f64> = text.parse().ok().filter(|share| (0.0..=1.0).contains(share));
    share.ok_or_else(|| "give a share from 0 to 1, such as 0.05".to_owned())
}

fn seconds_range(text: &str) -> Result<Range<f64>, String> {
    let seconds = |text: &str| text.parse().ok().filter(|s: &f64| (0.0..=1e6).contains(s));
    let range = text.split_once("..").and_then(|(from, until)| Some(seconds(from)?..seconds(until)?));
    range.filter(|range| range.start < range.end).ok_or_else(|| "give seconds, such as 10..13".to_owned())
}

impl Meeting {
    fn endpoint(&self) -> Result<Endpoint, LinkError> {
        match (&self.listen, &self.connect) {
            (Some(listen), _) => Endpoint::parse(listen, true),
            (None, connect) => Endpoint::parse(connect.as_deref().unwrap_or_default(), false),
        }
    }

    fn settings(&self, side: LinkSide) -> Result<StandInSettings, LinkError> {
        Ok(StandInSettings { side, endpoint: self.endpoint()?, key: self.key.clone(), wait_s: self.wait })
    }

    /// The same as arguments of the stand-in.
    fn arguments(&self, side: LinkSide) -> Vec<String> {
        let mut arguments = vec!["stand-in".to_owned(), "--side".to_owned(), side.name().to_owned()];
        let mut add = |option: &str, value: Option<String>| {
            arguments.extend(value.into_iter().flat_map(|value| [format!("--{option}"), value]));
        };
        add("listen", self.listen.clone());
        add("connect", self.connect.clone());
        add("key", self.key.as_ref().map(|key| key.display().to_string()));
        add("wait", Some(self.wait.to_string()));
        arguments
    }
}

fn main() -> ExitCode {
    let outcome = match Arguments::parse().command {
        LinkCommand::Plant(arguments) => launch(LinkSide::Plant, &arguments),
        LinkCommand::Controller(arguments) => launch(LinkSide::Controller, &arguments),
        LinkCommand::Key => print_key(),
        LinkCommand::Ping(arguments) => ping(&arguments),
        LinkCommand::Network(arguments) => network(&arguments),
        LinkCommand::StandIn(arguments) => stand_in(&arguments),
    };
    outcome.unwrap_or_else(|error| {
        print_error_line(&format!("tectum-link: {error}"));
        ExitCode::from(error.exit_code())
    })
}

fn print_key() -> Result<ExitCode, LinkError> {
    let digits: String = random::<32>()?.iter().map(|byte| format!("{byte:02x}")).collect();
    print(&(digits + "\n"))
}

fn ping(arguments: &PingArguments) -> Result<ExitCode, LinkError> {
    let signals = TerminationSignals::install().map_err(LinkError::Signals)?;
    if let Some(listen) = &arguments.listen {
        round_trip::answer(&Endpoint::parse(listen, true)?, &signals)?;
        return Ok(ExitCode::SUCCESS);
    }
    let endpoint = Endpoint::parse(arguments.connect.as_deref().unwrap_or_default(), false)?;
    let settings = PingSettings {
        count: arguments.count,
        every: Duration::from_millis(arguments.every_ms),
        bytes: arguments.bytes as usize,
        wait: Duration::from_secs(arguments.wait),
    };
    let trips = round_trip::measure(&endpoint, settings, &signals)?;
    print(&if arguments.json { json(&trips) } else { trips.to_text() })
}

fn network(arguments: &NetworkArguments) -> Result<ExitCode, LinkError> {
    let signals = TerminationSignals::install().map_err(LinkError::Signals)?;
    let network = BadNetwork {
        listen: arguments.listen,
        to: arguments.to,
        loss: arguments.loss,
        delay: Duration::from_millis(arguments.delay_ms),
        cut: arguments.cut.clone(),
        seed: arguments.seed,
    };
    let counts = network.carry(&signals)?;
    print(&if arguments.json { json(&counts) } else { counts.to_text() })
}

fn json(result: &impl serde::Serialize) -> String {
    serde_json::to_string_pretty(result).unwrap_or_default() + "\n"
}

/// Prints to standard output. What cannot be printed is no success.
fn print(text: &str) -> Result<ExitCode, LinkError> {
    print_result(text).map_err(|cause| LinkError::File { path: "standard output".into(), cause })?;
    Ok(ExitCode::SUCCESS)
}

fn stand_in(arguments: &StandInArguments) -> Result<ExitCode, LinkError> {
    let settings = arguments.meeting.settings(arguments.side)?;
    let participant = Participant::take(&arguments.run, settings.role(), None)?;
    match settings.side {
        LinkSide::Plant => plant_side::stand_in(participant, &settings)?,
        LinkSide::Controller => controller_side::stand_in(participant, &settings)?,
    }
    Ok(ExitCode::SUCCESS)
}

/// Launches the run on this machine. Whatever can be checked without the other one is checked before anything starts.
fn launch(side: LinkSide, arguments: &RunArguments) -> Result<ExitCode, LinkError> {
    let settings = arguments.meeting.settings(side)?;
    let (plan, started_from) = plan(arguments)?;
    match &settings.key {
        Some(key) => drop(SharedKey::read(key)?),
        None if !plan.scenario.link.names(settings.endpoint.address.ip()) => {
            return Err(LinkError::Open { address: settings.endpoint.text });
        }
        None => {}
    }
    for warning in &plan.warnings {
        print_error_line(&format!("tectum-link: warning: {warning}"));
    }
    let program = std::env::current_exe().map_err(|cause| LinkError::File { path: "tectum-link".into(), cause })?;
    let stand_in = StandIn { role: settings.role(), program, arguments: arguments.meeting.arguments(side) };
    let summary = run(&Launch {
        plan,
        mode: match arguments.mode {
            LinkMode::Lockstep => Mode::Lockstep,
            LinkMode::Realtime => Mode::Realtime,
        },
        out: arguments.out.clone(),
        name: None,
        by_hand: Vec::new(),
        checkpoint_every: 0,
        keep_checkpoints: 0,
        stopwatch: false,
        stand_in: Some(stand_in),
        resumed: None,
        started_from,
        frozen: false,
        progress: true,
    })?;
    show(&summary, arguments.json)
}

fn plan(arguments: &RunArguments) -> Result<(Plan, Option<LearnedState>), LinkError> {
    let started_from = arguments.from.as_deref().map(LearnedState::find).transpose()?;
    let mut scenario = Scenario::find(&arguments.scenario)?;
    scenario.ticks = arguments.ticks.unwrap_or(scenario.ticks);
    scenario.seed = arguments.seed.unwrap_or(scenario.seed);
    let mut plan = scenario.plan()?;
    if let Some(learned) = &started_from {
        plan.warnings.extend(learned.check(&plan)?);
    }
    Ok((plan, started_from))
}

fn show(summary: &RunSummary, json: bool) -> Result<ExitCode, LinkError> {
    if let Some(failure) = &summary.failure {
        print_error_line(&format!("tectum-link: {failure}"));
    }
    let printed = print(&if json { summary.to_json() + "\n" } else { summary.to_text() })?;
    Ok(if summary.exit_code() == exit::OK { printed } else { ExitCode::from(summary.exit_code()) })
}
