//! The open-loop arm (paper section 4.2), whose results the paper leaves out: with 3 and 4 segments every run finds another
//! way to its targets.
//!
//! A tick is a trial: a target appears, the command turns the joints from 0 to a posture, and the reward is the squared
//! error of the end-effector. The controller sees the target alone, so what it learns is one posture for each target. How
//! these differ between seeds is measured on a fixed set of targets, without exploration noise.

use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};
use std::fmt::Write as _;
use std::path::PathBuf;

use serde::Serialize;

use super::{ReproduceSettings, StudyError, in_words, write_lines};
use crate::clock::{facts, monotonic_ns};
use crate::plant::{Arm, Plant, posture};
use crate::report::figure::{Polyline, PosturesFigure, PosturesRow, SeedPostures, draw_ways};
use crate::report::{columns, figures, thousands};
use crate::runtime::{Controller, in_process_seen};
use crate::scenario::{Plan, Scenario};
use crate::study::{JobProgress, Spread};
use crate::wire::{MAX_INPUTS, MAX_OUTPUTS};

/// The scenarios, by number of segments.
const SCENARIOS: [(&str, usize); 2] = [("open-loop-3", 3), ("open-loop-4", 4)];
/// Points of a curve.
const POINTS: u64 = 200;
/// Ticks between two reports of progress.
const REPORT: u64 = 4096;
/// Targets of the test, and the seed that they are drawn with: neither one to tune on nor one to report on.
const TARGETS: usize = 60;
const TEST_SEED: u64 = 2010;
/// Of these, the ones that the figure shows.
const SHOWN: usize = 3;
/// Two seeds found the same way if their segments' directions differ by less than this on average, rad.
const SAME: f64 = 0.35;

/// What one number of segments gave.
#[derive(Debug, Clone, Serialize)]
pub struct OpenLoopArm {
    /// The scenario.
    pub scenario: String,
    /// Number of segments.
    pub segments: usize,
    /// Trials of each run.
    pub ticks: u64,
    /// Mean error over the first and the last twentieth of the trials, with exploration noise, m.
    pub first_error_m: Spread,
    /// The same at the end.
    pub last_error_m: Spread,
    /// Mean error of the noiseless postures on the test's targets, m.
    pub test_error_m: Spread,
    /// For every two seeds, by how much their segments' directions differ on the test's targets on average, rad; 0 is the
    /// same posture, pi / 2 what two postures differ by that have nothing to do with each other.
    pub difference_rad: Option<Spread>,
    /// Groups of seeds that found the same way, in the order of the seeds: seeds with one number are of one group.
    pub ways: Vec<usize>,
    /// XXH3-64 of the final weights, one a seed.
    pub weights_hash: Vec<String>,
    /// The trial at which the weights were no longer numbers, one a seed; null where they are.
    pub diverged: Vec<Option<u64>>,
}

/// What came out.
#[derive(Debug, Clone, Serialize)]
pub struct OpenLoopResult {
    /// The seeds.
    pub seeds: Vec<u64>,
    /// The same in words.
    #[serde(skip)]
    runs: String,
    /// The arms.
    pub arms: Vec<OpenLoopArm>,
    /// Seconds that all runs took together.
    pub seconds: f64,
    /// The machine.
    pub machine: BTreeMap<String, String>,
    /// The folder with the figure and the tables.
    pub folder: PathBuf,
    /// The figure.
    pub figure: PathBuf,
    /// The tables.
    pub csv: Vec<PathBuf>,
}

/// What one seed gave.
struct OpenLoopRun {
    /// Sums over windows: trials, error.
    windows: Vec<(u64, f64)>,
    /// On the test's targets: the directions of the segments, rad, and the error, m.
    test: Vec<(Vec<f32>, f64)>,
    hash: String,
    diverged: Option<u64>,
}

/// Runs the open-loop arms.
///
/// # Errors
/// When the folder cannot be used, a file not be written, or a signal came.
pub fn open_loop(settings: &ReproduceSettings) -> Result<OpenLoopResult, StudyError> {
    let mut plans = Vec::new();
    for (name, _) in SCENARIOS {
        for seed in settings.seeds() {
            let mut scenario = Scenario::built_in(name)?;
            scenario.seed = seed;
            scenario.ticks = settings.ticks.unwrap_or(scenario.ticks);
            plans.push(scenario.plan()?);
        }
    }
    let pool = settings.pool()?;
    let folder = settings.folder("reproduce-open-loop")?;
    let began = monotonic_ns();
    let total = plans.iter().map(|p| p.scenario.ticks).sum();
    let runs = pool.work("open loop", total, &plans, run).map_err(StudyError::Signal)?;
    let seconds = (monotonic_ns() - began) as f64 / 1e9;
    folder.keep();

    let per_arm = settings.seeds as usize;
    let arms: Vec<_> = SCENARIOS
        .iter()
        .zip(plans.chunks(per_arm).zip(runs.chunks(per_arm)))
        .filter_map(|((_, segments), (plans, runs))| arm(*segments, &plans[0], runs))
        .collect();
    let path = |name: &str| folder.path().join(name);
    let result = OpenLoopResult {
        seeds: settings.seeds(),
        runs: settings.in_words(),
        arms,
        seconds,
        machine: facts(),
        folder: folder.path().to_owned(),
        figure: path("figure.svg"),
        csv: vec![path("curve.csv"), path("postures.csv")],
    };
    draw(&result, &plans, &runs, per_arm)?;
    write_tables(&result, &runs, per_arm)?;
    let json = path("result.json");
    std::fs::write(&json, result.to_json()).map_err(StudyError::write(&json))?;
    Ok(result)
}

fn run(plan: &Plan, ticks: &JobProgress) -> OpenLoopRun {
    let trials = plan.scenario.ticks;
    let length = trials.div_ceil(POINTS);
    let mut windows = vec![(0, 0.0)];
    let mut test_set = Vec::new();
    let Some(body) = plan.simulated_plant() else { unreachable!("the built-in arm is the simulator's") };
    let result = in_process_seen(plan, body, |observation, controller| {
        let tick = observation.header.tick;
        if tick > 0 {
            if tick > 1 && (tick - 1).is_multiple_of(length) {
                windows.push((0, 0.0));
            }
            let last = windows.len() - 1;
            windows[last].0 += 1;
            windows[last].1 += f64::from(observation.measures[0]);
        }
        if tick + 1 == trials {
            test_set = test(plan, controller);
        }
        !tick.is_multiple_of(REPORT) || ticks.report(REPORT)
    });
    OpenLoopRun {
        windows,
        test: test_set,
        hash: result.controller.weights_hash,
        diverged: result.controller.diverged_at,
    }
}

/// The noiseless postures for the test's targets.
fn test(plan: &Plan, controller: &Controller) -> Vec<(Vec<f32>, f64)> {
    let table = plan.scenario.plant.arm.clone().unwrap_or_default();
    let mut arm = Arm::new(&table, plan.period_ns as f64 / 1e9, TEST_SEED);
    let mut encoder = plan.encoder();
    let mut features = encoder.features();
    let limits = plan.scenario.gate.max_command.outputs();
    (0..TARGETS as u64)
        .map(|tick| {
            let mut inputs = [0.0; MAX_INPUTS];
            arm.sense(tick, &mut inputs);
            encoder.encode(&inputs[..plan.inputs.len()], &mut features);
            let mut command = [0.0; MAX_OUTPUTS];
            let mean = controller.policy().mean(features.as_slice());
            for ((to, mean), limit) in command.iter_mut().zip(mean).zip(limits) {
                *to = mean.clamp(-limit, limit);
            }
            let outcome = arm.advance(tick, &command[..plan.outputs.len()]);
            (arm.angles().to_vec(), f64::from(outcome.measures[0]))
        })
        .collect()
}

/// By how much the directions of two runs' segments differ on average, rad.
fn difference(a: &OpenLoopRun, b: &OpenLoopRun) -> f64 {
    let pairs = || a.test.iter().zip(&b.test).flat_map(|((a, _), (b, _))| a.iter().zip(b));
    let turn = |(a, b): (&f32, &f32)| {
        let d = (f64::from(*a) - f64::from(*b)).rem_euclid(TAU);
        if d > PI { TAU - d } else { d }
    };
    pairs().map(turn).sum::<f64>() / pairs().count() as f64
}

/// Groups of runs that are linked by small differences.
fn ways(runs: &[OpenLoopRun]) -> Vec<usize> {
    let mut ways: Vec<usize> = (0..runs.len()).collect();
    for i in 0..runs.len() {
        for j in 0..i {
            if difference(&runs[i], &runs[j]) < SAME {
                let (from, to) = (ways[i].max(ways[j]), ways[i].min(ways[j]));
                ways.iter_mut().filter(|w| **w == from).for_each(|w| *w = to);
            }
        }
    }
    // Numbered in the order of their first seeds, from 1.
    let mut firsts = Vec::new();
    ways.iter()
        .map(|way| match firsts.iter().position(|first| first == way) {
            Some(at) => at + 1,
            None => {
                firsts.push(*way);
                firsts.len()
            }
        })
        .collect()
}

fn arm(segments: usize, plan: &Plan, runs: &[OpenLoopRun]) -> Option<OpenLoopArm> {
    let mean = |windows: &[(u64, f64)]| {
        let n: u64 = windows.iter().map(|w| w.0).sum();
        windows.iter().map(|w| w.1).sum::<f64>() / n as f64
    };
    let twentieth = |run: &OpenLoopRun| run.windows.len().div_ceil(20);
    let pairs = (0..runs.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
    Some(OpenLoopArm {
        scenario: plan.scenario.name.clone(),
        segments,
        ticks: plan.scenario.ticks,
        first_error_m: Spread::of(runs.iter().map(|r| mean(&r.windows[..twentieth(r)])))?,
        last_error_m: Spread::of(runs.iter().map(|r| mean(&r.windows[r.windows.len() - twentieth(r)..])))?,
        test_error_m: Spread::of(runs.iter().map(|r| r.test.iter().map(|t| t.1).sum::<f64>() / TARGETS as f64))?,
        difference_rad: Spread::of(pairs.map(|(i, j)| difference(&runs[i], &runs[j]))),
        ways: ways(runs),
        weights_hash: runs.iter().map(|r| r.hash.clone()).collect(),
        diverged: runs.iter().map(|r| r.diverged).collect(),
    })
}

fn curve(run: &OpenLoopRun) -> Polyline {
    let mut upto = 0;
    let point = |(n, error): &(u64, f64)| {
        upto += n;
        ((upto as f64 - *n as f64 / 2.0) / 1e6, error / *n as f64)
    };
    run.windows.iter().map(point).collect()
}

fn draw(result: &OpenLoopResult, plans: &[Plan], runs: &[OpenLoopRun], per_arm: usize) -> Result<(), StudyError> {
    let row = |(arm, (plans, runs)): (&OpenLoopArm, (&[Plan], &[OpenLoopRun]))| {
        let table = plans[0].scenario.plant.arm.clone().unwrap_or_default();
        let mut body = Arm::new(&table, 1.0, TEST_SEED);
        let way = |target: usize| {
            body.sense(target as u64, &mut [0.0; MAX_INPUTS]);
            SeedPostures {
                target: body.target().map(f64::from),
                postures: runs.iter().map(|run| posture(&table, &run.test[target].0)).collect(),
            }
        };
        PosturesRow {
            name: format!("{} segments", arm.segments),
            curves: runs.iter().map(curve).collect(),
            ways: (0..SHOWN).map(way).collect(),
        }
    };
    let figure = PosturesFigure {
        title: format!("Open-loop arm, {}: one colour a seed", result.runs),
        rows: result.arms.iter().zip(plans.chunks(per_arm).zip(runs.chunks(per_arm))).map(row).collect(),
    };
    Ok(draw_ways(&figure, &result.figure)?)
}

fn write_tables(result: &OpenLoopResult, runs: &[OpenLoopRun], per_arm: usize) -> Result<(), StudyError> {
    let mut curves = vec!["segments,seed,upto,error_m".to_owned()];
    let mut postures = vec!["segments,seed,way,target,error_m,directions_rad".to_owned()];
    for (arm, runs) in result.arms.iter().zip(runs.chunks(per_arm)) {
        for ((run, seed), way) in runs.iter().zip(&result.seeds).zip(&arm.ways) {
            let mut upto = 0;
            for (n, error) in &run.windows {
                upto += n;
                curves.push(format!("{},{seed},{upto},{}", arm.segments, error / *n as f64));
            }
            for (target, (directions, error)) in run.test.iter().enumerate() {
                let directions: Vec<_> = directions.iter().map(f32::to_string).collect();
                postures.push(format!("{},{seed},{way},{target},{error},{}", arm.segments, directions.join(" ")));
            }
        }
    }
    write_lines(&result.csv[0], curves)?;
    write_lines(&result.csv[1], postures)
}

impl OpenLoopResult {
    /// One JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// The table for people.
    pub fn to_text(&self) -> String {
        let mut text = format!("open-loop arm, {}: {:.1} s\n\n", self.runs, self.seconds);
        let head =
            ["segments", "trials", "error at first (m)", "at the end (m)", "without noise (m)", "ways", "apart (rad)"];
        let mut rows = vec![head.map(str::to_owned).to_vec()];
        for arm in &self.arms {
            rows.push(vec![
                arm.segments.to_string(),
                thousands(arm.ticks),
                in_words(Some(arm.first_error_m)),
                in_words(Some(arm.last_error_m)),
                in_words(Some(arm.test_error_m)),
                arm.ways.iter().max().map_or("-".to_owned(), usize::to_string),
                in_words(arm.difference_rad),
            ]);
        }
        text.push_str(&columns(&rows));
        let _ = writeln!(
            text,
            "\nmedian over seeds (least to largest); ways: groups of seeds whose segments differ by less than {} rad\n\
             apart: how far the segments' directions of two seeds differ; {} rad if they have nothing in common",
            SAME,
            figures(Some(PI / 2.0)),
        );
        for arm in &self.arms {
            for (seed, tick) in self.seeds.iter().zip(&arm.diverged) {
                if let Some(tick) = tick {
                    let _ = writeln!(text, "{} segments, seed {seed} diverged at trial {tick}", arm.segments);
                }
            }
        }
        let _ = writeln!(text, "figure  {}", self.figure.display());
        for csv in &self.csv {
            let _ = writeln!(text, "table   {}", csv.display());
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(directions: [f32; 2]) -> OpenLoopRun {
        OpenLoopRun {
            windows: Vec::new(),
            test: vec![(directions.to_vec(), 0.0); 3],
            hash: String::new(),
            diverged: None,
        }
    }

    #[test]
    fn ways_are_told_apart_also_across_the_turn() {
        let runs = [run([3.1, 0.0]), run([0.0, 0.0]), run([-3.1, 0.1]), run([0.1, 0.0])];
        assert!((difference(&runs[0], &runs[2]) - (TAU - 6.2 + 0.1) / 2.0).abs() < 1e-6);
        assert_eq!(ways(&runs), [1, 2, 1, 2]);
    }
}
