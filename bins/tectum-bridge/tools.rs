//! `tectum-bridge scan | calibrate | jog | watch`: the command lines of the tools.

use std::io::Write as _;
use std::path::PathBuf;

use clap::{Args, Subcommand};
use tectum::clock::{TerminationSignals, monotonic_ns, pause};
use tectum::servo::bus::{Bus, BusBudget};
use tectum::servo::model::Protocol;
use tectum::servo::tools::{self, Calibration, Jog, ToolError};

/// What to do with an arm that is no plant yet.
#[derive(Debug, Subcommand)]
pub enum Tool {
    /// Find servos: ids, models, baud rates
    Scan(Scan),
    /// Record zero, direction and range of each joint, moved by hand without torque
    Calibrate(Calibrate),
    /// Move one joint slowly, then turn its torque off
    Jog(Move),
    /// Show how the servos are
    Watch(Watch),
}

/// Which bus.
#[derive(Debug, Args)]
struct Which {
    /// The serial port
    #[arg(long)]
    port: String,
    /// What the servos speak
    #[arg(long, value_parser = Protocol::NAMES)]
    protocol: String,
    /// Bits a second
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
    /// What the servos speak; left out, both are tried
    #[arg(long, value_parser = Protocol::NAMES)]
    protocol: Option<String>,
    /// Bits a second; left out, all that the series knows
    #[arg(long)]
    baud: Option<u32>,
    /// The highest id to ask
    #[arg(long, default_value_t = 252)]
    max_id: u8,
    /// One JSON object
    #[arg(long)]
    json: bool,
}

/// `calibrate`.
#[derive(Debug, Args)]
#[command(after_help = "\
Torque is off all the while. Each step is asked for, done by hand, and ends with Enter; with --json the questions go to
standard error, and one object with the joints comes at the end.

Example:
  tectum-bridge calibrate --port /dev/ttyUSB0 --protocol feetech --ids 1,2,3,4 --out my-arm.toml")]
pub struct Calibrate {
    #[command(flatten)]
    which: Which,
    /// The ids, from the base on
    #[arg(long, value_delimiter = ',', required = true)]
    ids: Vec<u8>,
    /// The file to write
    #[arg(long, default_value = "arm-calibration.toml")]
    out: PathBuf,
    /// Highest speed of each joint, rad/s
    #[arg(long, default_value_t = 6.0)]
    max_speed: f64,
    /// Replace a file that is there
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
    which: Which,
    /// The servo
    #[arg(long)]
    id: u8,
    /// By how much, rad
    #[arg(long, allow_hyphen_values = true)]
    by: f64,
    /// How fast, rad/s
    #[arg(long, default_value_t = 0.5)]
    speed: f64,
    /// Keeps to the range and direction of this file
    #[arg(long)]
    calibration: Option<PathBuf>,
    /// Print how the servo is afterwards as one JSON object
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
    which: Which,
    /// The ids
    #[arg(long, value_delimiter = ',', required = true)]
    ids: Vec<u8>,
    /// Once, not until Ctrl-C
    #[arg(long)]
    once: bool,
    /// One JSON object a line
    #[arg(long)]
    json: bool,
}

fn say(text: &str) -> Result<(), ToolError> {
    let mut out = std::io::stdout();
    writeln!(out, "{text}").and_then(|()| out.flush()).map_err(|error| ToolError::Io("standard output".into(), error))
}

impl Which {
    fn open(&self) -> Result<Bus, ToolError> {
        let series = Protocol::named(&self.protocol).series();
        if let Err(known) = series.check_baud(self.baud) {
            return Err(ToolError::Refused(format!("--baud {}: {} has {known}", self.baud, series.name)));
        }
        Ok(Bus::open(&self.port, series.protocol, self.baud, tools::BUDGET, Box::new(monotonic_ns))?)
    }
}

/// Does it.
///
/// # Errors
/// One sentence for people.
pub fn run(tool: &Tool) -> Result<(), ToolError> {
    let signals = TerminationSignals::install().map_err(|error| ToolError::Io("signals".into(), error))?;
    let stop = || signals.received() != 0;
    match tool {
        Tool::Scan(scan) => find(scan, &stop),
        Tool::Calibrate(what) => calibrate(what),
        Tool::Jog(what) => {
            let calibration = what.calibration.as_deref().map(Calibration::load).transpose()?;
            let mut bus = what.which.open()?;
            let asked = Jog { id: what.id, by: what.by, speed: what.speed, calibration: calibration.as_ref() };
            let after = tools::jog(&mut bus, asked, pause, stop)?;
            say(&if what.json { serde_json::json!(after).to_string() } else { after.line() })
        }
        Tool::Watch(what) => watch(what, &stop),
    }
}

fn find(scan: &Scan, stop: &dyn Fn() -> bool) -> Result<(), ToolError> {
    let protocols = match &scan.protocol {
        Some(name) => vec![Protocol::named(name)],
        None => vec![Protocol::Dynamixel, Protocol::Feetech],
    };
    let mut all = Vec::new();
    let mut twins = None;
    for series in protocols.iter().map(|protocol| protocol.series()) {
        for &(baud, _) in series.bauds.iter().filter(|(baud, _)| scan.baud.is_none_or(|only| only == *baud)) {
            // A slow line needs its time besides: some thirty bytes there and back.
            let wire = 30 * 10 * 1_000_000_000 / u64::from(baud);
            let budget = BusBudget { read_ns: tools::SEARCH.read_ns + 2 * wire, ..tools::SEARCH };
            let mut bus = Bus::open(&scan.port, series.protocol, baud, budget, Box::new(monotonic_ns))?;
            for found in tools::scan(&mut bus, 0..=scan.max_id.min(series.max_id), stop) {
                let model = match (found.garbled, found.model) {
                    (true, _) => "cannot be read: two servos with this id?".to_owned(),
                    (false, Some(name)) => name.to_owned(),
                    (false, None) => format!("unknown model {}", found.number.unwrap_or(0)),
                };
                if found.garbled {
                    twins = Some(found.id);
                }
                if !scan.json {
                    say(&format!("{} at {baud} baud: servo {}, {model}", series.name, found.id))?;
                }
                all.push(serde_json::json!({ "protocol": series.protocol, "baud": baud, "servo": found }));
            }
        }
    }
    if scan.json {
        say(&serde_json::json!({ "servos": all }).to_string())?;
    }
    match (twins, all.is_empty()) {
        (Some(id), _) => Err(ToolError::Twins(id)),
        (None, true) => Err(ToolError::Nobody(format!(" at {}", scan.port))),
        (None, false) => Ok(()),
    }
}

fn calibrate(what: &Calibrate) -> Result<(), ToolError> {
    if !(0.01..=100.0).contains(&what.max_speed) {
        return Err(ToolError::Refused(format!("--max-speed {}: give 0.01 to 100 rad/s", what.max_speed)));
    }
    if what.out.exists() && !what.force {
        let text = format!("{}: the file is there already; give another --out, or --force", what.out.display());
        return Err(ToolError::Refused(text));
    }
    let mut bus = what.which.open()?;
    let mut input = std::io::stdin().lock();
    let mut ask: Box<dyn std::io::Write> =
        if what.json { Box::new(std::io::stderr()) } else { Box::new(std::io::stdout()) };
    let calibration = tools::calibrate(&mut bus, &what.ids, what.max_speed, &mut input, &mut ask)?;
    calibration.save(&what.out)?;
    match what.json {
        true => say(&serde_json::json!({ "file": what.out, "calibration": calibration }).to_string()),
        false => say(&format!("written to {}", what.out.display())),
    }
}

fn watch(what: &Watch, stop: &dyn Fn() -> bool) -> Result<(), ToolError> {
    let mut bus = what.which.open()?;
    tools::identify(&mut bus, &what.ids)?;
    while !stop() {
        for &id in &what.ids {
            let look = tools::look(&mut bus, id)?;
            say(&if what.json { serde_json::json!(look).to_string() } else { look.line() })?;
        }
        if what.once {
            break;
        }
        pause(200_000_000);
    }
    Ok(())
}
