//! `tectum reproduce`: the experiments of the paper.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Subcommand};
use tectum::study::reproduce::{ReproduceSettings, arm, eye, open_loop, outlook};
use tectum::study::{StudyError, StudyPlace};

use super::seeds::SeedsArgument;
use super::tick_count::tick_count;
use super::{continued_output, study_ended, study_output};

#[derive(Debug, Args)]
#[command(
    after_help = "\
Examples:
  tectum reproduce arm                      figure 4: 5 seeds of 12 million ticks, about a minute
  tectum reproduce arm --seeds 2 --ticks 1000000 --json
  tectum reproduce eye                      figure 2: four eyes, 3 million trials each
  tectum reproduce open-loop --seeds 7      3 and 4 segments: how many ways there are
  tectum reproduce arm --seeds 1..3 --part a.jsonl
                                            a part of an experiment; see tectum merge
  tectum reproduce --continue runs/reproduce-arm-1
                                            go on with one that was interrupted",
    args_conflicts_with_subcommands = true,
    arg_required_else_help = true
)]
pub struct Arguments {
    #[command(subcommand)]
    experiment: Option<Experiment>,
    /// Go on with an experiment that was interrupted, in its folder
    #[arg(long, value_name = "DIR")]
    r#continue: Option<PathBuf>,
    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Subcommand)]
enum Experiment {
    /// The closed-loop arm, section 4.2 and figure 4: 12 million ticks, joint 3 blocked at 9.3 million
    #[command(after_help = "Example: tectum reproduce arm --seeds 2 --ticks 1000000 --json")]
    Arm(Options),
    /// The saccades, section 4.1 and figure 2: linear and log-polar retina, scalar and topographic inputs
    #[command(after_help = "Example: tectum reproduce eye --seeds 2 --ticks 300000")]
    Eye(Options),
    /// The open-loop arm, section 4.2: 3 and 4 segments, and how the postures found differ between seeds
    #[command(after_help = "Example: tectum reproduce open-loop --seeds 7")]
    OpenLoop(Options),
    /// The outlook, section 5: limited joints, relative angles, collisions, rewards, L1 noise, and the
    /// movements' shape
    #[command(after_help = "Example: tectum reproduce outlook --seeds 3")]
    Outlook(Options),
}

#[derive(Debug, Args)]
struct Options {
    /// Number of seeds, run side by side on all cores, or a range A..B, in which B is not
    #[arg(long, value_name = "N|A..B", default_value = "5")]
    seeds: SeedsArgument,
    /// The first seed; the others follow
    #[arg(long, value_name = "S", default_value_t = 1)]
    first_seed: u64,
    /// Ticks (or trials) of each run, in place of the paper's
    #[arg(long, value_name = "N", value_parser = tick_count, allow_negative_numbers = true)]
    ticks: Option<u64>,
    /// Folder for figure and tables [default: runs/reproduce-<experiment>-<n>]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Only keep the runs, in this file; the same command goes on with it, and `tectum merge` puts parts together
    #[arg(long, value_name = "FILE", conflicts_with = "out")]
    part: Option<PathBuf>,
    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

pub fn main(arguments: &Arguments) -> ExitCode {
    study_ended(run(arguments))
}

fn run(arguments: &Arguments) -> Result<String, StudyError> {
    let Some(experiment) = &arguments.experiment else {
        let none = || StudyError::Asked("name an experiment: arm, eye, open-loop or outlook".to_owned());
        return continued_output(arguments.r#continue.as_deref().ok_or_else(none)?, "reproduce", arguments.json);
    };
    let (options, end) = match experiment {
        Experiment::Arm(options) => (options, arm(&options.settings()?)?.map(|r| (r.to_json(), r.to_text()))),
        Experiment::Eye(options) => (options, eye(&options.settings()?)?.map(|r| (r.to_json(), r.to_text()))),
        Experiment::OpenLoop(options) => {
            (options, open_loop(&options.settings()?)?.map(|r| (r.to_json(), r.to_text())))
        }
        Experiment::Outlook(options) => (options, outlook(&options.settings()?)?.map(|r| (r.to_json(), r.to_text()))),
    };
    Ok(study_output(end, options.json))
}

impl Options {
    fn settings(&self) -> Result<ReproduceSettings, StudyError> {
        Ok(ReproduceSettings {
            seeds: self.seeds.range(self.first_seed)?,
            ticks: self.ticks,
            out: self.out.clone(),
            place: self.part.clone().map_or(StudyPlace::Folder, StudyPlace::Part),
            progress: true,
        })
    }
}
