//! `tectum run`.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Args, ValueEnum};
use tectum::process::print_error_line;
use tectum::runtime::{Mode, ResumePoint, exit};
use tectum::scenario::limits::ENDLESS;
use tectum::scenario::{Plan, Scenario};
use tectum::supervise::{Launch, LaunchError, LearnedState, ResumedRun, RunSummary, resume, run, run_in_process};
use tectum::watch::{WatchError, WatchedRun, end_with_parent, launch_and_watch, serve_metrics_of_own_run};
use tectum::wire::Role;

use super::print;
use super::tick_count::tick_count;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  tectum run                                   the built-in scenario arm, in lockstep
  tectum run paper --seed 7 --ticks 1e6        another scenario, seed and length
  tectum run --mode realtime --ticks 200       ten seconds on the real clock
  tectum run --watch                           see it while it goes on
  tectum run --metrics 9417                    metrics for Prometheus: http://127.0.0.1:9417/metrics
  tectum run --name demo --by-hand controller  wait for a controller that you start yourself
  tectum run --resume runs/arm-1               continue an interrupted run
  tectum run --resume runs/arm-1 --ticks 7200  and one that came to its end, up to another tick
  tectum run arm --seed 2 --from runs/arm-1    a new run that begins with what another one has learned
  tectum run --from runs/arm-1 --freeze        run what was learned, without learning and exploring")]
pub struct Arguments {
    /// A scenario file, or the name of a built-in one (tectum scenario list) [default: arm; with --from, that of the
    /// other run]
    scenario: Option<PathBuf>,
    /// How ticks follow each other [default: lockstep; realtime for servos]
    #[arg(long, value_enum)]
    mode: Option<ModeArgument>,
    /// Number of ticks, such as 3600, 1_000_000 or 1e6, or `endless`, in place of the scenario's
    #[arg(long, value_name = "N", value_parser = run_length, allow_negative_numbers = true)]
    ticks: Option<u64>,
    /// Seed, in place of the scenario's
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    /// Folder for log, figure and reports [default: runs/<scenario>-<n>]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Name of the run: its folder is runs/<NAME>
    #[arg(long, value_name = "NAME", conflicts_with = "out", value_parser = run_name)]
    name: Option<String>,
    /// A process that you start yourself; may be repeated
    #[arg(long, value_enum, value_name = "PROCESS")]
    by_hand: Vec<RoleArgument>,
    /// Write a checkpoint every N ticks; one is written at the end in any case, and on SIGUSR1
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = tick_count, allow_negative_numbers = true)]
    checkpoint_every: u64,
    /// Keep only the last N checkpoints of each process, at least 2; 0: all
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = kept_count)]
    keep_checkpoints: u64,
    /// Continue a lockstep run from its last checkpoint, in a new folder; with --ticks up to another tick
    #[arg(long, value_name = "RUN", conflicts_with_all = ["scenario", "mode", "seed"])]
    resume: Option<PathBuf>,
    /// Watch the run in this terminal while it goes on (tectum watch)
    #[arg(long)]
    watch: bool,
    /// Serve metrics in Prometheus' text format at this address (PORT or HOST:PORT), under /metrics, as long as the run
    /// goes on; other addresses than this machine's own need a token, which the printed link has
    #[arg(long, value_name = "ADDR")]
    metrics: Option<String>,
    /// Begin with what another run has learned: its folder, its name, or a checkpoint of its controller. The plant, the
    /// mode and the seed may be others; inputs, outputs and learner must be the same
    #[arg(long, value_name = "RUN|CHECKPOINT", conflicts_with = "resume")]
    from: Option<PathBuf>,
    /// Neither learn nor explore: every command is the policy's mean
    #[arg(long, requires = "from")]
    freeze: bool,
    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
    /// The watcher that has started this launcher
    #[arg(long, value_name = "PID", hide = true)]
    watched_by: Option<u32>,
}

/// The scenario of a run for which none is named.
const DEFAULT_SCENARIO: &str = "scenarios/arm.toml";

#[derive(Debug, Clone, Copy, ValueEnum)]
enum ModeArgument {
    /// As fast as the processes go
    Lockstep,
    /// At the scenario's period on the real clock
    Realtime,
    /// Plant and controller in one process, without log
    InProcess,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum RoleArgument {
    Plant,
    Controller,
    Logger,
}

/// A number of ticks, or `endless`.
fn run_length(text: &str) -> Result<u64, String> {
    if text == "endless" { Ok(ENDLESS) } else { tick_count(text) }
}

/// A number of checkpoints to keep. With one alone, plant and controller would have none of the same tick while one of
/// them has written the next.
fn kept_count(text: &str) -> Result<u64, String> {
    match text.parse() {
        Ok(1) | Err(_) => Err("give 2 or more, or 0 for all".to_owned()),
        Ok(count) => Ok(count),
    }
}

/// A run's name is a folder's name and nothing more.
fn run_name(text: &str) -> Result<String, String> {
    let fine = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_');
    if !text.is_empty() && text.len() <= 64 && text.chars().all(fine) {
        Ok(text.to_owned())
    } else {
        Err("give up to 64 letters, digits, - and _".to_owned())
    }
}

pub fn main(arguments: &Arguments) -> ExitCode {
    if arguments.watch {
        return watch(arguments);
    }
    if arguments.watched_by.is_some_and(|parent| !end_with_parent(parent)) {
        return ExitCode::from(exit::TERMINATED);
    }
    if let Some(address) = &arguments.metrics {
        let served = if in_process(arguments) { Err(refused("--metrics")) } else { serve_metrics(address) };
        if let Err(code) = served {
            return code;
        }
    }
    match launch(arguments) {
        Ok(summary) => {
            let printed = show(&summary, arguments.json);
            if summary.exit_code() == exit::OK { printed } else { ExitCode::from(summary.exit_code()) }
        }
        Err(error) => {
            print_error_line(&format!("tectum: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}

fn in_process(arguments: &Arguments) -> bool {
    matches!(arguments.mode, Some(ModeArgument::InProcess))
}

/// Refuses what needs the memory that the processes of a run share.
fn refused(flag: &str) -> ExitCode {
    print_error_line(&format!(
        "tectum: a run in one process cannot be watched; leave out {flag}, or use another --mode"
    ));
    ExitCode::from(exit::INPUT)
}

/// Serves metrics of the run that is about to begin, and says where.
fn serve_metrics(address: &str) -> Result<(), ExitCode> {
    match serve_metrics_of_own_run(address) {
        Ok(link) => {
            print_error_line(&format!("tectum: metrics are at {link}"));
            Ok(())
        }
        Err(error) => {
            print_error_line(&format!("tectum: {error}"));
            Err(ExitCode::from(error.exit_code()))
        }
    }
}

/// Launches the run in a process of its own, watches it, and prints what that printed.
fn watch(arguments: &Arguments) -> ExitCode {
    if in_process(arguments) {
        return refused("--watch");
    }
    let mut own: Vec<OsString> = std::env::args_os().skip(1).filter(|argument| argument != "--watch").collect();
    own.extend(["--watched-by".into(), std::process::id().to_string().into()]);
    let program = std::env::current_exe().map_err(WatchError::Launcher);
    match program.and_then(|program| launch_and_watch(&program, &own)) {
        Ok(WatchedRun { code, stdout, stderr }) => {
            stderr.lines().for_each(print_error_line);
            let printed = print(&stdout);
            if code == exit::OK { printed } else { ExitCode::from(code) }
        }
        Err(error) => {
            print_error_line(&format!("tectum: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}

fn launch(arguments: &Arguments) -> Result<RunSummary, LaunchError> {
    let launch = plan(arguments)?;
    for warning in &launch.plan.warnings {
        print_error_line(&format!("tectum: warning: {warning}"));
    }
    match launch.mode {
        Mode::InProcess => run_in_process(&launch),
        Mode::Lockstep | Mode::Realtime => run(&launch),
    }
}

/// Turns the arguments into a launch. Every check that needs no started process happens here.
fn plan(arguments: &Arguments) -> Result<Launch, LaunchError> {
    let Beginning { plan, resumed, started_from, frozen } = beginning(arguments)?;
    let servos = plan.scenario.plant.servos.is_some();
    // Emulated servos can be part of the bridge's process, on a clock that the ticks step.
    let emulated = plan.scenario.plant.has_virtual_servos();
    let mode = match arguments.mode {
        None if servos => Mode::Realtime,
        None | Some(ModeArgument::Lockstep) => Mode::Lockstep,
        Some(ModeArgument::Realtime) => Mode::Realtime,
        Some(ModeArgument::InProcess) => Mode::InProcess,
    };
    if servos && mode != Mode::Realtime && !(emulated && mode == Mode::Lockstep) {
        return Err(LaunchError::OnlyRealtime(mode.name()));
    }
    Ok(Launch {
        plan,
        checkpoint_every: arguments.checkpoint_every,
        keep_checkpoints: arguments.keep_checkpoints,
        stopwatch: false,
        stand_in: None,
        resumed,
        started_from,
        frozen,
        mode,
        out: arguments.out.clone(),
        name: arguments.name.clone(),
        by_hand: arguments
            .by_hand
            .iter()
            .map(|role| match role {
                RoleArgument::Plant => Role::Plant,
                RoleArgument::Controller => Role::Controller,
                RoleArgument::Logger => Role::Logger,
            })
            .collect(),
        progress: arguments.watched_by.is_none(),
    })
}

/// What a run begins with.
struct Beginning {
    plan: Plan,
    resumed: Option<ResumePoint>,
    started_from: Option<LearnedState>,
    frozen: bool,
}

fn beginning(arguments: &Arguments) -> Result<Beginning, LaunchError> {
    if let Some(run) = &arguments.resume {
        let ResumedRun { point, plan, started_from, frozen } = resume(run, arguments.ticks)?;
        return Ok(Beginning { plan, resumed: Some(point), started_from, frozen });
    }
    let started_from = arguments.from.as_deref().map(LearnedState::find).transpose()?;
    let mut scenario = match (&arguments.scenario, &started_from) {
        (Some(given), _) => Scenario::find(given)?,
        (None, Some(learned)) => learned.plan().scenario.clone(),
        (None, None) => Scenario::find(Path::new(DEFAULT_SCENARIO))?,
    };
    scenario.ticks = arguments.ticks.unwrap_or(scenario.ticks);
    scenario.seed = arguments.seed.unwrap_or(scenario.seed);
    let mut plan = scenario.plan()?;
    if let Some(learned) = &started_from {
        plan.warnings.extend(learned.check(&plan)?);
    }
    Ok(Beginning { plan, resumed: None, started_from, frozen: arguments.freeze })
}

fn show(summary: &RunSummary, json: bool) -> ExitCode {
    if let Some(failure) = &summary.failure {
        print_error_line(&format!("tectum: {failure}"));
    }
    print(&if json { summary.to_json() + "\n" } else { summary.to_text() })
}
