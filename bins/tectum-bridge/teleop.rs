//! `tectum-bridge teleop`: a run in which one arm follows another.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use tectum::process::{print_error_line, print_result};
use tectum::runtime::{Mode, exit};
use tectum::scenario::{JointMapping, Rearm, Scenario, ScenarioError};
use tectum::servo::model::Protocol;
use tectum::servo::tools::{Calibration, Teleop, TeleopArm, teleop_scenario};
use tectum::supervise::{Launch, LaunchError, run};

use super::Problem;

/// `teleop`.
#[derive(Debug, Args)]
#[command(after_help = "\
Joints are paired by the names in both calibrations (joint_1, joint_2, ... where there are none). Each joint of the
follower needs a leader, or is held with --hold. The leader's torque is off all the time. Until the follower has met the
leader it moves slowly. Every loss or fault of either arm turns the follower's torque off. Ctrl-C ends it, with torque
off. It is a run like any other: `tectum log info RUN`, `tectum replay RUN`.

Examples:
  tectum-bridge teleop /dev/ttyACM0 /dev/ttyACM1 --protocol feetech \\
    --leader-calibration leader.json --follower-calibration follower.json
  tectum-bridge teleop ... --print > mine.toml      the scenario of the run, to change it: tectum run mine.toml")]
pub struct Arguments {
    /// Serial port of the arm that is moved by hand
    leader: String,
    /// Serial port of the arm that follows
    follower: String,
    /// Protocol of the follower's servos
    #[arg(long, default_value = "feetech", value_parser = Protocol::NAMES)]
    protocol: String,
    /// Protocol of the leader's servos [default: as the follower's]
    #[arg(long, value_parser = Protocol::NAMES)]
    leader_protocol: Option<String>,
    /// Baud rate of both
    #[arg(long, default_value_t = 1_000_000)]
    baud: u32,
    /// Calibration of the leader: a file of `tectum-bridge calibrate`, or one of LeRobot's (.json)
    #[arg(long, value_name = "FILE")]
    leader_calibration: PathBuf,
    /// Calibration of the follower
    #[arg(long, value_name = "FILE")]
    follower_calibration: PathBuf,
    /// How an angle of the leader becomes one of the follower: its range is stretched to the follower's, or the
    /// angles are equal and clipped
    #[arg(long, default_value = "scale", value_parser = ["scale", "clip"])]
    mapping: String,
    /// Ids of the follower's joints that are held where they stand
    #[arg(long, value_delimiter = ',')]
    hold: Vec<u8>,
    /// Highest speed of a joint, rad/s; a lower one in the calibration counts
    #[arg(long, default_value_t = 3.0)]
    max_speed: f64,
    /// Highest speed of a joint until the follower has met the leader, rad/s
    #[arg(long, default_value_t = 0.5)]
    approach_speed: f64,
    /// Length of a tick, ms
    #[arg(long, default_value_t = 20.0)]
    period_ms: f64,
    /// Number of ticks; the default is an hour of them
    #[arg(long)]
    ticks: Option<u64>,
    /// How torque returns after a loss that is over: by itself, or not at all
    #[arg(long, default_value = "automatic", value_parser = ["automatic", "by-hand"])]
    rearm: String,
    /// Read both arms and move nothing
    #[arg(long)]
    unarmed: bool,
    /// Folder for log and reports [default: runs/teleop-N]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print the scenario of the run instead of running it
    #[arg(long)]
    print: bool,
    /// Print the summary as one JSON object
    #[arg(long)]
    json: bool,
}

/// Runs a teleoperation.
///
/// # Errors
/// A message and an exit code, when it cannot begin.
pub fn main(arguments: &Arguments) -> Result<ExitCode, Problem> {
    let bad = |error: ScenarioError| (error.to_string(), exit::INPUT);
    let (text, idle) = scenario(arguments)?;
    let plan = Scenario::parse(&text, "teleop").and_then(Scenario::plan).map_err(bad)?;
    if arguments.print {
        return printed(&text);
    }
    if !idle.is_empty() {
        print_error_line(&format!("tectum-bridge: joints of the leader that move nothing: {}", idle.join(", ")));
    }
    let launch = Launch {
        started_from: None,
        frozen: false,
        keep_checkpoints: 0,
        plan,
        mode: Mode::Realtime,
        out: arguments.out.clone(),
        name: None,
        by_hand: Vec::new(),
        checkpoint_every: 0,
        stopwatch: false,
        stand_in: None,
        resumed: None,
        progress: true,
    };
    let summary = run(&launch).map_err(|error: LaunchError| (error.to_string(), error.exit_code()))?;
    if let Some(failure) = &summary.failure {
        print_error_line(&format!("tectum-bridge: {failure}"));
    }
    let code = printed(&if arguments.json { summary.to_json() + "\n" } else { summary.to_text() })?;
    if summary.exit_code() == exit::OK { Ok(code) } else { Ok(ExitCode::from(summary.exit_code())) }
}

fn printed(text: &str) -> Result<ExitCode, Problem> {
    match print_result(text) {
        Ok(()) => Ok(ExitCode::SUCCESS),
        Err(error) => Err((format!("standard output cannot be written: {error}"), exit::INPUT)),
    }
}

/// The scenario of the run, and the names of the leader's joints that move nothing.
fn scenario(arguments: &Arguments) -> Result<(String, Vec<String>), Problem> {
    let bad = |text: String| (text, exit::INPUT);
    for (option, value) in [("--max-speed", arguments.max_speed), ("--approach-speed", arguments.approach_speed)] {
        if !(0.01..=100.0).contains(&value) {
            return Err(bad(format!("{option} {value}: give 0.01 to 100 rad/s")));
        }
    }
    if !(5.0..=1000.0).contains(&arguments.period_ms) {
        let text = format!("--period-ms {}: give 5 to 1000 ms; two arms are read in it", arguments.period_ms);
        return Err(bad(text));
    }
    let side = |port: &str, protocol: &str, file: &PathBuf| -> Result<TeleopArm, Problem> {
        let calibration =
            Calibration::load(file, Protocol::named(protocol)).map_err(|error| (error.to_string(), exit::INPUT))?;
        if calibration.protocol != Protocol::named(protocol) {
            let text = format!("{}: it is for servos of the other protocol than {protocol}", file.display());
            return Err((text, exit::INPUT));
        }
        Ok(TeleopArm { port: port.to_owned(), baud: arguments.baud, calibration })
    };
    let leader_protocol = arguments.leader_protocol.as_ref().unwrap_or(&arguments.protocol);
    let hour = (3_600_000.0 / arguments.period_ms) as u64;
    let teleop = Teleop {
        leader: side(&arguments.leader, leader_protocol, &arguments.leader_calibration)?,
        follower: side(&arguments.follower, &arguments.protocol, &arguments.follower_calibration)?,
        mapping: if arguments.mapping == "clip" { JointMapping::Clip } else { JointMapping::Scale },
        held: arguments.hold.clone(),
        max_speed: arguments.max_speed,
        approach_speed: arguments.approach_speed,
        period_ms: arguments.period_ms,
        ticks: arguments.ticks.unwrap_or(hour),
        rearm: if arguments.rearm == "by-hand" { Rearm::ByHand } else { Rearm::Automatic },
        armed: !arguments.unarmed,
    };
    teleop_scenario(&teleop).map_err(bad)
}
