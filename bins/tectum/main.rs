//! The user's command. Every mode and every exit code passes through here.

mod analyse;
mod bench;
mod compare;
mod doctor;
mod film;
mod log;
mod replay;
mod reproduce;
mod run;

use std::io::Write as _;
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use tectum::process::say;
use tectum::study::StudyError;

/// A shared-memory control runtime in which the controller learns on line
#[derive(Debug, Parser)]
#[command(name = "tectum", version = tectum::BUILD, arg_required_else_help = true, after_help = "\
Example: tectum run                    the arm learns to reach, as fast as the machine goes

Exit codes:
  0    all went well
  1    an error that no other code names
  2    bad input: arguments, scenario, folder, or a disk without room
  3    a process does not fit the run it was to join
  4    a process of the run failed or died
  130  ended by Ctrl-C (SIGINT)
  143  ended by SIGTERM")]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run a scenario: plant, controller and logger as processes of their own
    Run(run::Arguments),
    /// Run the paper's experiments again, over several seeds, and show what came out as the paper does
    Reproduce(reproduce::Arguments),
    /// Analyse the movements in a run's log: isochrony, speed profiles, straightness, settling
    Analyse(analyse::Arguments),
    /// Make an animated picture of a run from its log: the arm at first, after ten seconds, and at the end
    Film(film::Arguments),
    /// Learners side by side: how much experience each needs, and what a tick of it costs
    Compare(compare::Arguments),
    /// How fast it is: latency, lockstep, encoder, learner, beside what the machine can do
    Bench(bench::Arguments),
    /// Do a run again from its log, and check every bit that it says
    Replay(replay::Arguments),
    /// Look into a log, make a torn one whole, or export it
    Log(log::Arguments),
    /// Look whether this machine is fit for real time, and remove what killed runs have left
    Doctor(doctor::Arguments),
}

fn main() -> ExitCode {
    match Arguments::parse().command {
        Command::Run(arguments) => run::main(&arguments),
        Command::Reproduce(arguments) => reproduce::main(&arguments),
        Command::Analyse(arguments) => analyse::main(&arguments),
        Command::Film(arguments) => film::main(&arguments),
        Command::Compare(arguments) => compare::main(&arguments),
        Command::Bench(arguments) => bench::main(&arguments),
        Command::Replay(arguments) => replay::main(&arguments),
        Command::Log(arguments) => log::main(&arguments),
        Command::Doctor(arguments) => doctor::main(&arguments),
    }
}

/// Prints to standard output. Whoever reads may have left; what is printed is in the command's folder all the same.
fn print(text: &str) {
    let _ = std::io::stdout().write_all(text.as_bytes());
}

/// Prints what a study gave, or why it gave nothing.
fn study_ended(result: Result<String, StudyError>) -> ExitCode {
    match result {
        Ok(text) => {
            print(&text);
            ExitCode::SUCCESS
        }
        Err(error) => {
            say(&format!("tectum: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}
