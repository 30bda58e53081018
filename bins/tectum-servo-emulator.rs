//! `tectum-servo-emulator`: a chain of emulated servos behind a pseudo-terminal, in real time.

use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use tectum::clock::{ProcessHandle, TerminationSignals};
use tectum::runtime::exit;
use tectum::scenario::{EmulatorConfig, Scenario, ServoFault};
use tectum::servo::emulator::EmulatedChain;
use tectum::servo::model::Protocol;
use tectum::servo::pseudo_terminal::{EmulatorTasks, PseudoTerminal};

const EXAMPLE: &str = "Four servos that a bridge, or any program for such servos, finds under /tmp/arm:\n  \
    tectum-servo-emulator --protocol feetech --ids 1,2,3,4 --link /tmp/arm\n  \
    tectum-bridge scan --port /tmp/arm --protocol feetech\n\
    With --control it takes lines on standard input: \
    \"hand 1 3000\" turns servo 1 by hand, \"state\" says how all are, \"unplug\" and \"plug\" pull the port out \
    and put it back, \"fault hot:2:0:5\" is a fault from now on for 5 s.";

/// Emulates a chain of serial-bus servos behind a pseudo-terminal
#[derive(Debug, Parser)]
#[command(version = tectum::BUILD, after_help = EXAMPLE)]
struct Arguments {
    /// Protocol of the servos
    #[arg(long, default_value = "dynamixel", value_parser = Protocol::NAMES)]
    protocol: String,
    /// Their ids, in the order on the wire; a repeated id gives two servos that answer at the same time
    #[arg(long, value_delimiter = ',', default_value = "1,2,3,4")]
    ids: Vec<u8>,
    /// Their baud rate
    #[arg(long, default_value_t = 1_000_000)]
    baud: u32,
    /// Take [plant.emulator] and the seed from this scenario
    #[arg(long, value_name = "FILE")]
    scenario: Option<PathBuf>,
    /// Seed of noise, jitter and faults; by default the scenario's, or 1
    #[arg(long)]
    seed: Option<u64>,
    /// A fault as `KIND`, `KIND:SERVO`, `KIND:SERVO:FROM_S` or `KIND:SERVO:FROM_S:UNTIL_S`; may be given
    /// several times
    #[arg(long = "fault", value_name = "FAULT")]
    faults: Vec<String>,
    /// A register before the start, as `SERVO:ADDRESS:WIDTH:VALUE`, as another program may have left it; may be
    /// given several times
    #[arg(long = "set", value_name = "REGISTER")]
    registers: Vec<String>,
    /// The servos' positions at the start, steps
    #[arg(long, default_value_t = 2048.0)]
    at: f64,
    /// Create this symbolic link to the terminal
    #[arg(long, value_name = "PATH")]
    link: Option<PathBuf>,
    /// End with the process of this id
    #[arg(long, value_name = "PID")]
    parent: Option<u32>,
    /// Read commands from standard input
    #[arg(long)]
    control: bool,
    /// Print a line when a servo's torque goes on or off
    #[arg(long)]
    trace: bool,
    /// Print one JSON object per line
    #[arg(long)]
    json: bool,
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err((error, code)) => {
            let _ = writeln!(std::io::stderr(), "tectum-servo-emulator: {error}");
            ExitCode::from(code)
        }
    }
}

/// A message and an exit code.
type Problem = (String, u8);

fn run(arguments: &Arguments) -> Result<(), Problem> {
    let bad = |text: String| (text, exit::INPUT);
    let own = |text: String| (text, exit::ERROR);
    let protocol = Protocol::named(&arguments.protocol);
    let series = protocol.series();
    if let Err(known) = series.check_baud(arguments.baud) {
        return Err(bad(format!("--baud {}: {} has {known}", arguments.baud, series.name)));
    }
    if let Some(id) = arguments.ids.iter().find(|&&id| id > series.max_id) {
        return Err(bad(format!("--ids {id}: the highest id of {} is {}", series.name, series.max_id)));
    }
    let (mut settings, mut seed) = (EmulatorConfig::default(), 1);
    if let Some(path) = &arguments.scenario {
        let plan = Scenario::load(path).and_then(Scenario::plan).map_err(|error| bad(error.to_string()))?;
        settings = plan.scenario.plant.emulator.unwrap_or_default();
        seed = plan.scenario.seed;
    }
    for text in &arguments.faults {
        settings.faults.push(ServoFault::parse(text).map_err(|why| bad(format!("--fault {text}: {why}")))?);
    }
    let signals = TerminationSignals::install().map_err(|error| own(format!("signals cannot be taken: {error}")))?;
    let parent = match arguments.parent {
        // If the parent has already ended, there is nothing to do.
        Some(pid) => match ProcessHandle::of(pid) {
            Some(parent) => Some(parent),
            None => return Ok(()),
        },
        None => None,
    };
    let mut terminal = PseudoTerminal::open(arguments.link.as_deref()).map_err(|error| match &arguments.link {
        Some(link) => bad(format!("{}: no terminal can be put there: {error}", link.display())),
        None => own(format!("there is no terminal to be had: {error}")),
    })?;
    let mut chain =
        EmulatedChain::new(protocol, &arguments.ids, arguments.baud, &settings, arguments.seed.unwrap_or(seed));
    for &id in &arguments.ids {
        chain.move_by_hand(0, id, arguments.at);
    }
    for text in &arguments.registers {
        let (servo, address, bytes) = register(text).map_err(bad)?;
        chain.overwrite(servo, address, &bytes);
    }
    let path = arguments.link.clone().or(terminal.path()).unwrap_or_default().display().to_string();
    let mut out = std::io::stdout();
    let line = if arguments.json {
        serde_json::json!({ "port": path, "protocol": protocol, "ids": arguments.ids, "baud": arguments.baud })
            .to_string()
    } else {
        format!("{} servos at {path}", arguments.ids.len())
    };
    let _ = writeln!(out, "{line}").and_then(|()| out.flush());
    let tasks = EmulatorTasks { control: arguments.control, trace: arguments.trace, json: arguments.json, parent };
    terminal.serve(chain, &signals, &tasks).map_err(|error| own(format!("the terminal failed: {error}")))
}

/// Parses a register: `SERVO:ADDRESS:WIDTH:VALUE`. Negative values are two's complement.
fn register(text: &str) -> Result<(u8, u8, Vec<u8>), String> {
    let wrong = || format!("--set {text}: give SERVO:ADDRESS:WIDTH:VALUE, as in 1:31:2:300, with a width of 1, 2 or 4");
    let parts: Vec<i64> = text.split(':').map(|part| part.parse().map_err(|_| wrong())).collect::<Result<_, _>>()?;
    match parts[..] {
        [servo @ 0..254, address @ 0..256, width @ (1 | 2 | 4), value] => {
            Ok((servo as u8, address as u8, value.to_le_bytes()[..width as usize].to_vec()))
        }
        _ => Err(wrong()),
    }
}
