//! `tectum tasks`: the table of all learners on all tasks.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use tectum::study::tasks::{TaskStudy, TaskTable, listing, listing_json, measure};

use super::tick_count::tick_count;
use super::{print, study_ended};

#[derive(Debug, Args)]
#[command(after_help = "\
Every learner runs on every task with every seed, and is tested at intervals without exploration noise, on
the same starts and targets for all. The table says when it reaches the task's level and keeps it, the error
that is left, how long it takes to get over a change of the plant, and the processor time of a tick; beside
controllers that know nothing (zero, random) and controllers that know the true plant.

Examples:
  tectum tasks --list                           what tasks, learners and reference controllers there are
  tectum tasks --task pendulum --task cart-pole
                                                two tasks, all learners
  tectum tasks --task arm --learner learned-reward --learner ilqr --seeds 3
                                                one learner beside a planner that knows the arm
  tectum tasks --task pendulum --learner model-predictive --learner mine.toml
                                                a controller of your own beside it (docs/controllers.md)
  tectum tasks --task cart-pole --out figures   table, tests and a figure, figures/cart-pole.svg
  tectum tasks --json > tasks.json              everything; takes hours")]
pub struct Arguments {
    /// A task; may be given more than once [default: the usual ones]
    #[arg(long, value_name = "NAME")]
    task: Vec<String>,
    /// A learner or reference controller, or a scenario file with a controller or settings of your own; may be given
    /// more than once [default: all that have names]
    #[arg(long, value_name = "NAME")]
    learner: Vec<String>,
    /// Number of seeds
    #[arg(long, value_name = "N", default_value_t = 10)]
    seeds: u64,
    /// First seed; those below 1000 are for tuning
    #[arg(long, value_name = "S", default_value_t = 5000)]
    first_seed: u64,
    /// Length of every run, in place of each task's usual one
    #[arg(long, value_name = "N", value_parser = tick_count, allow_negative_numbers = true)]
    ticks: Option<u64>,
    /// Folder for the table, every test (curves.csv), and a figure for each task (TASK.svg)
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// List tasks, learners and reference controllers, and measure nothing
    #[arg(long, conflicts_with_all = ["task", "learner", "seeds", "first_seed", "ticks", "out"])]
    list: bool,
    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

pub fn main(arguments: &Arguments) -> ExitCode {
    if arguments.list {
        print(&if arguments.json { listing_json() + "\n" } else { listing() });
        return ExitCode::SUCCESS;
    }
    let study = TaskStudy {
        tasks: arguments.task.clone(),
        candidates: arguments.learner.clone(),
        seeds: arguments.seeds,
        first_seed: arguments.first_seed,
        ticks: arguments.ticks,
        out: arguments.out.clone(),
        progress: true,
    };
    let text = |table: TaskTable| if arguments.json { table.to_json() + "\n" } else { table.to_text() };
    study_ended(measure(&study).map(text))
}
