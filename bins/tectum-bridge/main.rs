//! `tectum-bridge`: the plant on serial-bus servos, the tools that find, calibrate, move and show servos, and
//! the guard that turns torque off after a bridge was killed.

mod guard;
mod teleop;
mod tools;

use std::io::{BufRead as _, IsTerminal as _, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};

use clap::{Parser, Subcommand};
use tectum::channel::VisionReceiver;
use tectum::clock::{monotonic_ns, pause, suspended_ns};
use tectum::process::print_error_line;
use tectum::runtime::{Mode, Participant, RuntimeError, exit, run_plant};
use tectum::scenario::ServosConfig;
use tectum::servo::bridge::{Bridge, BridgeError, TripCause, joints_of};
use tectum::servo::bus::{Bus, BusBudget, BusError, latency_advice};
use tectum::servo::emulator::{EmulatedChain, EmulatedPort, SteppedClock};
use tectum::servo::guard::{Guard, GuardSettings};
use tectum::servo::model::Protocol;
use tectum::wire::Role;

const EXAMPLE: &str = "A run's launcher starts this program by itself, for a scenario with [plant.servos]. \
    In a terminal of its own:\n  \
    tectum run scenarios/servo-emulated.toml --name demo --by-hand plant\n  tectum-bridge --run demo\n\
    There, a and Enter arm it. Without hardware and without a run:\n  \
    tectum-servo-emulator --protocol feetech --link /tmp/arm &\n  \
    tectum-bridge scan --port /tmp/arm --protocol feetech --baud 1000000\n\
     Angles are measured; the end-effector, and with it the reward, is worked out from them by the model \
    in [plant.arm]; it is not measured.";

/// The plant on serial-bus servos: read-only until it is armed
#[derive(Debug, Parser)]
#[command(version = tectum::BUILD, after_help = EXAMPLE)]
struct Arguments {
    #[command(subcommand)]
    tool: Option<Tool>,
    /// The run to join: its folder, or its name under runs/
    #[arg(long, value_name = "RUN")]
    run: Option<PathBuf>,
    /// Read this scenario instead of the run's own copy; it must be the same
    #[arg(long, value_name = "FILE")]
    scenario: Option<PathBuf>,
    /// Let torque go on, with the first command and after all checks
    #[arg(long)]
    arm: bool,
    /// Print the process's report as one JSON object when its loop is over
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Subcommand)]
enum Tool {
    #[command(flatten)]
    Tool(tools::Tool),
    /// Let one arm follow another that is moved by hand
    Teleop(teleop::Arguments),
    /// Turns torque off when another process has ended; bridges start it for themselves
    #[command(hide = true)]
    Guard(guard::Arguments),
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let (text, code) = match &arguments.tool {
        Some(Tool::Guard(of)) => return guard::run(of),
        Some(Tool::Teleop(arguments)) => match teleop::main(arguments) {
            Ok(code) => return code,
            Err(problem) => problem,
        },
        Some(Tool::Tool(tool)) => match tools::run(tool) {
            Ok(()) => return ExitCode::SUCCESS,
            Err(error) => (error.to_string(), if error.is_bad_input() { exit::INPUT } else { exit::PROCESS }),
        },
        None => match run_bridge(&arguments) {
            Ok(()) => return ExitCode::SUCCESS,
            Err(problem) => problem,
        },
    };
    print_error_line(&format!("tectum-bridge: {text}"));
    ExitCode::from(code)
}

/// A message and an exit code.
type Problem = (String, u8);

/// Runs the bridge as the plant of a run.
fn run_bridge(arguments: &Arguments) -> Result<(), Problem> {
    let bad = |text: String| (text, exit::INPUT);
    let failed = |text: String| (text, exit::PROCESS);
    let own = |error: RuntimeError| (error.to_string(), error.exit_code());
    let Some(run) = &arguments.run else {
        return Err(bad("no run is named; give --run, or let `tectum run` start this program".to_owned()));
    };
    let participant = Participant::take(run, Role::Plant, arguments.scenario.as_deref()).map_err(own)?;
    let joints = joints_of(&participant.plan).map_err(|error| of_bridge("", error))?;
    let Some(config) = participant.plan.scenario.plant.servos.clone() else {
        return Err(bad("the scenario has no [plant.servos]".to_owned()));
    };
    let ids: Vec<u8> = joints.iter().map(|joint| joint.id).collect();
    // The emulator ends with this function, after the bridge, which `run_plant` drops.
    let Connection { emulator: _emulator, bus, guard, clock } = connect(&participant, &config, ids)?;
    let tell = Box::new(|text: &str| print_error_line(&format!("tectum-bridge: {text}")));
    let mut bridge = Bridge::new(&participant.plan, bus, joints, tell).map_err(|error| of_bridge("", error))?;
    if let Some(guard) = guard {
        attach(&mut bridge, guard);
    }
    if config.port == "emulator" {
        bridge.set_port_ends_with_run();
    }
    if let Some(clock) = clock {
        bridge.set_virtual_time(clock);
    }
    if let Some(leader) = &participant.plan.scenario.plant.leader {
        let of_leader = |error: BridgeError| of_bridge("the leader: ", error);
        let bus = open_bus(&leader.port, leader.protocol, leader.baud, Bridge::budget(&participant.plan));
        bus.map_err(BridgeError::from).and_then(|bus| bridge.set_leader(bus)).map_err(of_leader)?;
    }
    let ending = bridge.ending();
    bridge.write_report_to(participant.folder.join("bridge.json"));
    if arguments.arm || config.armed {
        bridge.arm_patiently().map_err(|error| of_bridge("not armed: ", error))?;
    } else {
        print_error_line(
            "tectum-bridge: read-only; --arm, armed = true under [plant.servos], \
             or a and Enter at its own terminal arm it",
        );
    }
    listen_to_trackers(&participant, &mut bridge).map_err(own)?;
    arm_from_terminal(&bridge);
    let report = run_plant(participant, bridge).map_err(own)?;
    if arguments.json {
        let _ = writeln!(std::io::stdout(), "{}", serde_json::to_string(&report).unwrap_or_default());
    }
    let ending = ending.lock().ok().and_then(|ending| *ending);
    match ending.filter(|cause| *cause != TripCause::CommandsAway) {
        Some(cause) if cause.leaves_torque_unknown() => {
            Err(failed(format!("torque may still have been on when the run ended: {cause}")))
        }
        Some(cause) => Err(failed(format!("torque was off when the run ended: {cause}"))),
        None => Ok(()),
    }
}

/// The message and the exit code of an error of the bridge.
fn of_bridge(what: &str, error: BridgeError) -> Problem {
    (format!("{what}{error}"), if error.is_configuration() { exit::INPUT } else { exit::PROCESS })
}

/// The bus of a run's servos, and what belongs to it.
struct Connection {
    emulator: Option<Helper>,
    bus: Bus,
    /// In real time: the guard.
    guard: Option<Guard>,
    /// In lockstep: the clock of the emulated servos.
    clock: Option<SteppedClock>,
}

/// Connects to the servos with these ids: through the port, to emulated ones behind a terminal, or, in lockstep, to
/// emulated ones in this process.
fn connect(participant: &Participant, config: &ServosConfig, ids: Vec<u8>) -> Result<Connection, Problem> {
    let failed = |text: String| (text, exit::PROCESS);
    if participant.manifest.mode == Mode::Lockstep {
        return connect_in_process(participant, config, &ids);
    }
    let (emulator, port) = match config.port.as_str() {
        "emulator" => {
            let (child, port) =
                start_emulator(&participant.folder, config.protocol, config.baud, &ids).map_err(failed)?;
            (Some(child), port)
        }
        port => (None, port.to_owned()),
    };
    let bus = open_bus(&port, config.protocol, config.baud, Bridge::budget(&participant.plan))
        .map_err(|error| of_bridge("", error.into()))?;
    if let Some(advice) = latency_advice(&port) {
        print_error_line(&format!("tectum-bridge: {advice}"));
    }
    let period_ns = participant.plan.period_ns;
    let guard = GuardSettings { port, protocol: config.protocol, baud: config.baud, ids, period_ns };
    let guard = guard::start(&guard).map_err(failed)?;
    Ok(Connection { emulator, bus, guard: Some(guard), clock: None })
}

/// Connects to emulated servos in this process, whose clock the ticks step.
fn connect_in_process(participant: &Participant, config: &ServosConfig, ids: &[u8]) -> Result<Connection, Problem> {
    if !participant.plan.scenario.plant.has_virtual_servos() {
        return Err(("servos that are not emulated run in real time only".to_owned(), exit::INPUT));
    }
    if participant.folder.join("bridge.json").exists() {
        let text = "the emulated servos of a lockstep run were part of the bridge that has died, and their positions \
                    are lost; start the run again";
        return Err((text.to_owned(), exit::INPUT));
    }
    let plan = &participant.plan;
    let settings = plan.scenario.plant.emulator.clone().unwrap_or_default();
    let chain = EmulatedChain::new(config.protocol, ids, config.baud, &settings, plan.scenario.seed);
    let clock = SteppedClock::default();
    let port = EmulatedPort::new(Arc::new(Mutex::new(chain)), clock.clone(), config.baud);
    let now = clock.clone();
    let bus = Bus::over(Box::new(port), config.protocol, Bridge::budget(plan), Box::new(move || now.now()));
    Ok(Connection { emulator: None, bus, guard: None, clock: Some(clock) })
}

/// Opens the channel of trackers, if the scenario has them.
fn listen_to_trackers(participant: &Participant, bridge: &mut Bridge) -> Result<(), RuntimeError> {
    if participant.plan.scenario.vision().is_none() {
        return Ok(());
    }
    let mut receiver = VisionReceiver::open(
        &participant.manifest.domain,
        &participant.identity(),
        &participant.plan.scenario.channels,
    )
    .map_err(RuntimeError::from)?;
    bridge.set_vision_source(Box::new(move || receiver.receive()));
    print_error_line(
        "tectum-bridge: target and end-effector come from a tracker; until it is there the arm stands still",
    );
    Ok(())
}

/// Connects the bridge with its guard, with the machine's clocks, and with the end of this process.
fn attach(bridge: &mut Bridge, mut guard: Guard) {
    bridge.set_guard(Box::new(move |torque| guard.beat(torque)));
    bridge.set_sleep_clock(Box::new(suspended_ns));
    bridge.set_give_up(Box::new(|text| {
        print_error_line(&format!("tectum-bridge: {text}"));
        // As if it had been killed: the launcher decides whether it starts the bridge again.
        std::process::exit(i32::from(exit::PROCESS));
    }));
}

/// Opens the port. Retries for half a second, because the guard of a killed bridge or `jog` may use the port to turn
/// torque off.
///
/// # Errors
/// As for [`Bus::open`].
fn open_bus(port: &str, protocol: Protocol, baud: u32, budget: BusBudget) -> Result<Bus, BusError> {
    let deadline = monotonic_ns() + 500_000_000;
    loop {
        match Bus::open(port, protocol, baud, budget, Box::new(monotonic_ns)) {
            Err(BusError::Busy(_)) if monotonic_ns() < deadline => pause(20_000_000),
            opened => return opened,
        }
    }
}

/// Requests arming when the user types a and Enter at the terminal.
fn arm_from_terminal(bridge: &Bridge) {
    if !std::io::stdin().is_terminal() {
        return;
    }
    let request = bridge.arm_request();
    std::thread::spawn(move || {
        for line in std::io::stdin().lock().lines().map_while(Result::ok) {
            if line.trim() == "a" {
                request.store(true, Ordering::Relaxed);
            }
        }
    });
}

/// A child process that is killed when this value is dropped.
struct Helper(Child);

impl Helper {
    fn start(command: &mut Command) -> Result<Self, String> {
        let name = command.get_program().to_string_lossy().into_owned();
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        command.spawn().map(Self).map_err(|error| format!("{name} cannot be started: {error}"))
    }
}

impl Drop for Helper {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Starts the emulated chain of the run's scenario, and returns the process and its port.
fn start_emulator(folder: &Path, protocol: Protocol, baud: u32, ids: &[u8]) -> Result<(Helper, String), String> {
    let beside = std::env::current_exe().map_err(|error| format!("this program has no place: {error}"))?;
    let link = folder.join(format!("servos.{}", std::process::id()));
    let ids: Vec<_> = ids.iter().map(u8::to_string).collect();
    let mut command = Command::new(beside.with_file_name("tectum-servo-emulator"));
    command.args(["--protocol", protocol.name(), "--baud", &baud.to_string(), "--ids", &ids.join(",")]);
    command.arg("--link").arg(&link).arg("--scenario").arg(folder.join("scenario.toml"));
    command.args(["--parent", &std::process::id().to_string()]);
    let mut child = Helper::start(&mut command)?;
    let deadline = monotonic_ns() + 5_000_000_000;
    while !link.exists() {
        if let Ok(Some(status)) = child.0.try_wait() {
            return Err(format!("tectum-servo-emulator has ended at once ({status}); start it by hand to see why"));
        }
        if monotonic_ns() > deadline {
            return Err("tectum-servo-emulator opens no terminal".to_owned());
        }
        pause(2_000_000);
    }
    Ok((child, link.display().to_string()))
}
