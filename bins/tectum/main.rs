//! The `tectum` command: its subcommands, and the exit codes they share.

mod analyse;
mod bench;
mod compare;
mod doctor;
mod export;
mod film;
mod link;
mod log;
mod merge;
mod new;
mod policy;
mod replay;
mod report;
mod reproduce;
mod run;
mod scenario;
mod seeds;
mod sweep;
mod tasks;
mod tick_count;
mod watch;

use std::path::Path;
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use tectum::process::{print_error_line, print_result};
use tectum::runtime::exit;
use tectum::study::{StudyEnd, StudyError, continue_study};

/// A shared-memory control runtime in which the controller learns on line
#[derive(Debug, Parser)]
#[command(name = "tectum", version = tectum::BUILD, arg_required_else_help = true, after_help = "\
Examples:
  tectum run                            an arm learns to reach, as fast as the machine goes
  tectum run --mode realtime            the same on the real clock
  tectum watch                          see a run while it goes on
  tectum scenario list                  what else there is to run

Exit codes:
  0    all went well
  1    an error that no other code names
  2    bad input: arguments, scenario, folder, or a disk without room
  3    a process does not fit the run it was to join
  4    a process of the run failed or died
  129  ended by SIGHUP: the terminal was closed, or the connection was lost
  130  ended by Ctrl-C (SIGINT)
  131  ended by Ctrl-\\ (SIGQUIT)
  143  ended by SIGTERM")]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run a scenario: plant, controller and logger, each in its own process
    Run(run::Arguments),
    /// Run plant and controller on two machines (needs tectum-link)
    Link(link::Arguments),
    /// Watch a run while it goes on, in this terminal or in a browser
    Watch(watch::Arguments),
    /// Show what a run has learned, or write its policy into a file for others
    Policy(policy::Arguments),
    /// List the built-in scenarios, or print one to copy and change
    Scenario(scenario::Arguments),
    /// Make a small project for a plant or a controller of your own, in Rust or in Python
    New(new::Arguments),
    /// Run the paper's experiments again over several seeds, with the paper's figures and tables
    Reproduce(reproduce::Arguments),
    /// Analyse the movements in a run's log: isochrony, speed profiles, straightness, settling
    Analyse(analyse::Arguments),
    /// Make an animated picture of a run from its log: the arm at first, after ten seconds, and at the end
    Film(film::Arguments),
    /// Write a page with all that a run has left, or several runs side by side: figure, tables, movements, latency
    Report(report::Arguments),
    /// Compare the learners: how much experience each needs, and what one tick costs
    Compare(compare::Arguments),
    /// Run a scenario with all combinations of some settings, over seeds
    Sweep(sweep::Arguments),
    /// Put the parts of a study together that many processes or machines have run
    Merge(merge::Arguments),
    /// Measure the learners on many tasks, beside controllers that know the true plant
    Tasks(tasks::Arguments),
    /// Measure speed: latency, lockstep, encoder and learner, beside what the machine can do
    Bench(bench::Arguments),
    /// Compute a run again from its log, and check every bit of it
    Replay(replay::Arguments),
    /// Inspect a log, repair a torn one, or export it as a table
    Log(log::Arguments),
    /// Check whether this machine is fit for real time; remove what killed runs left in shared memory
    Doctor(doctor::Arguments),
}

fn main() -> ExitCode {
    match Arguments::parse().command {
        Command::Run(arguments) => run::main(&arguments),
        Command::Link(arguments) => link::main(&arguments),
        Command::Watch(arguments) => watch::main(&arguments),
        Command::Policy(arguments) => policy::main(&arguments),
        Command::Scenario(arguments) => scenario::main(&arguments),
        Command::New(arguments) => new::main(&arguments),
        Command::Reproduce(arguments) => reproduce::main(&arguments),
        Command::Analyse(arguments) => analyse::main(&arguments),
        Command::Film(arguments) => film::main(&arguments),
        Command::Report(arguments) => report::main(&arguments),
        Command::Compare(arguments) => compare::main(&arguments),
        Command::Sweep(arguments) => sweep::main(&arguments),
        Command::Merge(arguments) => merge::main(&arguments),
        Command::Tasks(arguments) => tasks::main(&arguments),
        Command::Bench(arguments) => bench::main(&arguments),
        Command::Replay(arguments) => replay::main(&arguments),
        Command::Log(arguments) => log::main(&arguments),
        Command::Doctor(arguments) => doctor::main(&arguments),
    }
}

/// Prints to standard output. What cannot be printed is no success.
fn print(text: &str) -> ExitCode {
    match print_result(text) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            print_error_line(&format!("tectum: standard output cannot be written: {error}"));
            ExitCode::from(exit::INPUT)
        }
    }
}

/// What a study prints: its result, JSON and text, or what a part of it has done.
fn study_output(end: StudyEnd<(String, String)>, json: bool) -> String {
    let (object, text) = match end {
        StudyEnd::Whole(both) => both,
        StudyEnd::Part(part) => (part.to_json(), part.to_text()),
    };
    if json { object + "\n" } else { text }
}

/// Goes on with the study in `folder`, which must be a `study`, and gives what it prints.
fn continued_output(folder: &Path, study: &str, json: bool) -> Result<String, StudyError> {
    let done = continue_study(folder, study, true)?;
    Ok(if json { done.json + "\n" } else { done.text })
}

/// Prints a study's result, or its error.
fn study_ended(result: Result<String, StudyError>) -> ExitCode {
    match result {
        Ok(text) => print(&text),
        Err(error) => {
            print_error_line(&format!("tectum: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}
