//! The open-loop arm (paper section 4.2). The paper omits its results: with 3 and 4 segments every run finds
//! other postures for the same targets.
//!
//! A tick is a trial: a target appears, the command turns the joints from 0 to a posture, and the reward is
//! the negative squared error of the end-effector. The controller sees only the target, so it learns one
//! posture per target. A fixed set of targets, without exploration noise, shows how these postures differ
//! between seeds.

use std::f64::consts::{PI, TAU};
use std::fmt::Write as _;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::ReproduceSettings;
use super::experiment::{Experiment, ExperimentFacts, LearnerEnd, run, seeds_in_words};
use super::trial_windows::{TrialWindows, mean};
use crate::agent::ShippedAgent;
use crate::plant::{Arm, Plant, posture};
use crate::reference::{FrozenAgent, Rollout, TEST_SEED};
use crate::report::figure::{PosturesFigure, PosturesRow, SeedPostures, draw_ways};
use crate::scenario::Plan;
use crate::stats::Spread;
use crate::study::text::{cells, push_divergences, push_files, spread_in_words, write_lines};
use crate::study::{JobProgress, StudyEnd, StudyError, exact};
use crate::text::{columns, figures, thousands};
use crate::wire::MAX_INPUTS;

/// The scenarios, with their numbers of segments.
const SCENARIOS: [(&str, usize); 2] = [("open-loop-3", 3), ("open-loop-4", 4)];
/// Points of a curve.
const POINTS: u64 = 200;
/// Number of targets in the test.
const TARGETS: usize = 60;
/// Number of targets that the figure shows: the first ones of the test.
const SHOWN: usize = 3;
/// Two seeds are of one group if their segments' directions differ by less than this on average, rad.
const SAME: f64 = 0.35;

/// The results for one number of segments.
#[derive(Debug, Clone, Serialize)]
struct OpenLoopArm {
    /// The scenario.
    scenario: String,
    /// Number of segments.
    segments: usize,
    /// Trials of each run.
    ticks: u64,
    /// Mean error over the first twentieth of the trials, with exploration noise, m.
    first_error_m: Spread,
    /// Mean error over the last twentieth of the trials, with exploration noise, m.
    last_error_m: Spread,
    /// Mean error of the noiseless postures for the test's targets, m.
    test_error_m: Spread,
    /// For every two seeds, the mean difference of their segments' directions over the test's targets, rad.
    /// 0: the same postures; pi / 2: unrelated postures.
    difference_rad: Option<Spread>,
    /// The group of each seed, in the order of the seeds: seeds with the same number found the same postures.
    ways: Vec<usize>,
    /// XXH3-64 of the final weights, one per seed.
    weights_hash: Vec<String>,
    /// The trial at which the weights were no longer numbers, one per seed; null where they are.
    diverged: Vec<Option<u64>>,
}

/// The result of [`open_loop`].
#[derive(Debug, Clone, Serialize)]
pub struct OpenLoopResult {
    /// The seeds, in the order of all lists.
    seeds: Vec<u64>,
    /// The arms.
    arms: Vec<OpenLoopArm>,
    #[serde(flatten)]
    facts: ExperimentFacts,
    /// The figure.
    figure: PathBuf,
    /// The tables.
    csv: Vec<PathBuf>,
}

/// The run of one seed.
#[derive(Serialize, Deserialize)]
struct OpenLoopRun {
    windows: TrialWindows,
    /// One posture per target of the test.
    test: Vec<TestPosture>,
    end: LearnerEnd,
}

/// The noiseless posture for one target.
#[derive(Clone, Serialize, Deserialize)]
struct TestPosture {
    /// Directions of the segments, rad.
    directions: Vec<f32>,
    /// Distance between end-effector and target, m.
    #[serde(with = "exact")]
    error: f64,
}

/// Runs the open-loop arms.
///
/// # Errors
/// When the folder or a file cannot be written, or a signal ended the study.
pub fn open_loop(settings: &ReproduceSettings) -> Result<StudyEnd<OpenLoopResult>, StudyError> {
    let mut plans = Vec::new();
    for (name, _) in SCENARIOS {
        plans.extend(settings.plans(name, |_| {})?);
    }
    let experiment = match settings.run("open loop", plans, run_open_loop)? {
        StudyEnd::Whole(experiment) => experiment,
        StudyEnd::Part(part) => return Ok(StudyEnd::Part(part)),
    };
    let facts = &experiment.facts;
    let arms = SCENARIOS.iter().zip(experiment.variants());
    let result = OpenLoopResult {
        seeds: settings.seeds(),
        arms: arms.filter_map(|((_, segments), (plan, runs))| arm(*segments, plan, runs)).collect(),
        figure: facts.path("figure.svg"),
        csv: vec![facts.path("curve.csv"), facts.path("postures.csv")],
        facts: facts.clone(),
    };
    draw_ways(&figure(&result, &experiment), &result.figure)?;
    write_tables(&result, &experiment)?;
    result.facts.write_json(&result.to_json())?;
    Ok(StudyEnd::Whole(result))
}

fn run_open_loop(plan: &Plan, progress: &JobProgress) -> OpenLoopRun {
    let trials = plan.scenario.ticks;
    let mut windows = TrialWindows::new(trials, POINTS);
    let mut test = Vec::new();
    let end = run(plan, progress, |observation, controller| {
        windows.observe(observation);
        if observation.header.tick + 1 == trials {
            test = noiseless_postures(plan, controller.agent());
        }
    });
    OpenLoopRun { windows, test, end }
}

/// The postures for the test's targets without exploration noise.
fn noiseless_postures(plan: &Plan, agent: &ShippedAgent) -> Vec<TestPosture> {
    let config = plan.scenario.plant.arm.clone().unwrap_or_default();
    let mut rollout = Rollout::new(Arm::new(&config, plan.period_ns as f64 / 1e9, TEST_SEED), plan);
    let mut frozen = FrozenAgent::of(agent, plan);
    (0..TARGETS as u64)
        .map(|tick| {
            rollout.sense(tick);
            let outcome = rollout.advance(tick, |seen| frozen.command(seen));
            TestPosture { directions: rollout.plant().angles().to_vec(), error: f64::from(outcome.measures[0]) }
        })
        .collect()
}

/// The mean difference of the directions of two runs' segments, rad.
fn difference(a: &OpenLoopRun, b: &OpenLoopRun) -> f64 {
    let pairs = || a.test.iter().zip(&b.test).flat_map(|(a, b)| a.directions.iter().zip(&b.directions));
    let angle = |(a, b): (&f32, &f32)| {
        let d = (f64::from(*a) - f64::from(*b)).rem_euclid(TAU);
        if d > PI { TAU - d } else { d }
    };
    pairs().map(angle).sum::<f64>() / pairs().count() as f64
}

/// Groups of runs that are linked by small differences, numbered from 1 in the order of their first seeds.
fn groups(runs: &[OpenLoopRun]) -> Vec<usize> {
    let mut groups: Vec<usize> = (0..runs.len()).collect();
    for i in 0..runs.len() {
        for j in 0..i {
            if difference(&runs[i], &runs[j]) < SAME {
                let (from, to) = (groups[i].max(groups[j]), groups[i].min(groups[j]));
                groups.iter_mut().filter(|group| **group == from).for_each(|group| *group = to);
            }
        }
    }
    let mut firsts = Vec::new();
    groups
        .iter()
        .map(|group| match firsts.iter().position(|first| first == group) {
            Some(at) => at + 1,
            None => {
                firsts.push(*group);
                firsts.len()
            }
        })
        .collect()
}

fn arm(segments: usize, plan: &Plan, runs: &[OpenLoopRun]) -> Option<OpenLoopArm> {
    let first = |run: &OpenLoopRun| {
        let windows = &run.windows.windows;
        mean(&windows[..windows.len().div_ceil(20)], |w| w.error)
    };
    let last = |run: &OpenLoopRun| {
        let windows = &run.windows.windows;
        mean(&windows[windows.len() - windows.len().div_ceil(20)..], |w| w.error)
    };
    let test = |run: &OpenLoopRun| run.test.iter().map(|t| t.error).sum::<f64>() / TARGETS as f64;
    let pairs = (0..runs.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
    let (weights_hash, diverged) = LearnerEnd::lists(runs.iter().map(|run| &run.end));
    Some(OpenLoopArm {
        scenario: plan.scenario.name.clone(),
        segments,
        ticks: plan.scenario.ticks,
        first_error_m: Spread::of(runs.iter().map(first))?,
        last_error_m: Spread::of(runs.iter().map(last))?,
        test_error_m: Spread::of(runs.iter().map(test))?,
        difference_rad: Spread::of(pairs.map(|(i, j)| difference(&runs[i], &runs[j]))),
        ways: groups(runs),
        weights_hash,
        diverged,
    })
}

fn figure(result: &OpenLoopResult, experiment: &Experiment<OpenLoopRun>) -> PosturesFigure {
    let row = |(arm, (plan, runs)): (&OpenLoopArm, (&Plan, &[OpenLoopRun]))| {
        let config = plan.scenario.plant.arm.clone().unwrap_or_default();
        let mut body = Arm::new(&config, 1.0, TEST_SEED);
        let postures = |target: usize| {
            body.sense(target as u64, &mut [0.0; MAX_INPUTS]);
            SeedPostures {
                target: body.target().map(f64::from),
                postures: runs.iter().map(|run| posture(&config, &run.test[target].directions)).collect(),
            }
        };
        PosturesRow {
            name: format!("{} segments", arm.segments),
            curves: runs.iter().map(|run| run.windows.error_curve()).collect(),
            ways: (0..SHOWN).map(postures).collect(),
        }
    };
    PosturesFigure {
        title: format!("Open-loop arm, {}: one colour a seed", seeds_in_words(&result.seeds)),
        rows: result.arms.iter().zip(experiment.variants()).map(row).collect(),
    }
}

fn write_tables(result: &OpenLoopResult, experiment: &Experiment<OpenLoopRun>) -> Result<(), StudyError> {
    let mut curves = vec!["segments,seed,upto,error_m".to_owned()];
    let mut postures = vec!["segments,seed,way,target,error_m,directions_rad".to_owned()];
    for (arm, (_, runs)) in result.arms.iter().zip(experiment.variants()) {
        let segments = arm.segments;
        for ((run, seed), group) in runs.iter().zip(&result.seeds).zip(&arm.ways) {
            for (upto, window) in run.windows.with_ends() {
                curves.push(format!("{segments},{seed},{upto},{}", window.error / window.trials as f64));
            }
            for (target, TestPosture { directions, error }) in run.test.iter().enumerate() {
                let directions: Vec<_> = directions.iter().map(f32::to_string).collect();
                postures.push(format!("{segments},{seed},{group},{target},{error},{}", directions.join(" ")));
            }
        }
    }
    write_lines(&result.csv[0], &curves)?;
    write_lines(&result.csv[1], &postures)
}

impl OpenLoopResult {
    /// The result as one JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// The result as a table for people.
    pub fn to_text(&self) -> String {
        let mut text = format!("open-loop arm, {}: {:.1} s\n\n", seeds_in_words(&self.seeds), self.facts.seconds);
        let head =
            ["segments", "trials", "error at first (m)", "at the end (m)", "without noise (m)", "ways", "apart (rad)"];
        let mut rows = vec![cells(head)];
        for arm in &self.arms {
            rows.push(vec![
                arm.segments.to_string(),
                thousands(arm.ticks),
                spread_in_words(Some(arm.first_error_m)),
                spread_in_words(Some(arm.last_error_m)),
                spread_in_words(Some(arm.test_error_m)),
                arm.ways.iter().max().map_or("-".to_owned(), usize::to_string),
                spread_in_words(arm.difference_rad),
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
            let name = format!("{} segments, ", arm.segments);
            push_divergences(&mut text, &name, "trial", &self.seeds, &arm.diverged);
        }
        push_files(&mut text, Some(&self.figure), &self.csv);
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(directions: [f32; 2]) -> OpenLoopRun {
        OpenLoopRun {
            windows: TrialWindows::default(),
            test: vec![TestPosture { directions: directions.to_vec(), error: 0.0 }; 3],
            end: LearnerEnd { weights_hash: String::new(), diverged_at: None },
        }
    }

    #[test]
    fn groups_are_separated_also_across_the_wrap_of_angles() {
        let runs = [run([3.1, 0.0]), run([0.0, 0.0]), run([-3.1, 0.1]), run([0.1, 0.0])];
        assert!((difference(&runs[0], &runs[2]) - (TAU - 6.2 + 0.1) / 2.0).abs() < 1e-6);
        assert_eq!(groups(&runs), [1, 2, 1, 2]);
    }
}
