//! `tectum-bridge scan | calibrate | jog | watch`: command-line interface of the tools.

use std::io::Write as _;
use std::path::PathBuf;

use clap::{Args, Subcommand};
use tectum::clock::{TerminationSignals, pause};
use tectum::process::print_error_line;
use tectum::servo::bus::{Bus, BusBudget, BusError, latency_advice, latency_ms};
use tectum::servo::guard::GuardSettings;
use tectum::servo::model::{Protocol, ServoSeries, foreign_model};
use tectum::servo::tools::{self, Calibration, FoundServo, Jog, JogContext, ToolError};

use super::guard;

/// Longest time between two heartbeats of `jog`, ns: it reads the position, once or twice, within this time.
const JOG_PERIOD: u64 = 80_000_000;

/// Tools for an arm that is not part of a run.
#[derive(Debug, Subcommand)]
pub enum Tool {
    /// Find servos: ids, models, baud rates
    Scan(Scan),
    /// Record zero, direction and range of each joint, moved by hand without torque
    Calibrate(Calibrate),
    /// Move one joint slowly, then turn its torque off
    Jog(Move),
    /// Show the state of the servos
    Watch(Watch),
}

/// The bus of a tool.
#[derive(Debug, Args)]
struct BusArguments {
    /// The serial port
    #[arg(long)]
    port: String,
    /// Protocol of the servos
    #[arg(long, value_parser = Protocol::NAMES)]
    protocol: String,
    /// Baud rate
    #[arg(long, default_value_t = 1_000_000)]
    baud: u32,
}

/// `scan`.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  tectum-bridge scan --port /dev/ttyUSB0                                       both series, at all their rates
  tectum-bridge scan --port /dev/ttyUSB0 --protocol feetech --baud 1000000     some seconds instead of a minute")]
pub struct Scan {
    /// The serial port
    #[arg(long)]
    port: String,
    /// Protocol of the servos; if omitted, both are tried
    #[arg(long, value_parser = Protocol::NAMES)]
    protocol: Option<String>,
    /// Baud rate; if omitted, all rates of the series
    #[arg(long)]
    baud: Option<u32>,
    /// The highest id to ask
    #[arg(long, default_value_t = 252)]
    max_id: u8,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// `calibrate`.
#[derive(Debug, Args)]
#[command(after_help = "\
Torque is off all the time. Each step is requested, done by hand, and ended with Enter. With --json the requests go to
standard error, and one object with the joints is printed at the end.

Example:
  tectum-bridge calibrate --port /dev/ttyUSB0 --protocol feetech --ids 1,2,3,4 --out my-arm.toml
  tectum-bridge calibrate --port /dev/ttyACM0 --protocol feetech --import so101.json --out my-arm.toml")]
pub struct Calibrate {
    #[command(flatten)]
    bus: BusArguments,
    /// The ids, from the base on; with --import, those to take over
    #[arg(long, value_delimiter = ',', required_unless_present = "import")]
    ids: Vec<u8>,
    /// Names of the joints, in the same order; `teleop` pairs joints by them
    #[arg(long, value_delimiter = ',')]
    names: Vec<String>,
    /// Take the joints from this file instead, one of LeRobot's (.json), and compare the servos' registers with it
    #[arg(long, value_name = "FILE")]
    import: Option<PathBuf>,
    /// Write the joints as a file of LeRobot's too; its angles are 0 in the middle of their ranges
    #[arg(long, value_name = "FILE")]
    export: Option<PathBuf>,
    /// The file to write
    #[arg(long, default_value = "arm-calibration.toml")]
    out: PathBuf,
    /// Highest speed of each joint, rad/s
    #[arg(long, default_value_t = 6.0)]
    max_speed: f64,
    /// Replace an existing file
    #[arg(long)]
    force: bool,
    /// Print the joints as one JSON object
    #[arg(long)]
    json: bool,
}

/// `jog`.
#[derive(Debug, Args)]
#[command(after_help = "\
Torque is on while the servo moves, and off afterwards however that ends.

Example:
  tectum-bridge jog --port /dev/ttyUSB0 --protocol feetech --id 2 --by -0.3 --calibration my-arm.toml")]
pub struct Move {
    #[command(flatten)]
    bus: BusArguments,
    /// Id of the servo
    #[arg(long)]
    id: u8,
    /// Angle, rad
    #[arg(long, allow_hyphen_values = true)]
    by: f64,
    /// Speed, rad/s
    #[arg(long, default_value_t = 0.5)]
    speed: f64,
    /// Keep the range and direction of this calibration file
    #[arg(long)]
    calibration: Option<PathBuf>,
    /// Print the state of the servo afterwards as one JSON object
    #[arg(long)]
    json: bool,
}

/// `watch`.
#[derive(Debug, Args)]
#[command(after_help = "\
Nothing is written to the servos. With --json there is one object for each servo and look.

Example:
  tectum-bridge watch --port /dev/ttyUSB0 --protocol feetech --ids 1,2,3,4 --once")]
pub struct Watch {
    #[command(flatten)]
    bus: BusArguments,
    /// The ids
    #[arg(long, value_delimiter = ',', required = true)]
    ids: Vec<u8>,
    /// Print once, instead of until Ctrl-C
    #[arg(long)]
    once: bool,
    /// Print one JSON object per line
    #[arg(long)]
    json: bool,
}

/// Prints a line at once.
fn print_line(text: &str) -> Result<(), ToolError> {
    let mut out = std::io::stdout();
    writeln!(out, "{text}").and_then(|()| out.flush()).map_err(|error| ToolError::Io("standard output".into(), error))
}

impl BusArguments {
    fn open(&self) -> Result<Bus, ToolError> {
        let series = Protocol::named(&self.protocol).series();
        if let Err(known) = series.check_baud(self.baud) {
            return Err(ToolError::Refused(format!("--baud {}: {} has {known}", self.baud, series.name)));
        }
        Ok(super::open_bus(&self.port, series.protocol, self.baud, tools::BUDGET)?)
    }
}

/// Runs a tool.
///
/// # Errors
/// When the tool fails, with a message for the user.
pub fn run(tool: &Tool) -> Result<(), ToolError> {
    let signals = TerminationSignals::install().map_err(|error| ToolError::Io("signals".into(), error))?;
    let stop = || signals.received() != 0;
    match tool {
        Tool::Scan(scan) => find(scan, &stop),
        Tool::Calibrate(arguments) => calibrate(arguments),
        Tool::Jog(arguments) => {
            let protocol = Protocol::named(&arguments.bus.protocol);
            let load = |path| Calibration::load(path, protocol);
            let calibration = arguments.calibration.as_deref().map(load).transpose()?;
            jog(arguments, calibration.as_ref(), &stop)
        }
        Tool::Watch(arguments) => watch(arguments, &stop),
    }
}

fn jog(arguments: &Move, calibration: Option<&Calibration>, stop: &dyn Fn() -> bool) -> Result<(), ToolError> {
    let Move { bus: port, id, by, speed, .. } = arguments;
    let mut bus = port.open()?;
    let settings = GuardSettings {
        port: port.port.clone(),
        protocol: Protocol::named(&port.protocol),
        baud: port.baud,
        ids: vec![*id],
        period_ns: JOG_PERIOD,
    };
    let mut guard = guard::start(&settings).map_err(ToolError::Failed)?;
    let motion = Jog { id: *id, by: *by, speed: *speed, calibration };
    let mut context = JogContext { sleep: &mut pause, stop: &mut || stop(), beat: &mut |torque| guard.beat(torque) };
    let after = tools::jog(&mut bus, motion, &mut context);
    if bus.is_gone() {
        // Its pipe ends with this process, without a farewell: it waits for the cable and turns torque off.
        std::mem::forget(guard);
    }
    let after = after?;
    print_line(&if arguments.json { serde_json::json!(after).to_string() } else { after.line() })
}

/// Ids that are asked a second time, patiently, when nobody has answered.
const LIKELY_IDS: u8 = 16;

/// Latency for which that second search waits, ms: the default of FTDI's driver.
const USUAL_LATENCY_MS: u32 = 16;

fn find(scan: &Scan, stop: &dyn Fn() -> bool) -> Result<(), ToolError> {
    let protocols = match &scan.protocol {
        Some(name) => vec![Protocol::named(name)],
        None => vec![Protocol::Dynamixel, Protocol::Feetech],
    };
    if let Some(advice) = latency_advice(&scan.port) {
        print_error_line(&format!("tectum-bridge: {advice}; until then this search waits longer for each id"));
    }
    let latency = latency_ms(&scan.port);
    let (mut all, mut duplicate_id, mut echoes, mut late) = (Vec::new(), None, false, false);
    for series in protocols.iter().map(|protocol| protocol.series()) {
        for &(baud, _) in series.bauds.iter().filter(|(baud, _)| scan.baud.is_none_or(|only| only == *baud)) {
            let last = scan.max_id.min(series.max_id);
            let mut answers = search(scan, series, baud, last, latency.unwrap_or(0), stop)?;
            if (answers.found.is_empty() || answers.late) && latency.is_none() {
                answers = search(scan, series, baud, last.min(LIKELY_IDS), USUAL_LATENCY_MS, stop)?;
                late |= !answers.found.is_empty();
            }
            echoes |= answers.echo;
            for found in answers.found {
                if found.garbled {
                    duplicate_id = Some(found.id);
                }
                if !scan.json {
                    let what = describe(series.protocol, &found);
                    print_line(&format!("{} at {baud} baud: servo {}, {what}", series.name, found.id))?;
                }
                all.push(serde_json::json!({ "protocol": series.protocol, "baud": baud, "servo": found }));
            }
        }
    }
    if echoes {
        print_error_line("tectum-bridge: the adapter sends back what it is sent; its own bytes are left out");
    }
    if late {
        print_error_line(&format!(
            "tectum-bridge: the adapter holds answers back, so only ids up to {LIKELY_IDS} were found; make its \
             latency timer 1 ms"
        ));
    }
    if scan.json {
        print_line(&serde_json::json!({ "servos": all, "echo": echoes, "late": late }).to_string())?;
    }
    match (duplicate_id, all.is_empty()) {
        (Some(id), _) => Err(ToolError::DuplicateId(id)),
        (None, true) => Err(ToolError::NoServo(format!(" at {}", scan.port))),
        (None, false) => Ok(()),
    }
}

/// What a search at one rate finds.
struct Answers {
    found: Vec<FoundServo>,
    /// Whether answers came late.
    late: bool,
    /// Whether the adapter sends back what it is sent.
    echo: bool,
}

/// Asks the ids up to `last` at one rate, behind an adapter that holds answers for `latency` ms.
fn search(
    scan: &Scan,
    series: &ServoSeries,
    baud: u32,
    last: u8,
    latency: u32,
    stop: &dyn Fn() -> bool,
) -> Result<Answers, ToolError> {
    let usual = tools::search_budget(latency);
    // At low rates the transmission time matters: about thirty bytes in each direction.
    let wire = 30 * 10 * 1_000_000_000 / u64::from(baud);
    let budget = BusBudget { read_ns: usual.read_ns + 2 * wire, ..usual };
    let mut bus = super::open_bus(&scan.port, series.protocol, baud, budget)?;
    let (found, late) = tools::scan(&mut bus, 0..=last, stop);
    Ok(Answers { found, late, echo: bus.echoes() })
}

/// What a servo is, for the user.
fn describe(protocol: Protocol, found: &FoundServo) -> String {
    match (found.garbled, found.mute, found.model) {
        (true, ..) => "cannot be read: two servos with this id?".to_owned(),
        (_, true, _) => "answers pings alone: its response level (Dynamixel: address 68) is too low".to_owned(),
        (.., Some(name)) => name.to_owned(),
        (.., None) => format!("not driven: {}", foreign_model(protocol, found.number.unwrap_or(0))),
    }
}

fn calibrate(arguments: &Calibrate) -> Result<(), ToolError> {
    if !(0.01..=100.0).contains(&arguments.max_speed) {
        return Err(ToolError::Refused(format!("--max-speed {}: give 0.01 to 100 rad/s", arguments.max_speed)));
    }
    if arguments.out.exists() && !arguments.force {
        let text = format!("{}: the file is there already; give another --out, or --force", arguments.out.display());
        return Err(ToolError::Refused(text));
    }
    if !arguments.names.is_empty() && arguments.names.len() != arguments.ids.len() {
        let (names, ids) = (arguments.names.len(), arguments.ids.len());
        return Err(ToolError::Refused(format!("--names has {names} names and --ids {ids} ids; give one for each")));
    }
    let mut bus = arguments.bus.open()?;
    let mut calibration = match &arguments.import {
        Some(file) => tools::import(&mut bus, file, &arguments.ids)?,
        None => {
            let mut input = std::io::stdin().lock();
            let mut ask: Box<dyn std::io::Write> =
                if arguments.json { Box::new(std::io::stderr()) } else { Box::new(std::io::stdout()) };
            tools::calibrate(&mut bus, &arguments.ids, arguments.max_speed, &mut input, &mut ask)?
        }
    };
    for (joint, name) in calibration.joints.iter_mut().zip(&arguments.names) {
        joint.name = Some(name.clone());
    }
    if let Some(file) = &arguments.export {
        let written = std::fs::write(file, tools::write_lerobot(&calibration));
        written.map_err(|error| ToolError::Io(file.display().to_string(), error))?;
    }
    calibration.save(&arguments.out)?;
    match arguments.json {
        true => print_line(&serde_json::json!({ "file": arguments.out, "calibration": calibration }).to_string()),
        false => print_line(&format!("written to {}", arguments.out.display())),
    }
}

fn watch(arguments: &Watch, stop: &dyn Fn() -> bool) -> Result<(), ToolError> {
    let mut bus = arguments.bus.open()?;
    tools::identify(&mut bus, &arguments.ids)?;
    while !stop() {
        for &id in &arguments.ids {
            let state = match tools::read_state(&mut bus, id) {
                // It may come back; a single look is a failure.
                Err(ToolError::Bus(error @ BusError::NoAnswer { .. })) if !arguments.once => {
                    let json = || serde_json::json!({ "id": id, "error": error.to_string() }).to_string();
                    print_line(&if arguments.json { json() } else { error.to_string() })?;
                    continue;
                }
                state => state?,
            };
            print_line(&if arguments.json { serde_json::json!(state).to_string() } else { state.line() })?;
        }
        if arguments.once {
            break;
        }
        pause(200_000_000);
    }
    Ok(())
}
