//! `tectum reproduce`: the experiments of the paper.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Subcommand};
use tectum::study::reproduce::{ReproduceSettings, arm, eye, open_loop, outlook};

use super::study_ended;
use super::tick_count::tick_count;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  tectum reproduce arm                      figure 4: 5 seeds of 12 million ticks, about a minute
  tectum reproduce arm --seeds 2 --ticks 1000000 --json
  tectum reproduce eye                      figure 2: four eyes, 3 million trials each
  tectum reproduce open-loop --seeds 7      3 and 4 segments: how many ways there are")]
pub struct Arguments {
    #[command(subcommand)]
    experiment: Experiment,
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
    /// Number of seeds, run side by side on all cores
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    seeds: u64,
    /// The first seed; the others follow
    #[arg(long, value_name = "S", default_value_t = 1)]
    first_seed: u64,
    /// Ticks (or trials) of each run, in place of the paper's
    #[arg(long, value_name = "N", value_parser = tick_count, allow_negative_numbers = true)]
    ticks: Option<u64>,
    /// Folder for figure and tables [default: runs/reproduce-<experiment>-<n>]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

pub fn main(arguments: &Arguments) -> ExitCode {
    study_ended(match &arguments.experiment {
        Experiment::Arm(options) => arm(&options.settings()).map(|r| options.text(r.to_json(), r.to_text())),
        Experiment::Eye(options) => eye(&options.settings()).map(|r| options.text(r.to_json(), r.to_text())),
        Experiment::OpenLoop(options) => open_loop(&options.settings()).map(|r| options.text(r.to_json(), r.to_text())),
        Experiment::Outlook(options) => outlook(&options.settings()).map(|r| options.text(r.to_json(), r.to_text())),
    })
}

impl Options {
    fn settings(&self) -> ReproduceSettings {
        ReproduceSettings {
            seeds: self.seeds,
            first_seed: self.first_seed,
            ticks: self.ticks,
            out: self.out.clone(),
            progress: true,
        }
    }

    /// The text to print.
    fn text(&self, json: String, text: String) -> String {
        if self.json { json + "\n" } else { text }
    }
}
