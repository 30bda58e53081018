//! The saccades (paper section 4.1, figure 2): a linear and a log-polar retina, each with scalar and topographic inputs.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::PathBuf;

use serde::Serialize;

use super::{ReproduceSettings, StudyError, in_words, write_lines};
use crate::clock::{facts, monotonic_ns};
use crate::report::figure::{ErrorFigure, ErrorPanel, Polyline, draw_miss};
use crate::report::{columns, figures, thousands};
use crate::runtime::in_process_seen;
use crate::scenario::{MapConfig, Plan, Retina, Scenario};
use crate::study::{JobProgress, Spread};

/// Points of a curve.
const POINTS: u64 = 300;
/// Rows of the table.
const ROWS: u64 = 6;
/// Trials of the paper.
const TRIALS: u64 = 3_000_000;
/// What of the step is left for scalar inputs, by retina. They have no norm of their own: a target far out, or an angle of pi,
/// makes a long feature vector. With the whole step four of five seeds of the linear eye diverge within two million trials;
/// with a seventh of it the log-polar eye still does within 250,000, and never learns to hit anyway.
const SCALAR_STEPS: [f64; 2] = [1.0 / 3.0, 1.0 / 30.0];
/// Ticks between two reports of progress.
const REPORT: u64 = 4096;

/// Mean error over the trials since the row before, in retina coordinates (the edge is at 1).
#[derive(Debug, Clone, Serialize)]
pub struct EyeRow {
    /// Up to this trial.
    pub upto: u64,
    /// Mean error a trial.
    pub error: Spread,
    /// Loss a trial, the reward with its sign turned.
    pub loss: Spread,
}

/// One of the four eyes.
#[derive(Debug, Clone, Serialize)]
pub struct EyeVariant {
    /// `linear` or `log-polar`.
    pub retina: &'static str,
    /// `scalar` or `topographic`.
    pub coding: &'static str,
    /// Rows of the table.
    pub windows: Vec<EyeRow>,
    /// XXH3-64 of the final weights, one a seed.
    pub weights_hash: Vec<String>,
    /// The trial at which the weights were no longer numbers, one a seed; null where they are.
    pub diverged: Vec<Option<u64>>,
}

/// What came out.
#[derive(Debug, Clone, Serialize)]
pub struct EyeResult {
    /// The seeds.
    pub seeds: Vec<u64>,
    /// The same in words.
    #[serde(skip)]
    runs: String,
    /// Trials of each run.
    pub ticks: u64,
    /// What the noise alone makes of a perfect saccade: the mean of a Rayleigh distribution.
    pub noise_alone: f64,
    /// The four eyes.
    pub variants: Vec<EyeVariant>,
    /// Seconds that all runs took together.
    pub seconds: f64,
    /// The machine.
    pub machine: BTreeMap<String, String>,
    /// The folder with the figure and the table.
    pub folder: PathBuf,
    /// The figure.
    pub figure: PathBuf,
    /// The table.
    pub csv: PathBuf,
}

const RETINAS: [(Retina, &str); 2] = [(Retina::Linear, "linear"), (Retina::LogPolar, "log-polar")];
const CODINGS: [&str; 2] = ["scalar", "topographic"];

/// What one seed of one eye gave.
struct EyeRun {
    /// Sums over windows: trials, error, loss.
    windows: Vec<(u64, f64, f64)>,
    hash: String,
    diverged: Option<u64>,
}

/// Runs the four eyes.
///
/// # Errors
/// When the folder cannot be used, a file not be written, or a signal came.
pub fn eye(settings: &ReproduceSettings) -> Result<EyeResult, StudyError> {
    let mut plans = Vec::new();
    for (retina, _) in RETINAS {
        for coding in CODINGS {
            for seed in settings.seeds() {
                plans.push(plan(retina, coding == "scalar", seed, settings.ticks.unwrap_or(TRIALS))?);
            }
        }
    }
    let pool = settings.pool()?;
    let folder = settings.folder("reproduce-eye")?;
    let trials = plans[0].scenario.ticks;
    let began = monotonic_ns();
    let runs = pool.work("eye", trials * plans.len() as u64, &plans, run).map_err(StudyError::Signal)?;
    let seconds = (monotonic_ns() - began) as f64 / 1e9;
    folder.keep();

    let names = RETINAS.iter().flat_map(|(_, retina)| CODINGS.map(|coding| (*retina, coding)));
    let by_variant: Vec<_> = names.zip(runs.chunks(settings.seeds as usize)).collect();
    let variant = |((retina, coding), runs): &((&'static str, &'static str), &[EyeRun])| EyeVariant {
        retina,
        coding,
        windows: rows(runs, trials),
        weights_hash: runs.iter().map(|r| r.hash.clone()).collect(),
        diverged: runs.iter().map(|r| r.diverged).collect(),
    };
    let sigma = plans[0].scenario.policy.sigma;
    let result = EyeResult {
        seeds: settings.seeds(),
        runs: settings.in_words(),
        ticks: trials,
        // Two outputs push along each axis.
        noise_alone: sigma * std::f64::consts::SQRT_2 * (std::f64::consts::PI / 2.0).sqrt(),
        variants: by_variant.iter().map(variant).collect(),
        seconds,
        machine: facts(),
        folder: folder.path().to_owned(),
        figure: folder.path().join("figure.svg"),
        csv: folder.path().join("curve.csv"),
    };
    let curves: Vec<Vec<Polyline>> = by_variant.iter().map(|(_, runs)| runs.iter().map(curve).collect()).collect();
    let panel = |(i, pair): (usize, &[Vec<Polyline>])| ErrorPanel {
        name: format!("{} retina", RETINAS[i].1),
        curves: CODINGS.iter().zip(pair).map(|(coding, runs)| ((*coding).to_owned(), runs.clone())).collect(),
    };
    let figure = ErrorFigure {
        title: format!("Saccades, {}: median and span over seeds", result.runs),
        panels: curves.chunks(CODINGS.len()).enumerate().map(panel).collect(),
        levels: vec![(result.noise_alone, "noise alone".to_owned())],
        y: "mean error (the retina's edge is at 1)".to_owned(),
    };
    draw_miss(&figure, &result.figure)?;
    let mut lines = vec!["retina,coding,seed,upto,error,loss".to_owned()];
    for ((retina, coding), runs) in &by_variant {
        for (run, seed) in runs.iter().zip(&result.seeds) {
            let mut upto = 0;
            for (n, error, loss) in &run.windows {
                upto += n;
                let n = *n as f64;
                lines.push(format!("{retina},{coding},{seed},{upto},{},{}", error / n, loss / n));
            }
        }
    }
    write_lines(&result.csv, lines)?;
    let json = folder.path().join("result.json");
    std::fs::write(&json, result.to_json()).map_err(StudyError::write(&json))?;
    Ok(result)
}

/// The scenario `eye` with another retina, and with or without its maps.
fn plan(retina: Retina, scalar: bool, seed: u64, trials: u64) -> Result<Plan, StudyError> {
    let mut scenario = Scenario::built_in("eye")?;
    (scenario.seed, scenario.ticks) = (seed, trials);
    let eye = scenario.plant.eye.get_or_insert_default();
    eye.retina = retina;
    let names = match retina {
        Retina::Linear => ["position_x", "position_y", "velocity_x", "velocity_y"],
        Retina::LogPolar => ["position_rho", "position_phi", "velocity_rho", "velocity_phi"],
    };
    let encoder = &mut scenario.encoder;
    encoder.maps.clear();
    if scalar {
        encoder.scalars = names.map(str::to_owned).to_vec();
        scenario.learner.alpha_over_variance *= SCALAR_STEPS[usize::from(retina == Retina::LogPolar)];
    } else {
        let map = |pair: &[&str]| MapConfig {
            inputs: pair.iter().map(|&name| name.to_owned()).collect(),
            units: vec![16, 16],
            radius: 0.5,
            ranges: Vec::new(),
        };
        encoder.maps = names.chunks(2).map(map).collect();
    }
    Ok(scenario.plan()?)
}

fn run(plan: &Plan, ticks: &JobProgress) -> EyeRun {
    let length = plan.scenario.ticks.div_ceil(POINTS);
    let mut windows = vec![(0, 0.0, 0.0)];
    let Some(body) = plan.simulated_plant() else { unreachable!("the built-in eye is the simulator's") };
    let result = in_process_seen(plan, body, |observation, _| {
        let tick = observation.header.tick;
        if tick > 0 {
            if tick > 1 && (tick - 1).is_multiple_of(length) {
                windows.push((0, 0.0, 0.0));
            }
            let last = windows.len() - 1;
            let (n, error, loss) = &mut windows[last];
            *n += 1;
            *error += f64::from(observation.measures[0]);
            *loss -= f64::from(observation.reward);
        }
        !tick.is_multiple_of(REPORT) || ticks.report(REPORT)
    });
    EyeRun { windows, hash: result.controller.weights_hash, diverged: result.controller.diverged_at }
}

/// Millions of trials, and the mean error.
fn curve(run: &EyeRun) -> Polyline {
    let mut upto = 0;
    let point = |(n, error, _): &(u64, f64, f64)| {
        upto += n;
        ((upto as f64 - *n as f64 / 2.0) / 1e6, error / *n as f64)
    };
    run.windows.iter().map(point).collect()
}

fn rows(runs: &[EyeRun], trials: u64) -> Vec<EyeRow> {
    let per_row = (POINTS / ROWS) as usize;
    let count = runs.iter().map(|r| r.windows.len().div_ceil(per_row)).max().unwrap_or(0);
    let row = |i: usize| {
        let means = |pick: &dyn Fn(&(u64, f64, f64)) -> f64| {
            Spread::of(runs.iter().filter_map(|run| {
                let windows = run.windows.chunks(per_row).nth(i)?;
                let n: u64 = windows.iter().map(|w| w.0).sum();
                Some(windows.iter().map(pick).sum::<f64>() / n as f64)
            }))
        };
        let upto = ((i as u64 + 1) * per_row as u64 * trials.div_ceil(POINTS)).min(trials);
        Some(EyeRow { upto, error: means(&|w| w.1)?, loss: means(&|w| w.2)? })
    };
    (0..count).filter_map(row).collect()
}

impl EyeResult {
    /// One JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// The table for people.
    pub fn to_text(&self) -> String {
        let mut text = format!(
            "saccades, {} of {} trials each, four eyes: {:.1} s\n\n",
            self.runs,
            thousands(self.ticks),
            self.seconds
        );
        let mut rows = vec![vec!["mean error up to trial".to_owned()]];
        rows[0].extend(self.variants.iter().map(|v| format!("{} {}", v.retina, v.coding)));
        for i in 0..self.variants.iter().map(|v| v.windows.len()).max().unwrap_or(0) {
            let windows = self.variants.iter().map(|v| v.windows.get(i));
            let upto = windows.clone().flatten().map(|w| w.upto).max().unwrap_or(0);
            let mut row = vec![thousands(upto)];
            row.extend(windows.map(|w| in_words(w.map(|w| w.error))));
            rows.push(row);
        }
        text.push_str(&columns(&rows));
        let _ = writeln!(
            text,
            "\nmedian over seeds (least to largest); the retina's edge is at 1; noise alone costs {}",
            figures(Some(self.noise_alone))
        );
        for v in &self.variants {
            for (seed, tick) in self.seeds.iter().zip(&v.diverged) {
                if let Some(tick) = tick {
                    let _ = writeln!(text, "{} {}, seed {seed} diverged at trial {tick}", v.retina, v.coding);
                }
            }
        }
        let _ = writeln!(text, "figure  {}\ntable   {}", self.figure.display(), self.csv.display());
        text
    }
}
