//! The paper's outlook, measured: what the arm's other tasks come to over seeds.
//!
//! ```text
//! cargo run --release --example outlook -- near --seeds 1000..1005
//! cargo run --release --example outlook -- collision --set plant.arm.reward.collision=1e-9
//! ```
//!
//! For each seed, in the first and the last twentieth of the run: loss a tick without the noise's share, error at the end of
//! a target (m), the share of targets that end within 0.1 m, the share of ticks in which segments cross (where they cost
//! something), and the share of joints that stand at a stop. Then how far apart the postures of two seeds' final policies
//! are, without noise, for the same forty targets (rad, root mean square over joints).

use std::thread;

use clap::Parser;
use tectum::encoder::Encoder;
use tectum::plant::{Arm, Plant};
use tectum::runtime::{Controller, PlantSide};
use tectum::scenario::{Plan, Scenario};
use tectum::study::Spread;
use tectum::wire::{Command, Observation, flag};

/// Targets and ticks of each on which postures are compared.
const TARGETS: u64 = 40;
const TEST_SEED: u64 = 2010;

/// Measures a scenario.
#[derive(Parser)]
struct Args {
    /// A scenario with an arm: a file or a built-in name.
    scenario: String,
    /// First seed and the one after the last.
    #[arg(long, default_value = "1000..1005")]
    seeds: String,
    /// Ticks in place of the scenario's.
    #[arg(long)]
    ticks: Option<u64>,
    /// A setting in place of the scenario's, such as `policy.sigma=0.01`; in TOML.
    #[arg(long)]
    set: Vec<String>,
}

/// Means over a stretch of a run.
#[derive(Default, Clone, Copy)]
struct Sums {
    ticks: f64,
    loss: f64,
    ends: f64,
    end_error: f64,
    hits: f64,
    crossed: f64,
    stopped: f64,
}

fn main() {
    let args = Args::parse();
    let (from, to) = args.seeds.split_once("..").expect("--seeds wants FIRST..END");
    let seeds: Vec<u64> = (from.parse().expect("a number")..to.parse().expect("a number")).collect();
    let plans: Vec<Plan> = seeds.iter().map(|&seed| plan(&args, seed)).collect();
    let cores = thread::available_parallelism().map_or(1, usize::from);
    let mut results = Vec::new();
    for some in plans.chunks(cores) {
        thread::scope(|scope| {
            let jobs: Vec<_> = some.iter().map(|plan| scope.spawn(|| run(plan))).collect();
            results.extend(jobs.into_iter().map(|job| job.join().expect("a run")));
        });
    }
    for (seed, ([first, last], ..)) in seeds.iter().zip(&results) {
        for (name, s) in [("first", first), ("last", last)] {
            println!(
                "seed {seed} {name:<5} loss {:.4} end error {:.4} within 0.1 m {:.3} crossed {:.4} at stops {:.4}",
                s.loss / s.ticks,
                s.end_error / s.ends,
                s.hits / s.ends,
                s.crossed / s.ticks,
                s.stopped / s.ticks
            );
        }
    }
    let spread = |name: &str, value: fn(&Sums) -> f64| {
        if let Some(s) = Spread::of(results.iter().map(|([_, last], ..)| value(last))) {
            println!("last twentieth, {name}: median {:.4}, {:.4} to {:.4}", s.median, s.min, s.max);
        }
    };
    spread("loss", |s| s.loss / s.ticks);
    spread("end error", |s| s.end_error / s.ends);
    spread("within 0.1 m", |s| s.hits / s.ends);
    spread("crossed", |s| s.crossed / s.ticks);
    let mut apart = Vec::new();
    for (i, (.., a, _)) in results.iter().enumerate() {
        for (.., b, _) in &results[..i] {
            let square = |(a, b): (&f32, &f32)| {
                let turn = f64::from(a - b) / std::f64::consts::TAU;
                ((turn - turn.round()) * std::f64::consts::TAU).powi(2)
            };
            apart.push((a.iter().zip(b).map(square).sum::<f64>() / a.len() as f64).sqrt());
        }
    }
    if let Some(s) = Spread::of(apart) {
        println!("postures of two seeds apart: median {:.3} rad, {:.3} to {:.3}", s.median, s.min, s.max);
    }
    if let Some(s) = Spread::of(results.iter().map(|(.., miss)| *miss)) {
        println!("miss without noise, forty targets: median {:.4} m, {:.4} to {:.4}", s.median, s.min, s.max);
    }
}

fn plan(args: &Args, seed: u64) -> Plan {
    let scenario = Scenario::find(&args.scenario).unwrap_or_else(|e| panic!("{e}"));
    let mut table: toml::Table = scenario.to_toml().parse().expect("a table");
    for setting in &args.set {
        merge(&mut table, setting.parse().expect("TOML"));
    }
    let mut scenario: Scenario = table.try_into().unwrap_or_else(|e| panic!("{e}"));
    (scenario.seed, scenario.ticks) = (seed, args.ticks.unwrap_or(scenario.ticks));
    scenario.plan().unwrap_or_else(|e| panic!("{e}"))
}

fn merge(into: &mut toml::Table, from: toml::Table) {
    for (key, value) in from {
        match (into.get_mut(&key), value) {
            (Some(toml::Value::Table(into)), toml::Value::Table(from)) => merge(into, from),
            (_, value) => drop(into.insert(key, value)),
        }
    }
}

/// The first and the last twentieth of a run, and of its final policy the postures at forty targets and the mean miss.
fn run(plan: &Plan) -> ([Sums; 2], Vec<f32>, f64) {
    let table = plan.scenario.plant.arm.as_ref().expect("an arm");
    let arm = Arm::new(table, plan.scenario.period_ms / 1000.0, plan.scenario.seed);
    let mut side = PlantSide::new(arm, plan);
    let mut controller = Controller::new(plan);
    let (mut observation, mut command) = (Observation::default(), Command::default());
    let ticks = plan.scenario.ticks;
    let mut sums = [Sums::default(); 2];
    for tick in 0..ticks {
        side.observe(tick, 0, 0, &mut observation);
        controller.respond(&observation, &mut command);
        controller.settle(&observation);
        let which = if tick < ticks / 20 { 0 } else { 1 };
        if tick > 0 && (which == 0 || tick >= ticks - ticks / 20) {
            count(&mut sums[which], plan, &observation);
        }
        side.live(tick, Some(&command));
    }
    let (postures, miss) = test(plan, &controller);
    (sums, postures, miss)
}

fn count(sums: &mut Sums, plan: &Plan, observation: &Observation) {
    let table = plan.scenario.plant.arm.as_ref().expect("an arm");
    let tick = observation.header.tick;
    sums.ticks += 1.0;
    sums.loss -= f64::from(observation.reward) + tectum::plant::noise_share(table, plan.scenario.policy.sigma, tick);
    if observation.header.flags & flag::NEW_TARGET != 0 {
        let error = f64::from(observation.measures[0]);
        sums.ends += 1.0;
        sums.end_error += error;
        sums.hits += f64::from(error < 0.1);
    }
    sums.crossed += f64::from(observation.measures[3] > 0.0);
    for (&theta, limits) in observation.inputs[2..].iter().zip(&table.limits) {
        let stopped = limits.iter().any(|&limit| theta == limit as f32);
        sums.stopped += f64::from(stopped) / table.limits.len() as f64;
    }
}

/// Where the policy takes the arm without noise, target by target.
fn test(plan: &Plan, controller: &Controller) -> (Vec<f32>, f64) {
    let table = plan.scenario.plant.arm.as_ref().expect("an arm").at(plan.scenario.ticks);
    let mut arm = Arm::new(&table, plan.scenario.period_ms / 1000.0, TEST_SEED);
    let mut encoder = Encoder::new(&plan.maps, plan.scenario.encoder.normalise);
    let mut features = encoder.features();
    let mut inputs = [0.0; 16];
    let (mut postures, mut miss) = (Vec::new(), 0.0);
    for tick in 0..TARGETS * table.target_every {
        arm.sense(tick, &mut inputs);
        encoder.encode(&inputs[..plan.inputs.len()], &mut features);
        let most = plan.scenario.gate.max_command as f32;
        let command = controller.policy().mean(features.as_slice()).map(|u| u.clamp(-most, most));
        let outcome = arm.advance(tick, &command[..plan.outputs.len()]);
        if (tick + 1) % table.target_every == 0 {
            postures.extend_from_slice(arm.angles());
            miss += f64::from(outcome.measures[0]) / TARGETS as f64;
        }
    }
    (postures, miss)
}
