//! `tectum policy`: what a run has learned, shown and given to others.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Subcommand};
use tectum::process::print_error_line;
use tectum::supervise::{LaunchError, LearnedState, PolicyFacts, export_policy};

use super::print;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  tectum policy show runs/arm-1                           inputs, outputs, maps and weights
  tectum policy export runs/arm-1 --out arm.safetensors   the weights, for other programs
  tectum run --from runs/arm-1 --freeze                   run what was learned, without learning")]
pub struct Arguments {
    #[command(subcommand)]
    work: Work,
}

#[derive(Debug, Subcommand)]
enum Work {
    /// Show what a run has learned: inputs, outputs, maps, and the size and hash of the weights
    #[command(after_help = "Example: tectum policy show runs/arm-1 --json")]
    Show {
        /// A run's folder, its name under runs/, or a checkpoint of its controller
        from: PathBuf,
        /// Print one JSON object instead of the table
        #[arg(long)]
        json: bool,
    },
    /// Write the weights of a linear policy into a safetensors file, with all that is needed to use them
    #[command(after_help = "Example: tectum policy export runs/arm-1 --out arm.safetensors")]
    Export {
        /// A run's folder, its name under runs/, or a checkpoint of its controller
        from: PathBuf,
        /// The file, which must not exist
        #[arg(long, value_name = "FILE", default_value = "policy.safetensors")]
        out: PathBuf,
        /// Print one JSON object instead of the table
        #[arg(long)]
        json: bool,
    },
}

pub fn main(arguments: &Arguments) -> ExitCode {
    match work(&arguments.work) {
        Ok(text) => print(&text),
        Err(error) => {
            print_error_line(&format!("tectum: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}

fn work(work: &Work) -> Result<String, LaunchError> {
    let (facts, json, written) = match work {
        Work::Show { from, json } => (PolicyFacts::of(&LearnedState::find(from)?)?, *json, None),
        Work::Export { from, out, json } => (export_policy(&LearnedState::find(from)?, out)?, *json, Some(out)),
    };
    if json {
        return Ok(facts.to_json() + "\n");
    }
    let written = written.map_or(String::new(), |out| format!("written  {}\n", out.display()));
    Ok(facts.to_text() + &written)
}
