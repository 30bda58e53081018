//! The closed-loop arm (paper section 4.2, figure 4): 12 million ticks, joint 3 blocked at 9.3 million.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::PathBuf;

use serde::Serialize;

use super::{ReproduceSettings, StudyError, cell, in_words, write_lines};
use crate::clock::{facts, monotonic_ns};
use crate::plant::SimulatedPlant;
use crate::report::figure::{LossFigure, draw_loss};
use crate::report::{Reach, Window, columns, thousands};
use crate::runtime::{RunStatistics, Snapshot, Switch, in_process_seen};
use crate::scenario::{ArmConfig, Plan, Scenario};
use crate::study::{JobProgress, Spread};
use crate::supervise::reach;

/// Ticks of a row of the table.
const ROW: u64 = 1_000_000;
/// Points of a curve, at least, unless the run has fewer ticks.
const POINTS: u64 = 400;
/// Ticks between two reports of progress.
const REPORT: u64 = 4096;

/// One row of the table: means a tick over the ticks since the row before.
#[derive(Debug, Clone, Serialize)]
pub struct ArmRow {
    /// Up to this tick.
    pub upto: u64,
    /// Loss.
    pub loss: Spread,
    /// Loss without what exploration noise alone costs.
    pub loss_without_noise: Spread,
    /// Root mean square error, m.
    pub rms_error_m: Option<Spread>,
    /// Mean error at the end of a target, m; null where none ended.
    pub end_error_m: Option<Spread>,
}

/// What came out.
#[derive(Debug, Clone, Serialize)]
pub struct ArmResult {
    /// The scenario.
    pub scenario: String,
    /// The seeds.
    pub seeds: Vec<u64>,
    /// The same in words.
    #[serde(skip)]
    runs: String,
    /// Ticks of each run.
    pub ticks: u64,
    /// The tick at which joint 3 blocked; null where the run was over before.
    pub block_tick: Option<u64>,
    /// One row a million ticks.
    pub windows: Vec<ArmRow>,
    /// XXH3-64 of the final weights, one a seed.
    pub weights_hash: Vec<String>,
    /// The tick at which the weights were no longer numbers, one a seed; null where they are.
    pub diverged: Vec<Option<u64>>,
    /// The seed whose postures the figure shows: the one in the middle by its loss at the end.
    pub shown_seed: u64,
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
struct ArmRun {
    windows: Vec<Window>,
    /// The target switches of figure 4: at first, before the block, after it, at the end.
    switches: [Vec<Snapshot>; 4],
    hash: String,
    diverged: Option<u64>,
}

/// Runs the arm of scenario `paper`.
///
/// # Errors
/// When the folder cannot be used, a file not be written, or a signal came.
pub fn arm(settings: &ReproduceSettings) -> Result<ArmResult, StudyError> {
    let plans = plans(settings)?;
    let pool = settings.pool()?;
    let folder = settings.folder("reproduce-arm")?;
    let ticks = plans[0].scenario.ticks;
    let began = monotonic_ns();
    let runs = pool.work("arm", ticks * plans.len() as u64, &plans, run).map_err(StudyError::Signal)?;
    let seconds = (monotonic_ns() - began) as f64 / 1e9;
    folder.keep();

    let table = plans[0].scenario.plant.arm.clone().unwrap_or_default();
    let block = block(&plans[0]).filter(|&tick| tick < ticks);
    let shown = middle(&runs);
    let path = |name: &str| folder.path().join(name);
    let result = ArmResult {
        scenario: plans[0].scenario.name.clone(),
        seeds: settings.seeds(),
        runs: settings.in_words(),
        ticks,
        block_tick: block,
        windows: rows(&runs, ticks),
        weights_hash: runs.iter().map(|r| r.hash.clone()).collect(),
        diverged: runs.iter().map(|r| r.diverged).collect(),
        shown_seed: plans[shown].scenario.seed,
        seconds,
        machine: facts(),
        folder: folder.path().to_owned(),
        figure: path("figure.svg"),
        csv: vec![path("windows.csv"), path("curve.csv")],
    };
    draw_loss(&figure(&result, &runs, &table, plans[0].period_ns, &runs[shown]), &result.figure)?;
    write_tables(&result, &runs)?;
    let json = path("result.json");
    std::fs::write(&json, result.to_json()).map_err(StudyError::write(&json))?;
    Ok(result)
}

fn plans(settings: &ReproduceSettings) -> Result<Vec<Plan>, StudyError> {
    let plan = |seed| {
        let mut scenario = Scenario::built_in("paper")?;
        scenario.seed = seed;
        scenario.ticks = settings.ticks.unwrap_or(scenario.ticks);
        Ok(scenario.plan()?)
    };
    settings.seeds().into_iter().map(plan).collect()
}

fn block(plan: &Plan) -> Option<u64> {
    plan.scenario.plant.arm.as_ref()?.block.first().map(|b| b.tick)
}

/// Length of a window: fine enough for a curve, and a whole number of them makes a row.
fn step(ticks: u64) -> u64 {
    let steps = [20_000, 10_000, 5_000, 2_000, 1_000, 500, 200, 100, 50, 20, 10, 5, 2];
    steps.into_iter().find(|s| ticks / s >= POINTS).unwrap_or(1)
}

fn run(plan: &Plan, ticks: &JobProgress) -> ArmRun {
    let block = block(plan).unwrap_or(u64::MAX);
    let mut statistics = RunStatistics::with_windows(plan, step(plan.scenario.ticks));
    let mut switch = Switch::default();
    let mut switches: [Vec<Snapshot>; 4] = Default::default();
    let Some(body) = SimulatedPlant::of(plan) else { unreachable!("the built-in arm is the simulator's") };
    let result = in_process_seen(plan, body, |observation, _| {
        statistics.observe(observation);
        if let Some(switch) = switch.see(observation) {
            let from = switch[0].tick;
            let place = match from {
                _ if switches[0].is_empty() => 0,
                _ if from < block => 1,
                _ if switches[2].is_empty() => 2,
                _ => 3,
            };
            switches[place] = switch.to_vec();
        }
        !observation.header.tick.is_multiple_of(REPORT) || ticks.report(REPORT)
    });
    let controller = result.controller;
    ArmRun {
        windows: statistics.finish(0).windows,
        switches,
        hash: controller.weights_hash,
        diverged: controller.diverged_at,
    }
}

/// The seed in the middle by the loss of its last row.
fn middle(runs: &[ArmRun]) -> usize {
    let mut order: Vec<usize> = (0..runs.len()).collect();
    let loss = |i: &usize| runs[*i].windows.last().map_or(f64::NAN, |w| w.loss);
    order.sort_by(|a, b| loss(a).total_cmp(&loss(b)));
    order[(order.len() - 1) / 2]
}

/// The windows of one run put together to rows of a million ticks.
fn by_row(windows: &[Window]) -> Vec<Window> {
    let same = |a: &Window, b: &Window| a.from / ROW == b.from / ROW;
    windows
        .chunk_by(same)
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

fn figure(result: &ArmResult, runs: &[ArmRun], table: &ArmConfig, period_ns: u64, shown: &ArmRun) -> LossFigure {
    let reaches: [Option<Reach>; 4] = std::array::from_fn(|i| reach(table, &shown.switches[i]));
    let names = ["(a) at first", "(b) after learning", "(c) after the damage", "(d) after recovery"];
    LossFigure {
        title: format!("Closed-loop arm, {}: median and span over seeds", result.runs),
        period_s: period_ns as f64 / 1e9,
        runs: runs.iter().map(|r| r.windows.clone()).collect(),
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
                let (rms, end) = (cell(w.rms_error()), cell(w.end_error));
                let mut line = format!("{seed},{},{},{},{}", w.from, w.ticks, w.loss, w.loss_without_noise());
                let _ = write!(line, ",{rms},{end},{cumulative}");
                lines.push(line);
            }
        }
        lines
    };
    write_lines(&result.csv[0], lines(&|run| by_row(&run.windows)))?;
    write_lines(&result.csv[1], lines(&|run| run.windows.clone()))
}

impl ArmResult {
    /// One JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// The table for people.
    pub fn to_text(&self) -> String {
        let total = self.ticks * self.seeds.len() as u64;
        let mut text = format!(
            "closed-loop arm, {} of {} ticks each: {:.1} s, {} ticks/s\n\n",
            self.runs,
            thousands(self.ticks),
            self.seconds,
            thousands((total as f64 / self.seconds.max(1e-9)).round() as u64),
        );
        let head = ["up to tick", "loss a tick", "without noise", "RMS error (m)", "error at a target's end (m)"];
        let mut rows = vec![head.map(str::to_owned).to_vec()];
        for row in &self.windows {
            rows.push(vec![
                thousands(row.upto),
                in_words(Some(row.loss)),
                in_words(Some(row.loss_without_noise)),
                in_words(row.rms_error_m),
                in_words(row.end_error_m),
            ]);
        }
        text.push_str(&columns(&rows));
        text.push_str("\nmedian over seeds (least to largest); means over each million ticks\n");
        if let Some(tick) = self.block_tick {
            let _ = writeln!(text, "joint 3 blocked at tick {}", thousands(tick));
        }
        for (seed, tick) in self.seeds.iter().zip(&self.diverged) {
            if let Some(tick) = tick {
                let _ = writeln!(text, "seed {seed} diverged at tick {}", thousands(*tick));
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

    #[test]
    fn windows_fit_into_rows() {
        for ticks in [2, 100, 5_000, 20_000, 123_456, 1_000_000, 12_000_000] {
            assert!(ROW.is_multiple_of(step(ticks)), "{ticks}");
            assert!(ticks / step(ticks) >= POINTS.min(ticks), "{ticks}");
            assert!(ticks / step(ticks) <= 3 * POINTS, "{ticks}");
        }
    }
}
