//! `tectum compare`: the learners beside each other.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use tectum::reference::{STARTS, TEST_SEED};
use tectum::runtime::exit;
use tectum::study::compare::{ArmChange, Changes, ComparedLearner, Comparison, LEARNERS, compare, learner};
use tectum::study::{StudyError, StudyPlace, verify};

use super::seeds::SeedsArgument;
use super::tick_count::tick_count;
use super::{continued_output, print, study_ended, study_output};

#[derive(Debug, Args)]
#[command(after_help = "\
Every learner runs with every seed on the built-in arm, and is tested without exploration noise on the
same 40 targets. What it says of each: ticks until its loss reaches the level (that of the paper's rule
after 9 million ticks), ticks until it is over the block of a joint (within 10 % of the blocked arm's
optimum), what is left to the optimum, what a tick costs; beside controllers that know the true arm.

Examples:
  tectum compare                                       all learners, 5 seeds each
  tectum compare --learners learned-reward --seeds 20  one learner, on more seeds
  tectum compare --learners actor-critic,paper --ticks 1000000 --block never
                                                       how far they get, and nothing happens to the arm
  tectum compare --learners learned-reward --ticks 12000 --change block:3@3000 \\
      --change shorten:2:0.3@6000 --change mirror:x@9000
                                                       one change after another
  tectum compare --learners learned-reward,mine.toml --ticks 6000
                                                       beside a controller of your own (docs/controllers.md)
  tectum compare --learners learned-reward --test-seed 77
                                                       on targets that nothing was tuned with
  tectum compare --learners actor-critic --first-seed 1 --set learner.critic.step=0.1
                                                       try a setting, on seeds to tune on
  tectum compare --seeds 1000..1010 --part a.jsonl     a part of a comparison; see tectum merge
  tectum compare --continue runs/compare-1             go on with one that was interrupted
  tectum compare --verify runs/compare-1 --sample 0.1  make a tenth of its seeds again: the same bits?
  tectum compare --verify runs/compare-1 parts/*.jsonl are these two results equal, bit for bit?")]
pub struct Arguments {
    /// Learners to compare, separated by commas: paper, baseline, actor-critic, natural-actor-critic,
    /// learned-reward, model-predictive, or scenario files with a controller or settings of your own [default: the
    /// rules]
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    learners: Vec<String>,
    /// Number of seeds, or a range A..B, in which B is not
    #[arg(long, value_name = "N|A..B", default_value = "5")]
    seeds: SeedsArgument,
    /// First seed; those below 1000 are for tuning
    #[arg(long, value_name = "S", default_value_t = 1000)]
    first_seed: u64,
    /// Length of every run, in place of each learner's usual one
    #[arg(long, value_name = "N", value_parser = tick_count, allow_negative_numbers = true)]
    ticks: Option<u64>,
    /// Block joint 3 from this tick on, or `never` [default: when each learner should have learned]
    #[arg(long, value_name = "TICK", conflicts_with = "change")]
    block: Option<String>,
    /// Change the arm from a tick on; may be given more than once: block:JOINT@TICK, block:JOINT:ANGLE@TICK,
    /// shorten:SEGMENT:LENGTH@TICK, mirror:x@TICK, mirror:y@TICK
    #[arg(long, value_name = "WHAT@TICK")]
    change: Vec<ArmChange>,
    /// A setting in TOML for all named learners, in place of their preset's, such as learner.beta=0.5
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// First guesses for each movement of the trajectory optimum
    #[arg(long, value_name = "N", default_value_t = STARTS)]
    starts: usize,
    /// Seed of the test's targets; learners were tuned with the usual ones
    #[arg(long, value_name = "S", default_value_t = TEST_SEED)]
    test_seed: u64,
    /// Folder for tables and figure [default: runs/compare-<n>]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Only keep the runs, in this file; the same command goes on with it, and `tectum merge` puts parts together
    #[arg(long, value_name = "FILE", conflicts_with = "out")]
    part: Option<PathBuf>,
    /// Go on with a comparison that was interrupted, in its folder
    #[arg(long, value_name = "DIR", conflicts_with_all = ["learners", "seeds", "first_seed", "ticks", "block", "change",
        "set", "starts", "test_seed", "out", "part"])]
    r#continue: Option<PathBuf>,
    /// Compare results bit for bit: that of the first file, or folder, with those of the others; a single one with
    /// what this machine makes of a part of its seeds. Rows of other studies will do as well
    #[arg(long, value_name = "FILE", num_args = 1.., conflicts_with_all = ["learners", "seeds", "first_seed", "ticks",
        "block", "change", "set", "starts", "test_seed", "out", "part", "continue"])]
    verify: Vec<PathBuf>,
    /// Share of the seeds that --verify makes again, at least one
    #[arg(long, value_name = "SHARE", default_value_t = 0.05, requires = "verify", allow_negative_numbers = true)]
    sample: f64,
    /// Print one JSON object instead of the tables
    #[arg(long)]
    json: bool,
}

pub fn main(arguments: &Arguments) -> ExitCode {
    if arguments.verify.is_empty() { study_ended(run(arguments)) } else { verified(arguments) }
}

/// Prints what a verification found; results that differ are an error.
fn verified(arguments: &Arguments) -> ExitCode {
    match verify(&arguments.verify, arguments.sample, true) {
        Ok(found) => {
            let printed = print(&if arguments.json { found.to_json() + "\n" } else { found.to_text() });
            if found.holds() { printed } else { ExitCode::from(exit::ERROR) }
        }
        Err(error) => study_ended(Err(error)),
    }
}

fn run(arguments: &Arguments) -> Result<String, StudyError> {
    if let Some(folder) = &arguments.r#continue {
        return continued_output(folder, "compare", arguments.json);
    }
    let end = compare(&comparison(arguments)?)?.map(|result| (result.to_json(), result.to_text()));
    Ok(study_output(end, arguments.json))
}

/// The comparison for the arguments.
fn comparison(arguments: &Arguments) -> Result<Comparison, StudyError> {
    let learners = match &arguments.learners[..] {
        [] => LEARNERS.map(ComparedLearner::Rule).to_vec(),
        names => names.iter().map(|name| learner(name)).collect::<Result<_, _>>()?,
    };
    let changes = match arguments.block.as_deref() {
        None if arguments.change.is_empty() => Changes::Usual,
        None => Changes::These(arguments.change.clone()),
        Some("never") => Changes::None,
        Some(tick) => {
            let tick = tick_count(tick).map_err(|why| StudyError::Asked(format!("--block {tick}: {why}, or never")))?;
            Changes::These(vec![ArmChange::block(tick)])
        }
    };
    Ok(Comparison {
        learners,
        seeds: arguments.seeds.range(arguments.first_seed)?,
        ticks: arguments.ticks,
        changes,
        settings: arguments.set.clone(),
        starts: arguments.starts,
        test_seed: arguments.test_seed,
        out: arguments.out.clone(),
        place: arguments.part.clone().map_or(StudyPlace::Folder, StudyPlace::Part),
        progress: true,
    })
}
