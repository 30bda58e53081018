//! The saccades (paper section 4.1, figure 2): a linear and a log-polar retina, each with scalar and
//! topographic inputs.

use std::f64::consts::PI;
use std::fmt::Write as _;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::ReproduceSettings;
use super::experiment::{Experiment, ExperimentFacts, LearnerEnd, run, seeds_in_words};
use super::trial_windows::{TrialWindow, TrialWindows, mean};
use crate::report::figure::{ErrorFigure, ErrorPanel, draw_miss};
use crate::scenario::{MapConfig, PerAxis, Plan, Retina, Scenario};
use crate::stats::Spread;
use crate::study::text::{push_divergences, push_files, spread_in_words, write_lines};
use crate::study::{JobProgress, StudyEnd, StudyError};
use crate::text::{columns, figures, thousands};

/// Points of a curve.
const POINTS: u64 = 300;
/// Rows of the table.
const ROWS: u64 = 6;
/// Number of trials in the paper.
const TRIALS: u64 = 3_000_000;
/// Share of the learning step that is used for scalar inputs, by retina. Scalar inputs have no norm of their
/// own: a target far out, or an angle of pi, makes a long feature vector. With the whole step, four of five
/// seeds of the linear eye diverge within two million trials. With a seventh of it, the log-polar eye still
/// diverges within 250,000 trials, and never learns to hit the target anyway.
const SCALAR_STEPS: [f64; 2] = [1.0 / 3.0, 1.0 / 30.0];

/// Means over the trials since the row before, in retina coordinates (the edge is at 1).
#[derive(Debug, Clone, Serialize)]
struct EyeRow {
    /// Last trial of the row, exclusive.
    upto: u64,
    /// Mean error per trial.
    error: Spread,
    /// Mean loss per trial, the reward with its sign turned.
    loss: Spread,
}

/// One of the four eyes.
#[derive(Debug, Clone, Serialize)]
struct EyeVariant {
    /// `linear` or `log-polar`.
    retina: &'static str,
    /// `scalar` or `topographic`.
    coding: &'static str,
    /// Rows of the table.
    windows: Vec<EyeRow>,
    /// XXH3-64 of the final weights, one per seed.
    weights_hash: Vec<String>,
    /// The trial at which the weights were no longer numbers, one per seed; null where they are.
    diverged: Vec<Option<u64>>,
}

/// The result of [`eye`].
#[derive(Debug, Clone, Serialize)]
pub struct EyeResult {
    /// The seeds, in the order of all lists.
    seeds: Vec<u64>,
    /// Trials of each run.
    ticks: u64,
    /// Mean error of a perfect saccade with exploration noise: the mean of a Rayleigh distribution.
    noise_alone: f64,
    /// The four eyes.
    variants: Vec<EyeVariant>,
    #[serde(flatten)]
    facts: ExperimentFacts,
    /// The figure.
    figure: PathBuf,
    /// The table.
    csv: PathBuf,
}

const RETINAS: [(Retina, &str); 2] = [(Retina::Linear, "linear"), (Retina::LogPolar, "log-polar")];
const CODINGS: [&str; 2] = ["scalar", "topographic"];

/// The run of one seed of one eye.
#[derive(Serialize, Deserialize)]
struct EyeRun {
    windows: TrialWindows,
    end: LearnerEnd,
}

/// Runs the four eyes.
///
/// # Errors
/// When the folder or a file cannot be written, or a signal ended the study.
pub fn eye(settings: &ReproduceSettings) -> Result<StudyEnd<EyeResult>, StudyError> {
    let mut plans = Vec::new();
    for (retina, _) in RETINAS {
        for coding in CODINGS {
            plans.extend(settings.plans("eye", |scenario| change(scenario, retina, coding == "scalar"))?);
        }
    }
    let experiment = match settings.run("eye", plans, run_eye)? {
        StudyEnd::Whole(experiment) => experiment,
        StudyEnd::Part(part) => return Ok(StudyEnd::Part(part)),
    };
    let result = result(settings, &experiment);
    draw_miss(&figure(&result, &experiment), &result.figure)?;
    write_table(&result, &experiment)?;
    result.facts.write_json(&result.to_json())?;
    Ok(StudyEnd::Whole(result))
}

/// Changes the scenario `eye` to another retina, with or without topographic maps.
fn change(scenario: &mut Scenario, retina: Retina, scalar: bool) {
    scenario.ticks = TRIALS;
    scenario.plant.eye.get_or_insert_default().retina = retina;
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
        // Up to the retina's edge.
        let ranges = match retina {
            Retina::Linear => vec![[-1.0, 1.0]; 2],
            Retina::LogPolar => vec![[0.0, 1.0], [-PI, PI]],
        };
        let map = |pair: &[&str]| MapConfig {
            inputs: pair.iter().map(|&name| name.to_owned()).collect(),
            units: vec![16, 16],
            radius: PerAxis::All(0.5),
            ranges: ranges.clone(),
        };
        encoder.maps = names.chunks(2).map(map).collect();
    }
}

fn run_eye(plan: &Plan, progress: &JobProgress) -> EyeRun {
    let mut windows = TrialWindows::new(plan.scenario.ticks, POINTS);
    let end = run(plan, progress, |observation, _| windows.observe(observation));
    EyeRun { windows, end }
}

fn result(settings: &ReproduceSettings, experiment: &Experiment<EyeRun>) -> EyeResult {
    let facts = &experiment.facts;
    let scenario = &experiment.plans[0].scenario;
    let names = RETINAS.iter().flat_map(|(_, retina)| CODINGS.map(|coding| (*retina, coding)));
    let variant = |((retina, coding), (_, runs)): ((&'static str, &'static str), (_, &[EyeRun]))| {
        let (weights_hash, diverged) = LearnerEnd::lists(runs.iter().map(|run| &run.end));
        EyeVariant { retina, coding, windows: rows(runs, scenario.ticks), weights_hash, diverged }
    };
    EyeResult {
        seeds: settings.seeds(),
        ticks: scenario.ticks,
        // Two outputs push along each axis.
        noise_alone: scenario.policy.sigma * std::f64::consts::SQRT_2 * (std::f64::consts::PI / 2.0).sqrt(),
        variants: names.zip(experiment.variants()).map(variant).collect(),
        figure: facts.path("figure.svg"),
        csv: facts.path("curve.csv"),
        facts: facts.clone(),
    }
}

fn rows(runs: &[EyeRun], trials: u64) -> Vec<EyeRow> {
    let per_row = (POINTS / ROWS) as usize;
    let count = runs.iter().map(|r| r.windows.windows.len().div_ceil(per_row)).max().unwrap_or(0);
    let row = |i: usize| {
        let means = |value: fn(&TrialWindow) -> f64| {
            Spread::of(runs.iter().filter_map(|run| Some(mean(run.windows.windows.chunks(per_row).nth(i)?, value))))
        };
        let upto = ((i as u64 + 1) * per_row as u64 * trials.div_ceil(POINTS)).min(trials);
        Some(EyeRow { upto, error: means(|w| w.error)?, loss: means(|w| w.loss)? })
    };
    (0..count).filter_map(row).collect()
}

fn figure(result: &EyeResult, experiment: &Experiment<EyeRun>) -> ErrorFigure {
    let runs: Vec<&[EyeRun]> = experiment.variants().map(|(_, runs)| runs).collect();
    let curves = |runs: &[EyeRun]| runs.iter().map(|run| run.windows.error_curve()).collect();
    let panel = |((_, retina), codings): (&(Retina, &str), &[&[EyeRun]])| ErrorPanel {
        name: format!("{retina} retina"),
        curves: CODINGS.iter().zip(codings).map(|(coding, runs)| ((*coding).to_owned(), curves(runs))).collect(),
    };
    ErrorFigure {
        title: format!("Saccades, {}: median and span over seeds", seeds_in_words(&result.seeds)),
        panels: RETINAS.iter().zip(runs.chunks(CODINGS.len())).map(panel).collect(),
        levels: vec![(result.noise_alone, "noise alone".to_owned())],
        y: "mean error (the retina's edge is at 1)".to_owned(),
    }
}

fn write_table(result: &EyeResult, experiment: &Experiment<EyeRun>) -> Result<(), StudyError> {
    let mut lines = vec!["retina,coding,seed,upto,error,loss".to_owned()];
    for (EyeVariant { retina, coding, .. }, (_, runs)) in result.variants.iter().zip(experiment.variants()) {
        for (run, seed) in runs.iter().zip(&result.seeds) {
            for (upto, TrialWindow { trials, error, loss }) in run.windows.with_ends() {
                let n = *trials as f64;
                lines.push(format!("{retina},{coding},{seed},{upto},{},{}", error / n, loss / n));
            }
        }
    }
    write_lines(&result.csv, &lines)
}

impl EyeResult {
    /// The result as one JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// The result as a table for people.
    pub fn to_text(&self) -> String {
        let mut text = format!(
            "saccades, {} of {} trials each, four eyes: {:.1} s\n\n",
            seeds_in_words(&self.seeds),
            thousands(self.ticks),
            self.facts.seconds
        );
        let mut rows = vec![vec!["mean error up to trial".to_owned()]];
        rows[0].extend(self.variants.iter().map(|v| format!("{} {}", v.retina, v.coding)));
        for i in 0..self.variants.iter().map(|v| v.windows.len()).max().unwrap_or(0) {
            let windows = self.variants.iter().map(|v| v.windows.get(i));
            let upto = windows.clone().flatten().map(|w| w.upto).max().unwrap_or(0);
            let mut row = vec![thousands(upto)];
            row.extend(windows.map(|w| spread_in_words(w.map(|w| w.error))));
            rows.push(row);
        }
        text.push_str(&columns(&rows));
        let _ = writeln!(
            text,
            "\nmedian over seeds (least to largest); the retina's edge is at 1; noise alone costs {}",
            figures(Some(self.noise_alone))
        );
        for v in &self.variants {
            let name = format!("{} {}, ", v.retina, v.coding);
            push_divergences(&mut text, &name, "trial", &self.seeds, &v.diverged);
        }
        push_files(&mut text, Some(&self.figure), std::slice::from_ref(&self.csv));
        text
    }
}
