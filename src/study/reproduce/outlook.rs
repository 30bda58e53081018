//! The paper's outlook (section 5): joints of limited course, relative angles, self-collision as a penalty, a reward near the
//! target alone, L1 exploration, the reward of Todorov and Jordan; and whether the movements have the isochrony and the
//! bell-shaped speed of human gestures.
//!
//! Each is a built-in scenario. For comparison stands the paper's arm under the same actor-critic, counting crossings that
//! cost nothing. Learning is measured in the last twentieth of each run, with its exploration noise; movements on a fixed
//! set of targets without it, by the measures of [`analyse`](crate::study::analyse).

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::PathBuf;

use serde::Serialize;

use super::{ReproduceSettings, StudyError, write_lines};
use crate::clock::{facts, monotonic_ns};
use crate::plant::{Arm, Plant, noise_share};
use crate::report::{columns, figures, thousands};
use crate::runtime::{Controller, in_process_seen};
use crate::scenario::{ArmConfig, Plan, Scenario};
use crate::study::analyse::movement::{Definitions, Measures, RecordedMovement, measure};
use crate::study::analyse::{Fit, Quartiles};
use crate::study::compare::name_of;
use crate::study::{JobProgress, Spread};
use crate::wire::{MAX_INPUTS, MAX_OUTPUTS, Observation, flag};

/// Targets of the test, and the seed that they are drawn with: neither one to tune on nor one to report on.
const TARGETS: u64 = 40;
const TEST_SEED: u64 = 2010;
/// Part of a run that counts as its end.
const SHARE: u64 = 20;
/// An error at which a target counts as reached, m.
const REACHED: f64 = 0.1;
/// A weight of crossings that counts them and costs nothing.
const COUNTED: f64 = 1e-9;
/// Ticks between two reports of progress; a power of two that the slowest learner passes within seconds.
const REPORT: u64 = 256;

/// A row: its name, its scenario, and what is changed in it.
type Variant = (&'static str, &'static str, fn(&mut ArmConfig));

const VARIANTS: [Variant; 8] = [
    ("the paper's arm", "collision", |arm| arm.reward.collision = COUNTED),
    ("limited joints", "limited", |_| {}),
    ("relative angles", "relative", |_| {}),
    ("collisions cost", "collision", |_| {}),
    ("reward within 1 m", "near", |_| {}),
    ("reward within 0.5 m", "near", |arm| arm.reward.near = Some(0.5)),
    ("Laplace noise", "laplace", |_| {}),
    ("Todorov and Jordan", "todorov", |_| {}),
];

/// What one variant gave.
#[derive(Debug, Clone, Serialize)]
pub struct OutlookRow {
    /// What is special.
    pub name: &'static str,
    /// The scenario.
    pub scenario: &'static str,
    /// Its learning rule.
    pub rule: String,
    /// Ticks of each run.
    pub ticks: u64,
    /// Loss a tick without what exploration noise alone costs; rewards differ, so that losses of different rows do not compare.
    pub loss_without_noise: Spread,
    /// Mean error at the end of a target, m.
    pub end_error_m: Option<Spread>,
    /// Share of the targets that ended with an error below 0.1 m.
    pub reached: Option<Spread>,
    /// Share of the ticks in which segments crossed; null where nobody counted.
    pub crossed: Option<Spread>,
    /// Share of the joints that stood at a stop; null where there are none.
    pub stopped: Option<Spread>,
    /// Mean error at the end of the test's targets without noise, m.
    pub test_error_m: Option<Spread>,
    /// Peak speed over mean speed of a movement; minimum jerk has 1.66 (see the definitions of `analyse`).
    pub peak_to_mean: Option<Spread>,
    /// Where in the movement the peak of the speed lies, from 0 to 1.
    pub peak_position: Option<Spread>,
    /// Path over straight line.
    pub straightness: Option<Spread>,
    /// Rise of a movement's duration with the distance to its target, s/m: 0 is perfect isochrony.
    pub duration_slope_s_m: Option<Spread>,
    /// Rise of its peak speed with the distance, 1/s.
    pub speed_slope_per_s: Option<Spread>,
    /// The tick at which the learner stopped for a number that was none, one a seed; null where it did not.
    pub diverged: Vec<Option<u64>>,
}

/// What came out.
#[derive(Debug, Clone, Serialize)]
pub struct OutlookResult {
    /// The seeds.
    pub seeds: Vec<u64>,
    /// The same in words.
    #[serde(skip)]
    runs: String,
    /// The rows.
    pub rows: Vec<OutlookRow>,
    /// Seconds that all runs took together.
    pub seconds: f64,
    /// The machine.
    pub machine: BTreeMap<String, String>,
    /// The folder with the table.
    pub folder: PathBuf,
    /// The table, seed by seed.
    pub csv: PathBuf,
}

/// What one seed gave; the names are those of the row.
struct OutlookRun {
    loss: f64,
    end_error: Option<f64>,
    reached: Option<f64>,
    crossed: Option<f64>,
    stopped: Option<f64>,
    test: Vec<Measures>,
    diverged: Option<u64>,
}

/// A value of a run, by its name in the CSV.
type OutlookValue = (&'static str, fn(&OutlookRun) -> Option<f64>);

const VALUES: [OutlookValue; 11] = [
    ("loss_without_noise", |r| Some(r.loss)),
    ("end_error_m", |r| r.end_error),
    ("reached", |r| r.reached),
    ("crossed", |r| r.crossed),
    ("stopped", |r| r.stopped),
    ("test_error_m", |r| mean(r.test.iter().filter_map(|m| m.end_error_m))),
    ("peak_to_mean", |r| median(r, |m| m.peak_to_mean)),
    ("peak_position", |r| median(r, |m| m.peak_position)),
    ("straightness", |r| median(r, |m| m.straightness)),
    ("duration_slope_s_m", |r| slope(r, |m| m.duration_s)),
    ("speed_slope_per_s", |r| slope(r, |m| m.peak_speed)),
];

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (n, sum) = values.fold((0.0, 0.0), |(n, sum), x| (n + 1.0, sum + x));
    (n > 0.0).then_some(sum / n)
}

fn median(run: &OutlookRun, value: fn(&Measures) -> Option<f64>) -> Option<f64> {
    Quartiles::of(run.test.iter().filter_map(value)).map(|q| q.median)
}

fn slope(run: &OutlookRun, value: fn(&Measures) -> Option<f64>) -> Option<f64> {
    let points: Vec<_> = run.test.iter().filter_map(|m| Some((m.distance_m, value(m)?))).collect();
    Fit::of(&points).map(|fit| fit.slope)
}

/// Runs the scenarios of the outlook.
///
/// # Errors
/// When the folder cannot be used, a file not be written, or a signal came.
pub fn outlook(settings: &ReproduceSettings) -> Result<OutlookResult, StudyError> {
    let mut plans = Vec::new();
    for (_, name, change) in VARIANTS {
        for seed in settings.seeds() {
            let mut scenario = Scenario::built_in(name)?;
            scenario.seed = seed;
            scenario.ticks = settings.ticks.unwrap_or(scenario.ticks);
            scenario.plant.arm.as_mut().map(change);
            plans.push(scenario.plan()?);
        }
    }
    let pool = settings.pool()?;
    let folder = settings.folder("reproduce-outlook")?;
    let began = monotonic_ns();
    let total = plans.iter().map(|p| p.scenario.ticks).sum();
    let runs = pool.work("outlook", total, &plans, run).map_err(StudyError::Signal)?;
    let seconds = (monotonic_ns() - began) as f64 / 1e9;
    folder.keep();

    let per_row = settings.seeds as usize;
    let rows = VARIANTS.iter().zip(plans.chunks(per_row).zip(runs.chunks(per_row)));
    let result = OutlookResult {
        seeds: settings.seeds(),
        runs: settings.in_words(),
        rows: rows.filter_map(|(variant, (plans, runs))| row(variant, &plans[0], runs)).collect(),
        seconds,
        machine: facts(),
        folder: folder.path().to_owned(),
        csv: folder.path().join("outlook.csv"),
    };
    let mut lines = vec![format!("name,scenario,seed,{}", VALUES.map(|v| v.0).join(","))];
    for ((name, scenario, _), runs) in VARIANTS.iter().zip(runs.chunks(per_row)) {
        for (run, seed) in runs.iter().zip(&result.seeds) {
            lines.push(format!("{name},{scenario},{seed},{}", VALUES.map(|v| super::cell(v.1(run))).join(",")));
        }
    }
    write_lines(&result.csv, lines)?;
    let json = folder.path().join("result.json");
    std::fs::write(&json, result.to_json()).map_err(StudyError::write(&json))?;
    Ok(result)
}

fn row((name, scenario, _): &Variant, plan: &Plan, runs: &[OutlookRun]) -> Option<OutlookRow> {
    let spread = |i: usize| Spread::of(runs.iter().filter_map(VALUES[i].1));
    Some(OutlookRow {
        name,
        scenario,
        rule: name_of(plan.scenario.learner.rule),
        ticks: plan.scenario.ticks,
        loss_without_noise: spread(0)?,
        end_error_m: spread(1),
        reached: spread(2),
        crossed: spread(3),
        stopped: spread(4),
        test_error_m: spread(5),
        peak_to_mean: spread(6),
        peak_position: spread(7),
        straightness: spread(8),
        duration_slope_s_m: spread(9),
        speed_slope_per_s: spread(10),
        diverged: runs.iter().map(|r| r.diverged).collect(),
    })
}

/// Sums over the end of a run.
#[derive(Default)]
struct OutlookSums {
    ticks: f64,
    loss: f64,
    ends: f64,
    end_error: f64,
    reached: f64,
    crossed: f64,
    stopped: f64,
}

impl OutlookSums {
    fn see(&mut self, table: &ArmConfig, plan: &Plan, observation: &Observation) {
        self.ticks += 1.0;
        let noise = noise_share(table, plan.scenario.policy.sigma, observation.header.tick);
        self.loss -= f64::from(observation.reward) + noise;
        if observation.header.flags & flag::NEW_TARGET != 0 {
            let error = f64::from(observation.measures[0]);
            self.ends += 1.0;
            self.end_error += error;
            self.reached += f64::from(error < REACHED);
        }
        // The measure is there where crossings count.
        self.crossed += f64::from(plan.measures.len() > 3 && observation.measures[3] > 0.0);
        for (&theta, limits) in observation.inputs[2..].iter().zip(&table.limits) {
            let stopped = limits.iter().any(|&limit| theta == limit as f32);
            self.stopped += f64::from(stopped) / table.limits.len() as f64;
        }
    }
}

fn run(plan: &Plan, ticks: &JobProgress) -> OutlookRun {
    let table = plan.scenario.plant.arm.clone().unwrap_or_default();
    let Some(body) = plan.simulated_plant() else { unreachable!("the built-in arms are the simulator's") };
    let length = plan.scenario.ticks;
    let mut sums = OutlookSums::default();
    let mut movements = Vec::new();
    let result = in_process_seen(plan, body, |observation, controller| {
        let tick = observation.header.tick;
        if tick > 0 && tick >= length - length / SHARE {
            sums.see(&table, plan, observation);
        }
        if tick + 1 == length {
            movements = test(plan, controller);
        }
        !tick.is_multiple_of(REPORT) || ticks.report(REPORT)
    });
    let share = |sum: f64, of: f64| (of > 0.0).then_some(sum / of);
    OutlookRun {
        loss: sums.loss / sums.ticks,
        end_error: share(sums.end_error, sums.ends),
        reached: share(sums.reached, sums.ends),
        crossed: share(sums.crossed, sums.ticks).filter(|_| plan.measures.len() > 3),
        stopped: share(sums.stopped, sums.ticks).filter(|_| !table.limits.is_empty()),
        test: movements,
        diverged: result.controller.diverged_at,
    }
}

/// The movements that the policy makes without noise.
fn test(plan: &Plan, controller: &Controller) -> Vec<Measures> {
    let period_s = plan.period_ns as f64 / 1e9;
    let table = plan.scenario.plant.arm.as_ref().map(|arm| arm.at(plan.scenario.ticks)).unwrap_or_default();
    let mut arm = Arm::new(&table, period_s, TEST_SEED);
    let mut encoder = plan.encoder();
    let mut features = encoder.features();
    let limits = plan.scenario.gate.max_command.outputs();
    let mut inputs = [0.0; MAX_INPUTS];
    let movement = |target: u64| {
        let from = target * table.target_every;
        arm.sense(from, &mut inputs);
        let start = arm.end().map(f64::from);
        let goal = arm.target().map(f64::from);
        let mut track = RecordedMovement {
            points: vec![start],
            errors: Vec::new(),
            distance: (start[0] - goal[0]).hypot(start[1] - goal[1]),
        };
        for tick in from..from + table.target_every {
            arm.sense(tick, &mut inputs);
            encoder.encode(&inputs[..plan.inputs.len()], &mut features);
            let mut command = [0.0; MAX_OUTPUTS];
            let mean = controller.policy().mean(features.as_slice());
            for ((to, mean), limit) in command.iter_mut().zip(mean).zip(limits) {
                *to = mean.clamp(-limit, limit);
            }
            let outcome = arm.advance(tick, &command[..plan.outputs.len()]);
            track.points.push(arm.end().map(f64::from));
            track.errors.push(f64::from(outcome.measures[0]));
        }
        measure(&track, period_s, &Definitions::default())
    };
    (0..TARGETS).map(movement).collect()
}

impl OutlookResult {
    /// One JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// The tables for people: what was learned, and how it moves.
    pub fn to_text(&self) -> String {
        let mut text = format!("outlook, {}: {:.1} s\n\n", self.runs, self.seconds);
        let short = |s: Option<Spread>| match s {
            Some(s) => {
                let [median, min, max] = [s.median, s.min, s.max].map(|x| figures(Some(x)));
                format!("{median} ({min} to {max})")
            }
            None => "-".to_owned(),
        };
        let head = ["", "learner", "ticks", "end error (m)", "targets reached", "ticks crossed", "joints at a stop"];
        let mut rows = vec![head.map(str::to_owned).to_vec()];
        for row in &self.rows {
            rows.push(vec![
                row.name.to_owned(),
                row.rule.clone(),
                thousands(row.ticks),
                short(row.end_error_m),
                short(row.reached),
                short(row.crossed),
                short(row.stopped),
            ]);
        }
        text.push_str(&columns(&rows));
        text.push_str("\nwithout exploration noise, 40 targets:\n\n");
        let head =
            ["", "end error (m)", "peak/mean speed", "peak at", "path/line", "duration (s/m)", "peak speed (1/s)"];
        let mut rows = vec![head.map(str::to_owned).to_vec()];
        for row in &self.rows {
            rows.push(vec![
                row.name.to_owned(),
                short(row.test_error_m),
                short(row.peak_to_mean),
                short(row.peak_position),
                short(row.straightness),
                short(row.duration_slope_s_m),
                short(row.speed_slope_per_s),
            ]);
        }
        text.push_str(&columns(&rows));
        text.push_str(
            "\nmedian over seeds (least to largest); reached: error below 0.1 m; the last two columns are slopes against the\n\
             distance: isochrony is 0 for duration. A movement of minimum jerk has peak/mean 1.66, its peak at 0.5, path/line 1.\n",
        );
        for row in &self.rows {
            for (seed, tick) in self.seeds.iter().zip(&row.diverged) {
                if let Some(tick) = tick {
                    let _ = writeln!(text, "{}, seed {seed} diverged at tick {}", row.name, thousands(*tick));
                }
            }
        }
        let _ = writeln!(text, "table   {}", self.csv.display());
        text
    }
}
