//! How fast each learning rule learns to reach, how it takes changes of its body, and what a tick of it costs.
//!
//! ```text
//! cargo run --release --example learners -- --rule learned-reward --seeds 1000..1020
//! cargo run --release --example learners -- --rule actor-critic --seeds 1000..1020 --ticks 200000 --every 1000
//! cargo run --release --example learners -- --rule learned-reward --change block@3000 --ticks 6000
//! ```
//!
//! Every so many ticks the mean policy is taken aside and tested: 40 fixed targets of 80 ticks each in sequence, from all
//! angles 0, without noise. The *level*, 0.0375, is what the paper's rule reaches in 9 million ticks; the optimum is what
//! trajectory optimisation with the true model reaches on the same targets, and a change counts as overcome when the test
//! in the changed world is within 10 % of that world's optimum. Everything printed but the time follows from the seeds.

mod optimum;
mod world;

use std::time::Instant;

use clap::Parser;
use tectum::plant::Plant;
use tectum::runtime::{Controller, PlantSide};
use tectum::scenario::{LearnerTable, Plan, Rule, Scenario};
use tectum::wire::{Command, Observation};
use world::{Change, World};

const LEVEL: f64 = 0.0375;
const TARGETS: usize = 40;
const TICKS: u64 = 80;
/// The seed of the test targets: neither one to tune on nor one to report on.
const TEST_SEED: u64 = 2010;

/// Studies one learning rule.
#[derive(Parser)]
struct Args {
    /// The rule, under its preset.
    #[arg(long, default_value = "learned-reward")]
    rule: String,
    /// Settings in TOML that take the place of the preset's, such as `beta = 0.5` or `model.steps = 2`.
    #[arg(long)]
    set: Vec<String>,
    /// First seed and the one after the last.
    #[arg(long, default_value = "0..4")]
    seeds: String,
    /// Length of a run.
    #[arg(long, default_value_t = 3000)]
    ticks: u64,
    /// Ticks between two tests.
    #[arg(long, default_value_t = 50)]
    every: u64,
    /// What changes and when, in order: block@TICK (joint 3), block1@TICK, mirror@TICK, short@TICK.
    #[arg(long)]
    change: Vec<String>,
    /// Print every test.
    #[arg(long)]
    verbose: bool,
    /// Work out the optima (takes some seconds each); needed for `--change`.
    #[arg(long)]
    optimum: bool,
}

fn main() {
    let args = Args::parse();
    let learner = table(&args.rule, &args.set);
    let changes: Vec<Change> = args.change.iter().map(|c| Change::parse(c)).collect();
    let (from, to) = args.seeds.split_once("..").expect("--seeds wants FIRST..END");
    let seeds = from.parse::<u64>().expect("a number")..to.parse().expect("a number");
    let optima: Vec<f64> = (0..=changes.len())
        .filter(|_| args.optimum || !changes.is_empty())
        .map(|done| {
            let (loss, miss) = World::optimum(&changes[..done], &tests(&changes[..done]));
            println!("optimum after {done} changes: {loss:.5} a tick, miss {miss:.4} m");
            loss
        })
        .collect();

    let checkpoints = [500, 1000, 2000, 3000, 10_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000, 12_000_000];
    let mut levels = Vec::new();
    let mut finals = Vec::new();
    let mut recoveries: Vec<Vec<Option<u64>>> = vec![Vec::new(); changes.len()];
    for seed in seeds {
        let plan = plan(&learner, seed, args.ticks);
        let run = run(&plan, &changes, &optima, &args);
        let at: Vec<_> = checkpoints
            .iter()
            .filter_map(|c| run.tests.iter().find(|(k, _)| k == c).map(|(k, l)| format!("{k}:{l:.4}")))
            .collect();
        println!(
            "seed {seed} level {} recovered {:?} worst-after-level {:.4} loss {} halted {} hash {} {:.0} ns/tick (cheap part {:.0})",
            run.level.map_or("never".into(), |l| l.to_string()),
            run.recovered,
            run.worst,
            at.join(" "),
            run.halted,
            run.hash,
            run.ns,
            run.ns_cheap
        );
        levels.push(run.level);
        finals.push(run.tests.last().map_or(f64::NAN, |t| t.1));
        recoveries.iter_mut().zip(run.recovered).for_each(|(all, r)| all.push(r));
    }
    println!("level: {}", spread(&levels));
    for (change, recoveries) in args.change.iter().zip(&recoveries) {
        println!("{change} overcome: {}", spread(recoveries));
    }
    finals.sort_by(f64::total_cmp);
    println!("final loss: median {:.5}, worst {:.5}", finals[finals.len() / 2], finals[finals.len() - 1]);
}

/// Median and worst, with "never" beyond all numbers.
fn spread(values: &[Option<u64>]) -> String {
    let mut sorted: Vec<_> = values.iter().map(|v| v.unwrap_or(u64::MAX)).collect();
    sorted.sort_unstable();
    let show = |v: u64| if v == u64::MAX { "never".to_owned() } else { v.to_string() };
    format!("median {}, worst {}", show(sorted[sorted.len() / 2]), show(sorted[sorted.len() - 1]))
}

fn table(rule: &str, settings: &[String]) -> LearnerTable {
    let rule: Rule = toml::Value::from(rule).try_into().expect("a rule's name");
    let mut table = toml::Table::try_from(LearnerTable::preset(rule)).expect("a table");
    for setting in settings {
        let new: toml::Table = toml::from_str(setting).expect("TOML");
        merge(&mut table, new);
    }
    table.try_into().expect("known settings")
}

fn merge(into: &mut toml::Table, from: toml::Table) {
    for (key, value) in from {
        match (into.get_mut(&key), value) {
            (Some(toml::Value::Table(into)), toml::Value::Table(from)) => merge(into, from),
            (_, value) => drop(into.insert(key, value)),
        }
    }
}

fn plan(learner: &LearnerTable, seed: u64, ticks: u64) -> Plan {
    let mut scenario = Scenario::find("arm").expect("built in");
    (scenario.seed, scenario.ticks, scenario.learner) = (seed, ticks, learner.clone());
    scenario.plan().expect("a valid scenario")
}

/// The test's targets: what the arm can reach after `changes`.
fn tests(changes: &[Change]) -> Vec<[f64; 2]> {
    let mut world =
        World::new(TEST_SEED, Vec::new(), &changes.iter().map(|c| Change { tick: 0, ..*c }).collect::<Vec<_>>());
    let mut inputs = [0.0; 16];
    (0..TARGETS as u64)
        .map(|i| {
            world.sense(i * TICKS, &mut inputs);
            world.true_target()
        })
        .collect()
}

struct Run {
    level: Option<u64>,
    recovered: Vec<Option<u64>>,
    worst: f64,
    tests: Vec<(u64, f64)>,
    halted: bool,
    hash: String,
    ns: f64,
    ns_cheap: f64,
}

fn run(plan: &Plan, changes: &[Change], optima: &[f64], args: &Args) -> Run {
    let mut side = PlantSide::new(World::new(plan.scenario.seed, Vec::new(), changes), plan);
    let mut controller = Controller::new(plan);
    let (mut observation, mut command) = (Observation::default(), Command::default());
    let mut run = Run {
        level: None,
        recovered: vec![None; changes.len()],
        worst: 0.0,
        tests: Vec::new(),
        halted: false,
        hash: String::new(),
        ns: 0.0,
        ns_cheap: 0.0,
    };
    let sets: Vec<_> = (0..=changes.len()).map(|done| tests(&changes[..done])).collect();
    for tick in 0..plan.scenario.ticks {
        side.observe(tick, 0, 0, &mut observation);
        let begin = Instant::now();
        controller.respond(&observation, &mut command);
        run.ns_cheap += begin.elapsed().as_nanos() as f64;
        controller.settle(&observation);
        run.ns += begin.elapsed().as_nanos() as f64;
        side.live(tick, Some(&command));

        let ticks = tick + 1;
        if ticks % args.every != 0 {
            continue;
        }
        let done = changes.iter().filter(|c| ticks > c.tick).count();
        let loss = test(plan, &controller, &changes[..done], &sets[done]);
        if args.verbose {
            println!("  {ticks} {loss:.5}");
        }
        run.tests.push((ticks, loss));
        if run.level.is_none() && loss <= LEVEL {
            run.level = Some(ticks);
        } else if run.level.is_some() {
            run.worst = run.worst.max(loss);
        }
        if done > 0 && run.recovered[done - 1].is_none() && loss <= 1.1 * optima[done] {
            run.recovered[done - 1] = Some(ticks - changes[done - 1].tick);
        }
    }
    let look = look();
    run.ns = run.ns / plan.scenario.ticks as f64 - 2.0 * look;
    run.ns_cheap = run.ns_cheap / plan.scenario.ticks as f64 - look;
    run.halted = controller.halted();
    run.hash = controller.finish().weights_hash;
    run
}

/// What a look at the clock costs, ns.
fn look() -> f64 {
    const LOOKS: u32 = 100_000;
    let begin = Instant::now();
    for _ in 0..LOOKS {
        std::hint::black_box(begin.elapsed());
    }
    begin.elapsed().as_nanos() as f64 / f64::from(LOOKS)
}

/// The mean policy's loss a tick over the test.
fn test(plan: &Plan, controller: &Controller, changes: &[Change], targets: &[[f64; 2]]) -> f64 {
    let now: Vec<_> = changes.iter().map(|c| Change { tick: 0, ..*c }).collect();
    let mut side = PlantSide::new(World::new(0, targets.to_vec(), &now), plan);
    let mut encoder = tectum::encoder::Encoder::new(&plan.maps, plan.scenario.encoder.normalise);
    let mut features = encoder.features();
    let (mut observation, mut command) = (Observation::default(), Command::default());
    let mut sum = 0.0;
    let mut per = vec![0.0; targets.len()];
    let mut posts = Vec::new();
    let ticks = targets.len() as u64 * TICKS;
    for tick in 0..ticks {
        side.observe(tick, 0, 0, &mut observation);
        sum -= f64::from(observation.reward);
        if tick > 0 {
            per[(tick as usize - 1) / 80] -= f64::from(observation.reward) / 80.0;
        }
        if tick > 0 && tick % 80 == 79 {
            posts.push(observation.inputs[..6].to_vec());
        }
        encoder.encode(&observation.inputs[..plan.inputs.len()], &mut features);
        command.drawn = controller.policy().mean(features.as_slice());
        side.live(tick, Some(&command));
    }
    side.observe(ticks, 0, 0, &mut observation);
    if std::env::var("PER").is_ok() {
        for (i, (l, p)) in per.iter().zip(&posts).enumerate() {
            println!("    {i} {l:.4} {p:.2?}");
        }
    }
    (sum - f64::from(observation.reward)) / ticks as f64
}
