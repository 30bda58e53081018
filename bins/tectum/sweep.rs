//! `tectum sweep`: a scenario with all combinations of some settings, over seeds.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use tectum::scenario::Scenario;
use tectum::study::sweep::{Sweep, SweepSetting, sweep};
use tectum::study::{StudyError, StudyPlace};

use super::seeds::SeedsArgument;
use super::tick_count::tick_count;
use super::{continued_output, study_ended, study_output};

#[derive(Debug, Args)]
#[command(after_help = "\
Any key of a scenario can be set, also plant, gate and encoder (encoder.maps.0.radius). Simulated plants run side
by side on all cores; a plant that is a program of your own runs in lockstep, one run at a time.

Examples:
  tectum sweep pendulum --set policy.sigma=0.1,0.3 --seeds 20 --ticks 6000
  tectum sweep my.toml --set learner.beta=0.5,0.9 --set learner.rule=paper,actor-critic
  tectum sweep my.toml --set learner.beta=0.5,0.9 --seeds 0..50 --part first.jsonl    one part of it; tectum merge")]
pub struct Arguments {
    /// A scenario file, or the name of a built-in one
    #[arg(required_unless_present = "continue")]
    scenario: Option<PathBuf>,
    /// A key and its values; given more than once, all combinations are run
    #[arg(long, value_name = "KEY=VALUE,...")]
    set: Vec<SweepSetting>,
    /// Number of seeds, or a range A..B, in which B is not
    #[arg(long, value_name = "N|A..B", default_value = "5")]
    seeds: SeedsArgument,
    /// First seed
    #[arg(long, value_name = "S", default_value_t = 1)]
    first_seed: u64,
    /// Ticks of every run, in place of the scenario's
    #[arg(long, value_name = "N", value_parser = tick_count, allow_negative_numbers = true)]
    ticks: Option<u64>,
    /// Folder for tables and figure [default: runs/sweep-<scenario>-<n>]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Only keep the runs, in this file; the same command goes on with it
    #[arg(long, value_name = "FILE", conflicts_with = "out")]
    part: Option<PathBuf>,
    /// Go on with a sweep that was interrupted, in its folder
    #[arg(long, value_name = "DIR", conflicts_with_all = ["scenario", "set", "seeds", "first_seed", "ticks", "out",
        "part"])]
    r#continue: Option<PathBuf>,
    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

pub fn main(arguments: &Arguments) -> ExitCode {
    study_ended(run(arguments))
}

fn run(arguments: &Arguments) -> Result<String, StudyError> {
    if let Some(folder) = &arguments.r#continue {
        return continued_output(folder, "sweep", arguments.json);
    }
    let end = sweep(&Sweep {
        scenario: Scenario::find(arguments.scenario.as_deref().unwrap_or("arm".as_ref()))?,
        settings: arguments.set.clone(),
        seeds: arguments.seeds.range(arguments.first_seed)?,
        ticks: arguments.ticks,
        out: arguments.out.clone(),
        place: arguments.part.clone().map_or(StudyPlace::Folder, StudyPlace::Part),
        progress: true,
    })?;
    Ok(study_output(end.map(|result| (result.to_json(), result.to_text())), arguments.json))
}
