//! The paper's outlook (section 5): joints of limited range, relative angles, self-collision as a penalty, a
//! reward near the target alone, L1 exploration, and the reward of Todorov and Jordan. Also measured: whether
//! the movements have the isochrony and the bell-shaped speed profile of human gestures.
//!
//! Each variant is a built-in scenario. The paper's arm with the same actor-critic is the comparison; it
//! counts segments that cross, at no cost. Learning is measured in the last twentieth of each run, with
//! exploration noise. Movements are measured without noise on a fixed set of targets, by the measures of
//! [`analyse`](crate::study::analyse).

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::ReproduceSettings;
use super::experiment::{Experiment, ExperimentFacts, LearnerEnd, run, seeds_in_words};
use crate::agent::ShippedAgent;
use crate::plant::{Arm, noise_share};
use crate::reference::{FrozenAgent, Rollout, TARGETS, TEST_SEED};
use crate::scenario::{ArmConfig, Plan};
use crate::stats::{Fit, Quartiles, Spread};
use crate::study::analyse::movement::{Definitions, Measures, RecordedMovement, measure};
use crate::study::compare::name_of;
use crate::study::text::{cells, csv_cell, push_divergences, push_files, spread_in_words, write_lines};
use crate::study::{JobProgress, StudyEnd, StudyError, exact};
use crate::text::{columns, thousands};
use crate::wire::{Observation, flag};

/// One part in this many of a run counts as its end.
const END_SHARE: u64 = 20;
/// A target counts as reached with an error below this, m.
const REACHED: f64 = 0.1;
/// A weight of crossings so small that they are counted at no cost.
const COUNTED: f64 = 1e-9;

/// A row: its name, its scenario, and the change of the scenario's arm.
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

/// The results of one variant.
#[derive(Debug, Clone, Serialize)]
struct OutlookRow {
    /// Name of the variant.
    name: &'static str,
    /// The scenario.
    scenario: &'static str,
    /// Its learning rule.
    rule: String,
    /// Ticks of each run.
    ticks: u64,
    /// Loss per tick without the cost of exploration noise alone. Rewards differ between rows, so losses do
    /// not compare.
    loss_without_noise: Spread,
    /// Mean error at the end of a target, m.
    end_error_m: Option<Spread>,
    /// Share of the targets that ended with an error below 0.1 m.
    reached: Option<Spread>,
    /// Share of the ticks in which segments crossed; null where crossings are not counted.
    crossed: Option<Spread>,
    /// Share of the joints that stood at a stop; null where there are no stops.
    stopped: Option<Spread>,
    /// Mean error at the end of the test's targets without noise, m.
    test_error_m: Option<Spread>,
    /// Peak speed over mean speed of a movement; 1.66 for minimum jerk (see the definitions of `analyse`).
    peak_to_mean: Option<Spread>,
    /// Position of the speed's peak in the movement, from 0 to 1.
    peak_position: Option<Spread>,
    /// Length of the path over that of the straight line.
    straightness: Option<Spread>,
    /// Rise of a movement's duration with the distance to its target, s/m; 0 is perfect isochrony.
    duration_slope_s_m: Option<Spread>,
    /// Rise of a movement's peak speed with the distance to its target, 1/s.
    speed_slope_per_s: Option<Spread>,
    /// The tick at which the learner stopped because a number was not finite, one per seed; null where it did
    /// not stop.
    diverged: Vec<Option<u64>>,
}

/// The result of [`outlook`].
#[derive(Debug, Clone, Serialize)]
pub struct OutlookResult {
    /// The seeds, in the order of all lists.
    seeds: Vec<u64>,
    /// One row per variant.
    rows: Vec<OutlookRow>,
    #[serde(flatten)]
    facts: ExperimentFacts,
    /// The table, seed by seed.
    csv: PathBuf,
}

/// What was measured in the run of one seed. The names are those of the row.
struct OutlookMeasured {
    loss: f64,
    end_error: Option<f64>,
    reached: Option<f64>,
    crossed: Option<f64>,
    stopped: Option<f64>,
    test: Vec<Measures>,
}

/// The run of one seed: its [`VALUES`].
#[derive(Serialize, Deserialize)]
struct OutlookRun {
    #[serde(with = "exact::list")]
    values: Vec<Option<f64>>,
    end: LearnerEnd,
}

/// A value of a run, with its name in the CSV.
type OutlookValue = (&'static str, fn(&OutlookMeasured) -> Option<f64>);

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

fn median(run: &OutlookMeasured, value: fn(&Measures) -> Option<f64>) -> Option<f64> {
    Quartiles::of(run.test.iter().filter_map(value)).map(|q| q.median)
}

fn slope(run: &OutlookMeasured, value: fn(&Measures) -> Option<f64>) -> Option<f64> {
    let points: Vec<_> = run.test.iter().filter_map(|m| Some((m.distance_m, value(m)?))).collect();
    Fit::of(&points).map(|fit| fit.slope)
}

/// Runs the scenarios of the outlook.
///
/// # Errors
/// When the folder or a file cannot be written, or a signal ended the study.
pub fn outlook(settings: &ReproduceSettings) -> Result<StudyEnd<OutlookResult>, StudyError> {
    let mut plans = Vec::new();
    for (_, name, change) in VARIANTS {
        plans.extend(settings.plans(name, |scenario| {
            scenario.plant.arm.as_mut().map(change);
        })?);
    }
    let experiment = match settings.run("outlook", plans, run_variant)? {
        StudyEnd::Whole(experiment) => experiment,
        StudyEnd::Part(part) => return Ok(StudyEnd::Part(part)),
    };
    let rows = VARIANTS.iter().zip(experiment.variants());
    let result = OutlookResult {
        seeds: settings.seeds(),
        rows: rows.filter_map(|(variant, (plan, runs))| row(variant, plan, runs)).collect(),
        csv: experiment.facts.path("outlook.csv"),
        facts: experiment.facts.clone(),
    };
    write_table(&result, &experiment)?;
    result.facts.write_json(&result.to_json())?;
    Ok(StudyEnd::Whole(result))
}

fn row((name, scenario, _): &Variant, plan: &Plan, runs: &[OutlookRun]) -> Option<OutlookRow> {
    let spread = |i: usize| Spread::of(runs.iter().filter_map(|run| run.values.get(i).copied().flatten()));
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
        diverged: runs.iter().map(|r| r.end.diverged_at).collect(),
    })
}

fn write_table(result: &OutlookResult, experiment: &Experiment<OutlookRun>) -> Result<(), StudyError> {
    let mut lines = vec![format!("name,scenario,seed,{}", VALUES.map(|v| v.0).join(","))];
    for ((name, scenario, _), (_, runs)) in VARIANTS.iter().zip(experiment.variants()) {
        for (run, seed) in runs.iter().zip(&result.seeds) {
            lines.push(format!(
                "{name},{scenario},{seed},{}",
                run.values.iter().map(|value| csv_cell(*value)).collect::<Vec<_>>().join(",")
            ));
        }
    }
    write_lines(&result.csv, &lines)
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
    fn add(&mut self, config: &ArmConfig, plan: &Plan, observation: &Observation) {
        self.ticks += 1.0;
        let noise = noise_share(config, plan.scenario.policy.sigma, observation.header.tick);
        self.loss -= f64::from(observation.reward) + noise;
        if observation.header.flags & flag::NEW_TARGET != 0 {
            let error = f64::from(observation.measures[0]);
            self.ends += 1.0;
            self.end_error += error;
            self.reached += f64::from(error < REACHED);
        }
        // The fourth measure exists where crossings are counted.
        self.crossed += f64::from(plan.measures.len() > 3 && observation.measures[3] > 0.0);
        for (&theta, limits) in observation.inputs[2..].iter().zip(&config.limits) {
            let stopped = limits.iter().any(|&limit| theta == limit as f32);
            self.stopped += f64::from(stopped) / config.limits.len() as f64;
        }
    }
}

fn run_variant(plan: &Plan, progress: &JobProgress) -> OutlookRun {
    let config = plan.scenario.plant.arm.clone().unwrap_or_default();
    let length = plan.scenario.ticks;
    let mut sums = OutlookSums::default();
    let mut test = Vec::new();
    let end = run(plan, progress, |observation, controller| {
        let tick = observation.header.tick;
        if tick > 0 && tick >= length - length / END_SHARE {
            sums.add(&config, plan, observation);
        }
        if tick + 1 == length {
            test = noiseless_movements(plan, controller.agent());
        }
    });
    let share = |sum: f64, of: f64| (of > 0.0).then_some(sum / of);
    let measured = OutlookMeasured {
        loss: sums.loss / sums.ticks,
        end_error: share(sums.end_error, sums.ends),
        reached: share(sums.reached, sums.ends),
        crossed: share(sums.crossed, sums.ticks).filter(|_| plan.measures.len() > 3),
        stopped: share(sums.stopped, sums.ticks).filter(|_| !config.limits.is_empty()),
        test,
    };
    OutlookRun { values: VALUES.iter().map(|value| value.1(&measured)).collect(), end }
}

/// The measures of the policy's movements to the test's targets, without exploration noise.
fn noiseless_movements(plan: &Plan, agent: &ShippedAgent) -> Vec<Measures> {
    let period_s = plan.period_ns as f64 / 1e9;
    let config = plan.scenario.plant.arm.as_ref().map(|arm| arm.at(plan.scenario.ticks)).unwrap_or_default();
    let mut rollout = Rollout::new(Arm::new(&config, period_s, TEST_SEED), plan);
    let mut frozen = FrozenAgent::of(agent, plan);
    let movement = |target: u64| {
        let from = target * config.target_every;
        rollout.sense(from);
        let start = rollout.plant().end().map(f64::from);
        let goal = rollout.plant().target().map(f64::from);
        let distance = (start[0] - goal[0]).hypot(start[1] - goal[1]);
        let mut movement = RecordedMovement { points: vec![start], errors: Vec::new(), distance };
        for tick in from..from + config.target_every {
            if tick > from {
                rollout.sense(tick);
            }
            let outcome = rollout.advance(tick, |seen| frozen.command(seen));
            movement.points.push(rollout.plant().end().map(f64::from));
            movement.errors.push(f64::from(outcome.measures[0]));
        }
        measure(&movement, period_s, &Definitions::default())
    };
    (0..TARGETS as u64).map(movement).collect()
}

impl OutlookResult {
    /// The result as one JSON object.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// The result for people: a table of what was learned, and a table of the movements.
    pub fn to_text(&self) -> String {
        let mut text = format!("outlook, {}: {:.1} s\n\n", seeds_in_words(&self.seeds), self.facts.seconds);
        text.push_str(&columns(&self.learning_table()));
        text.push_str("\nwithout exploration noise, 40 targets:\n\n");
        text.push_str(&columns(&self.movement_table()));
        text.push_str(
            "\nmedian over seeds (least to largest); reached: error below 0.1 m; \
             the last two columns are slopes against the\n\
             distance: isochrony is 0 for duration. \
             A movement of minimum jerk has peak/mean 1.66, its peak at 0.5, path/line 1.\n",
        );
        for row in &self.rows {
            push_divergences(&mut text, &format!("{}, ", row.name), "tick", &self.seeds, &row.diverged);
        }
        push_files(&mut text, None, std::slice::from_ref(&self.csv));
        text
    }

    fn learning_table(&self) -> Vec<Vec<String>> {
        let head = ["", "learner", "ticks", "end error (m)", "targets reached", "ticks crossed", "joints at a stop"];
        let mut rows = vec![cells(head)];
        for row in &self.rows {
            let mut line = vec![row.name.to_owned(), row.rule.clone(), thousands(row.ticks)];
            line.extend([row.end_error_m, row.reached, row.crossed, row.stopped].map(spread_in_words));
            rows.push(line);
        }
        rows
    }

    fn movement_table(&self) -> Vec<Vec<String>> {
        let head =
            ["", "end error (m)", "peak/mean speed", "peak at", "path/line", "duration (s/m)", "peak speed (1/s)"];
        let mut rows = vec![cells(head)];
        for row in &self.rows {
            let values = [
                row.test_error_m,
                row.peak_to_mean,
                row.peak_position,
                row.straightness,
                row.duration_slope_s_m,
                row.speed_slope_per_s,
            ];
            rows.push(std::iter::once(row.name.to_owned()).chain(values.map(spread_in_words)).collect());
        }
        rows
    }
}
