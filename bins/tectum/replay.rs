//! `tectum replay`: a run's log, replayed and compared bit for bit.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, ValueEnum};
use tectum::log;
use tectum::process::print_error_line;
use tectum::runtime::exit;
use tectum::scenario::Rule;
use tectum::study::replay::{ReplayError, ReplayResult, replay};

use super::print;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  tectum run --ticks 2400                      a run with every tick in its log: `every = 1` under [log]
  tectum replay runs/arm-1                     the same learning again, checked bit for bit
  tectum replay log.mcap --json                one JSON object on standard output
  tectum replay runs/arm-1 --learner paper     and what the paper's rule makes of the same experience, off-policy

Ends with 1 if anything is not the same, and says what: tick, channel, field, both values.")]
pub struct Arguments {
    /// A log, or the folder of a run, or the run's name under runs/
    log: PathBuf,
    /// Give the same experience to another learner, too: its rule, under its preset
    #[arg(long, value_enum, value_name = "RULE")]
    learner: Option<RuleArgument>,
    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum RuleArgument {
    /// Daucé & Dutech 2010
    Paper,
    /// The same with a baseline
    Baseline,
    /// Actor-critic with eligibility traces
    ActorCritic,
    /// Its natural gradient
    NaturalActorCritic,
    /// Policy improvement through a learned model of the reward
    LearnedReward,
    /// Plans through learned models of movement and reward
    ModelPredictive,
}

impl RuleArgument {
    fn rule(self) -> Rule {
        match self {
            Self::Paper => Rule::Paper,
            Self::Baseline => Rule::Baseline,
            Self::ActorCritic => Rule::ActorCritic,
            Self::NaturalActorCritic => Rule::NaturalActorCritic,
            Self::LearnedReward => Rule::LearnedReward,
            Self::ModelPredictive => Rule::ModelPredictive,
        }
    }
}

pub fn main(arguments: &Arguments) -> ExitCode {
    match study(arguments) {
        Ok(result) => {
            let printed = print(&if arguments.json { result.to_json() + "\n" } else { result.to_text() });
            match result.failure() {
                Some(failure) => {
                    print_error_line(&format!("tectum: {failure}"));
                    ExitCode::from(exit::ERROR)
                }
                None => printed,
            }
        }
        Err(error) => {
            print_error_line(&format!("tectum: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}

fn study(arguments: &Arguments) -> Result<ReplayResult, ReplayError> {
    let log = log::find(&arguments.log)?;
    replay(&log, arguments.learner.map(RuleArgument::rule), true)
}
