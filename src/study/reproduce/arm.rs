//! The closed-loop arm (paper section 4.2, figure 4): 12 million ticks, joint 3 blocked at 9.3 million.
//!
//! The reward charges angular rates, and a blocked joint has none. Runs that reach the block are made a second time
//! with the other reading, in which its command is charged ([`ArmRewardConfig::blocked_pays`]); until then they are
//! equal.

use std::fmt::Write as _;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::ReproduceSettings;
use super::experiment::{Experiment, ExperimentFacts, LearnerEnd, run, seeds_in_words};
use crate::report::Reach;
use crate::report::figure::{LossFigure, draw_loss};
use crate::runtime::{RunStatistics, Snapshot, Switch};
use crate::scenario::{ArmConfig, ArmRewardConfig, Plan};
use crate::stats::{Spread, Window};
use crate::study::text::{cells, csv_cell, push_divergences, push_files, spread_in_words, write_lines};
use crate::study::{JobProgress, StudyEnd, StudyError, exact};
use crate::supervise::reach;
use crate::text::{columns, thousands};

/// Ticks per row of the table.
const ROW: u64 = 1_000_000;
/// Least number of points of a curve, unless the run has fewer ticks.
const POINTS: u64 = 400;

/// One row of the table: means per tick over the ticks since the row before.
#[derive(Debug, Clone, Serialize)]
struct ArmRow {
    /// Last tick of the row, exclusive.
    upto: u64,
    /// Loss.
    loss: Spread,
    /// Loss without the cost of exploration noise alone.
    loss_without_noise: Spread,
    /// Root mean square error, m.
    rms_error_m: Option<Spread>,
    /// Mean error at the end of a target, m; null where no target ended.
    end_error_m: Option<Spread>,
}

/// The result of [`arm`].
#[derive(Debug, Clone, Serialize)]
pub struct ArmResult {
    /// The scenario.
    scenario: String,
    /// The seeds, in the order of all lists.
    seeds: Vec<u64>,
    /// Ticks of each run.
    ticks: u64,
    /// The tick at which joint 3 blocked; null where the run ended before.
    block_tick: Option<u64>,
    /// One row per million ticks.
    windows: Vec<ArmRow>,
    /// The same rows where the command of the blocked joint costs; empty where the run ended before the block.
    windows_blocked_pays: Vec<ArmRow>,
    /// XXH3-64 of the final weights, one per seed.
    weights_hash: Vec<String>,
    /// The tick at which the weights were no longer numbers, one per seed; null where they are.
    diverged: Vec<Option<u64>>,
    /// The seed whose postures the figure shows: the median one by its loss at the end.
    shown_seed: u64,
    #[serde(flatten)]
    facts: ExperimentFacts,
    /// The figure.
    figure: PathBuf,
    /// The tables.
    csv: Vec<PathBuf>,
}

/// The run of one seed.
#[derive(Serialize, Deserialize)]
struct ArmRun {
    #[serde(with = "exact::windows")]
    windows: Vec<Window>,
    switches: FigureSwitches,
    end: LearnerEnd,
}

/// The target switches that figure 4 shows: at first, before the block, after it, at the end.
type FigureSwitches = [Vec<Snapshot>; 4];

/// Runs the arm of scenario `paper`.
///
/// # Errors
/// When the folder or a file cannot be written, or a signal ended the study.
pub fn arm(settings: &ReproduceSettings) -> Result<StudyEnd<ArmResult>, StudyError> {
    let mut plans = settings.plans("paper", |_| {})?;
    if blocks(&plans[0]) {
        let pays = |arm: &mut ArmConfig| arm.reward = ArmRewardConfig { blocked_pays: true, ..arm.reward.clone() };
        plans.extend(settings.plans("paper", |scenario| scenario.plant.arm.iter_mut().for_each(pays))?);
    }
    let experiment = match settings.run("arm", plans, run_arm)? {
        StudyEnd::Whole(experiment) => experiment,
        StudyEnd::Part(part) => return Ok(StudyEnd::Part(part)),
    };
    let [runs, _] = readings(&experiment);
    let shown = median_run(runs);
    let result = result(settings, &experiment, experiment.plans[shown].scenario.seed);
    draw_loss(&figure(&result, &experiment, shown), &result.figure)?;
    write_tables(&result, runs)?;
    result.facts.write_json(&result.to_json())?;
    Ok(StudyEnd::Whole(result))
}

fn result(settings: &ReproduceSettings, experiment: &Experiment<ArmRun>, shown_seed: u64) -> ArmResult {
    let Experiment { plans, facts, .. } = experiment;
    let [runs, paying] = readings(experiment);
    let ticks = plans[0].scenario.ticks;
    let (weights_hash, diverged) = LearnerEnd::lists(runs.iter().map(|run| &run.end));
    ArmResult {
        scenario: plans[0].scenario.name.clone(),
        seeds: settings.seeds(),
        ticks,
        block_tick: block_tick(&plans[0]).filter(|_| blocks(&plans[0])),
        windows: rows(runs, ticks),
        windows_blocked_pays: rows(paying, ticks),
        weights_hash,
        diverged,
        shown_seed,
        figure: facts.path("figure.svg"),
        csv: vec![facts.path("windows.csv"), facts.path("curve.csv")],
        facts: facts.clone(),
    }
}

/// The runs in which a blocked joint pays nothing, and those in which its command does, if there are any.
fn readings(experiment: &Experiment<ArmRun>) -> [&[ArmRun]; 2] {
    let mut variants = experiment.variants().map(|(_, runs)| runs);
    [(); 2].map(|()| variants.next().unwrap_or_default())
}

fn block_tick(plan: &Plan) -> Option<u64> {
    plan.scenario.plant.arm.as_ref()?.block.first().map(|b| b.tick)
}

/// Whether the run reaches the block.
fn blocks(plan: &Plan) -> bool {
    block_tick(plan).is_some_and(|tick| tick < plan.scenario.ticks)
}

/// Ticks of a window: short enough for a curve, and a divisor of a row's ticks.
fn window_ticks(ticks: u64) -> u64 {
    let steps = [20_000, 10_000, 5_000, 2_000, 1_000, 500, 200, 100, 50, 20, 10, 5, 2];
    steps.into_iter().find(|s| ticks / s >= POINTS).unwrap_or(1)
}

fn run_arm(plan: &Plan, progress: &JobProgress) -> ArmRun {
    let block = block_tick(plan).unwrap_or(u64::MAX);
    let mut statistics = RunStatistics::with_windows(plan, window_ticks(plan.scenario.ticks));
    let mut switch = Switch::default();
    let mut switches = FigureSwitches::default();
    let end = run(plan, progress, |observation, _| {
        statistics.observe(observation);
        if let Some(switch) = switch.observe(observation) {
            let panel = match switch[0].tick {
                _ if switches[0].is_empty() => 0,
                from if from < block => 1,
                _ if switches[2].is_empty() => 2,
                _ => 3,
            };
            switches[panel] = switch.to_vec();
        }
    });
    ArmRun { windows: statistics.finish(0).windows, switches, end }
}

/// The run with the median loss in its last window.
fn median_run(runs: &[ArmRun]) -> usize {
    let mut order: Vec<usize> = (0..runs.len()).collect();
    let loss = |i: &usize| runs[*i].windows.last().map_or(f64::NAN, |w| w.loss);
    order.sort_by(|a, b| loss(a).total_cmp(&loss(b)));
    order[(order.len() - 1) / 2]
}

/// Merges the windows of one run into rows of a million ticks.
fn by_row(windows: &[Window]) -> Vec<Window> {
    let same_row = |a: &Window, b: &Window| a.from / ROW == b.from / ROW;
    windows
        .chunk_by(same_row)
        .filter_map(|row| row.iter().skip(1).fold(row.first().cloned(), |sum, w| sum.map(|s| s.and(w))))
        .collect()
}

fn rows(runs: &[ArmRun], ticks: u64) -> Vec<ArmRow> {
    let rows: Vec<Vec<Window>> = runs.iter().map(|run| by_row(&run.windows)).collect();
    let count = rows.iter().map(Vec::len).max().unwrap_or(0);
    let row = |i: usize| {
        let windows: Vec<&Window> = rows.iter().filter_map(|rows| rows.get(i)).collect();
        let spread = |value: &dyn Fn(&Window) -> Option<f64>| Spread::of(windows.iter().filter_map(|w| value(w)));
        Some(ArmRow {
            upto: ((i as u64 + 1) * ROW).min(ticks),
            loss: spread(&|w| Some(w.loss))?,
            loss_without_noise: spread(&|w| Some(w.loss_without_noise()))?,
            rms_error_m: spread(&Window::rms_error),
            end_error_m: spread(&|w| w.end_error),
        })
    };
    (0..count).filter_map(row).collect()
}

fn figure(result: &ArmResult, experiment: &Experiment<ArmRun>, shown: usize) -> LossFigure {
    let Experiment { plans, .. } = experiment;
    let [runs, paying] = readings(experiment);
    let windows = |runs: &[ArmRun]| runs.iter().map(|run| run.windows.clone()).collect::<Vec<_>>();
    let config: ArmConfig = plans[0].scenario.plant.arm.clone().unwrap_or_default();
    let reaches: [Option<Reach>; 4] = std::array::from_fn(|i| reach(&config, &runs[shown].switches[i]));
    let names = ["(a) at first", "(b) after learning", "(c) after the damage", "(d) after recovery"];
    LossFigure {
        title: format!("Closed-loop arm, {}: median and span over seeds", seeds_in_words(&result.seeds)),
        period_s: plans[0].period_ns as f64 / 1e9,
        runs: windows(runs),
        other: (!paying.is_empty()).then(|| ("if a blocked joint's command cost".to_owned(), windows(paying))),
        mark: result.block_tick.map(|tick| (tick, "joint 3 blocked".to_owned())),
        reaches: names.into_iter().zip(reaches).filter_map(|(name, r)| Some((name.to_owned(), r?))).collect(),
    }
}

fn write_tables(result: &ArmResult, runs: &[ArmRun]) -> Result<(), StudyError> {
    let head = "seed,from,ticks,loss,loss_without_noise,rms_error_m,end_error_m,cumulative_loss";
    let lines = |windows: &dyn Fn(&ArmRun) -> Vec<Window>| {
        let mut lines = vec![head.to_owned()];
        for (run, seed) in runs.iter().zip(&result.seeds) {
            let mut cumulative = 0.0;
            for w in windows(run) {
                cumulative += w.loss * w.ticks as f64;
                let (rms, end) = (csv_cell(w.rms_error()), csv_cell(w.end_error));
                let mut line = format!("{seed},{},{},{},{}", w.from, w.ticks, w.loss, w.loss_without_noise());
                let _ = write!(line, ",{rms},{end},{cumulative}");
                lines.push(line);
            }
        }
        lines
    };
    write_lines(&result.csv[0], &lines(&|run| by_row(&run.windows)))?;
    write_lines(&result.csv[1], &lines(&|run| run.windows.clone()))
}

impl ArmResult {
    /// The result as one JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// The result as a table for people.
    pub fn to_text(&self) -> String {
        let total = self.ticks * self.seeds.len() as u64;
        let seconds = self.facts.seconds;
        let mut text = format!(
            "closed-loop arm, {} of {} ticks each: {seconds:.1} s, {} ticks/s\n\n",
            seeds_in_words(&self.seeds),
            thousands(self.ticks),
            thousands((total as f64 / seconds.max(1e-9)).round() as u64),
        );
        text.push_str(&table(&self.windows));
        text.push_str("\nmedian over seeds (least to largest); means over each million ticks\n");
        if let Some(tick) = self.block_tick {
            let _ = writeln!(text, "joint 3 blocked at tick {}", thousands(tick));
            let from = self.windows_blocked_pays.iter().position(|row| row.upto > tick).unwrap_or(0);
            let _ = writeln!(text, "\nif the command of the blocked joint cost as if the joint turned:");
            text.push_str(&table(&self.windows_blocked_pays[from..]));
        }
        push_divergences(&mut text, "", "tick", &self.seeds, &self.diverged);
        push_files(&mut text, Some(&self.figure), &self.csv);
        text
    }
}

fn table(windows: &[ArmRow]) -> String {
    let head = ["up to tick", "loss a tick", "without noise", "RMS error (m)", "error at a target's end (m)"];
    let row = |row: &ArmRow| {
        vec![
            thousands(row.upto),
            spread_in_words(Some(row.loss)),
            spread_in_words(Some(row.loss_without_noise)),
            spread_in_words(row.rms_error_m),
            spread_in_words(row.end_error_m),
        ]
    };
    columns(&std::iter::once(cells(head)).chain(windows.iter().map(row)).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_whole_numbers_of_windows() {
        for ticks in [2, 100, 5_000, 20_000, 123_456, 1_000_000, 12_000_000] {
            let window = window_ticks(ticks);
            assert!(ROW.is_multiple_of(window), "{ticks}");
            assert!(ticks / window >= POINTS.min(ticks), "{ticks}");
            assert!(ticks / window <= 3 * POINTS, "{ticks}");
        }
    }
}
