//! The `main` function of every program that joins a run: arguments, error messages and exit codes. The
//! programs in `bins/`, and the program of your own plant, consist of this function and a loop of [`runtime`]. A
//! controller of your own is [`controller_main`].
//!
//! [`runtime`]: crate::runtime
//!
//! ```no_run
//! use std::process::ExitCode;
//! use tectum::{process, runtime::run_logger, wire::Role};
//!
//! fn main() -> ExitCode {
//!     process::main(Role::Logger, "Writes the log of a run", run_logger)
//! }
//! ```

use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{CommandFactory as _, FromArgMatches as _, Parser};
use serde::Serialize;

use crate::agent::{Agent, ShippedAgent};
use crate::runtime::{Participant, RuntimeError, exit, run_controller, serve_controller};
use crate::scenario::{Plan, ScenarioError};
use crate::wire::Role;

/// The command line of every process of a run.
#[derive(Debug, Parser)]
#[command(version = crate::BUILD)]
struct Arguments {
    /// The run to join: its folder, or its name under runs/
    #[arg(long, value_name = "RUN")]
    run: PathBuf,
    /// Read this scenario instead of the run's own copy; it must be the same
    #[arg(long, value_name = "FILE")]
    scenario: Option<PathBuf>,
    /// Print the process's report as one JSON object when its loop has ended
    #[arg(long)]
    json: bool,
}

/// Runs one process of a run: parses the command line, joins the run as `role`, and calls `work`. `about` is
/// one sentence for `--help`. On an error, prints it and returns its exit code ([`RuntimeError::exit_code`]).
pub fn main<R: Serialize>(
    role: Role,
    about: &'static str,
    work: impl FnOnce(Participant) -> Result<R, RuntimeError>,
) -> ExitCode {
    let command = Arguments::command().name(program()).about(about).after_help(example(role));
    let matches = command.get_matches();
    match Arguments::from_arg_matches(&matches) {
        Ok(arguments) => finish(&arguments, role, work),
        Err(error) => error.exit(),
    }
}

/// The examples in a process's help.
fn example(role: Role) -> String {
    format!(
        "A run's launcher starts this program by itself. To start it in a terminal of its own:\n  \
         tectum run --name demo --by-hand {role}\n  {program} --run demo",
        role = role.name(),
        program = program(),
    )
}

/// Joins the run, works, and reports.
fn finish<R: Serialize>(
    arguments: &Arguments,
    role: Role,
    work: impl FnOnce(Participant) -> Result<R, RuntimeError>,
) -> ExitCode {
    let result = Participant::take(&arguments.run, role, arguments.scenario.as_deref()).and_then(work);
    match result {
        Ok(report) if arguments.json => {
            let text = serde_json::to_string(&report).unwrap_or_default() + "\n";
            match print_result(&text) {
                Ok(()) => ExitCode::SUCCESS,
                Err(error) => {
                    print_error_line(&format!("{}: standard output cannot be written: {error}", program()));
                    ExitCode::from(exit::INPUT)
                }
            }
        }
        Ok(_) => ExitCode::SUCCESS,
        Err(error) => {
            print_error_line(&format!("{}: {error}", program()));
            ExitCode::from(error.exit_code())
        }
    }
}

/// Prints a program's result to standard output. A closed pipe is no error: its reader wanted no more. Anything else
/// is one, because a result that did not arrive is none.
///
/// # Errors
/// When standard output cannot be written, as on a full disk.
pub fn print_result(text: &str) -> std::io::Result<()> {
    let mut out = std::io::stdout();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => Err(error),
        _ => Ok(()),
    }
}

/// Makes an agent of a run's plan. It checks the scenario's `[learner]` by itself ([`Plan::learner_table`]).
pub type AgentBuilder = fn(&Plan) -> Result<Box<dyn Agent>, ScenarioError>;

/// The command line of a controller of your own.
#[derive(Debug, Parser)]
#[command(version = crate::BUILD)]
struct ControllerArguments {
    #[command(flatten)]
    run: Option<Arguments>,
    /// Serve a program that has started this one, on standard input and standard output: a run in one process, a
    /// replay or a study
    #[arg(long = "pipe", required_unless_present = "run", exclusive = true)]
    pipe: bool,
}

/// The `main` function of a controller of your own: a program that a scenario names under `[controller]`, with one or
/// more learners. Each has the name by which a scenario calls it (`[learner] rule`), and a function that makes its
/// agent. A scenario without that key gets the first one.
///
/// ```no_run
/// use tectum::agent::{Agent, Answer, Percept};
/// use tectum::process::controller_main;
/// use tectum::state::{Persist, StateVisitor};
///
/// /// Sends every output the first input, negated.
/// struct Proportional;
///
/// impl Persist for Proportional {
///     fn visit_state(&mut self, _visitor: &mut dyn StateVisitor) {}
/// }
///
/// impl Agent for Proportional {
///     fn act(&mut self, percept: &Percept, answer: &mut Answer) {
///         answer.command.fill(-percept.inputs[0]);
///     }
/// }
///
/// fn main() -> std::process::ExitCode {
///     controller_main(&[("proportional", |_plan| Ok(Box::new(Proportional)))])
/// }
/// ```
pub fn controller_main(agents: &[(&str, AgentBuilder)]) -> ExitCode {
    let names: Vec<&str> = agents.iter().map(|(name, _)| *name).collect();
    let about = format!("A controller for the runs of Tectum. Learners ([learner] rule): {}", names.join(", "));
    let command = ControllerArguments::command().name(program()).about(about).after_help(example(Role::Controller));
    let arguments = match ControllerArguments::from_arg_matches(&command.get_matches()) {
        Ok(arguments) => arguments,
        Err(error) => error.exit(),
    };
    let build = |plan: &Plan| build_agent(plan, agents);
    match arguments.run {
        Some(run) => finish(&run, Role::Controller, |participant| run_controller(participant, build)),
        None => ExitCode::from(serve_controller(build)),
    }
}

/// The agent that the scenario's `[learner] rule` names.
fn build_agent(plan: &Plan, agents: &[(&str, AgentBuilder)]) -> Result<Box<dyn Agent>, ScenarioError> {
    let names = || agents.iter().map(|(name, _)| format!("{name:?}")).collect::<Vec<_>>().join(", ");
    if plan.scenario.controller.is_shipped() {
        let problem = format!("is the program of this package, and this is {:?}; give its path", program());
        return Err(plan.scenario.invalid("controller.program", problem));
    }
    let table = plan.learner_table();
    let wanted = match table.table().get("rule") {
        None => None,
        Some(toml::Value::String(rule)) => Some(rule.as_str()),
        Some(other) => return Err(table.invalid("rule", format_args!("is {other}; give one of {}", names()))),
    };
    let found = agents.iter().find(|(name, _)| wanted.is_none_or(|wanted| wanted == *name));
    match found {
        Some((_, build)) => build(plan),
        None => {
            let wanted = wanted.unwrap_or_default();
            Err(table.invalid("rule", format_args!("is {wanted:?}; {} has {}", program(), names())))
        }
    }
}

/// The agent of the learner that the scenario of `plan` names: that of `tectum-controller`.
///
/// # Errors
///
/// When the scenario names another controller's program.
pub fn shipped_agent(plan: &Plan) -> Result<ShippedAgent, ScenarioError> {
    if plan.scenario.controller.is_shipped() {
        return Ok(plan.agent());
    }
    let (other, this) = (&plan.scenario.controller.program, program());
    let problem = format!("is {other:?}, and this is {this}; start that program in its place");
    Err(plan.scenario.invalid("controller.program", problem))
}

/// Writes a line to standard error. Unlike `eprintln!`, it does not panic when standard error cannot be written
/// (the disk is full, the reader of a pipe has closed it), so that the process still ends with its exit code.
pub fn print_error_line(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// The name under which the program was started.
fn program() -> String {
    let path = std::env::args_os().next().map(PathBuf::from).unwrap_or_default();
    path.file_name().map_or_else(|| "tectum".to_owned(), |name| name.to_string_lossy().into_owned())
}
