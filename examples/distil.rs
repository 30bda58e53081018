//! How far the paper's class of policies can follow a planner. `model-predictive` learns the arm of
//! `scenarios/arm.toml` for a minute; then a policy `u = W g` over the paper's features (Daucé & Dutech 2010) is fitted
//! to what the planner does, by ridge regression, and tested on the targets of `tectum compare`.
//!
//! ```text
//! cargo run --release --example distil -- 1     # the seed; some minutes
//! ```
//!
//! In the first round the planner drives. From then on the policy drives, and the planner says what it would have done
//! (DAgger: Ross, Gordon & Bagnell 2011), so that the policy also learns what to do where only it gets to.

use tectum::agent::ShippedAgent;
use tectum::encoder::{Encoder, Features};
use tectum::policy::LinearPolicy;
use tectum::reference::{FixedArm, FrozenAgent, MeanPolicy, Rollout, TestSet};
use tectum::runtime::{Controller, simulate};
use tectum::scenario::{LearnerConfig, Plan, Rule, Scenario, ScenarioError};

/// Ticks for which the planner learns.
const LEARNED: u64 = 1_200;
/// Ticks and rounds of the fit: fifty targets a round.
const ROUND: u64 = 4_000;
const ROUNDS: u64 = 5;
/// Ridge, as a share of the mean of the diagonal.
const RIDGE: f64 = 1e-5;

/// The arm of `arm.toml`, which does not change, with a rule's preset.
fn plan(rule: Rule, seed: u64) -> Result<Plan, ScenarioError> {
    let mut scenario = Scenario::built_in("arm")?;
    (scenario.seed, scenario.ticks) = (seed, LEARNED);
    scenario.learner = LearnerConfig::preset(rule);
    scenario.plant.arm.iter_mut().for_each(|arm| arm.block.clear());
    scenario.plan()
}

/// What was seen and what the planner did, as the sums of a least-squares fit.
struct Fit {
    encoder: Encoder,
    features: Features,
    /// Upper triangle of the features' products, row by row.
    products: Vec<Vec<f64>>,
    /// Features times commands, by output.
    answers: Vec<Vec<f64>>,
}

impl Fit {
    fn new(plan: &Plan) -> Self {
        let encoder = plan.encoder();
        let features = encoder.features();
        let count = features.as_slice().len();
        let answers = vec![vec![0.0; count]; plan.outputs.len()];
        Self { encoder, features, products: vec![vec![0.0; count]; count], answers }
    }

    fn add(&mut self, inputs: &[f32], command: &[f32]) {
        self.encoder.encode(inputs, &mut self.features);
        let g: Vec<f64> = self.features.as_slice().iter().map(|&g| f64::from(g)).collect();
        for (i, row) in self.products.iter_mut().enumerate() {
            row[i..].iter_mut().zip(&g[i..]).for_each(|(sum, other)| *sum += g[i] * other);
        }
        for (answers, &u) in self.answers.iter_mut().zip(command) {
            answers.iter_mut().zip(&g).for_each(|(sum, g)| *sum += g * f64::from(u));
        }
    }

    /// Puts the weights of the fit into `policy`.
    fn solve(&self, policy: &mut LinearPolicy) {
        let count = self.products.len();
        let mean = (0..count).map(|i| self.products[i][i]).sum::<f64>() / count as f64;
        // Cholesky: products + ridge = root^T root, with an upper triangular root.
        let mut root = self.products.clone();
        for i in 0..count {
            root[i][i] += RIDGE * mean;
            for k in 0..i {
                let (above, row) = root.split_at_mut(i);
                let factor = above[k][i];
                row[0][i..].iter_mut().zip(&above[k][i..]).for_each(|(value, other)| *value -= factor * other);
            }
            let scale = root[i][i].sqrt();
            root[i][i..].iter_mut().for_each(|value| *value /= scale);
        }
        for (output, answers) in self.answers.iter().enumerate() {
            let mut weights = answers.clone();
            for i in 0..count {
                let known: f64 = (0..i).map(|k| root[k][i] * weights[k]).sum();
                weights[i] = (weights[i] - known) / root[i][i];
            }
            for i in (0..count).rev() {
                let known: f64 = (i + 1..count).map(|k| root[i][k] * weights[k]).sum();
                weights[i] = (weights[i] - known) / root[i][i];
            }
            let tiles = policy.weights_mut();
            weights.iter().enumerate().for_each(|(i, &weight)| *tiles.get_mut(output, i) = weight as f32);
        }
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let seed = std::env::args().nth(1).map_or(Ok(1), |seed| seed.parse())?;
    let (planned, linear) = (plan(Rule::ModelPredictive, seed)?, plan(Rule::Paper, seed)?);
    let body = |plan: &Plan| plan.simulated_plant().ok_or("the arm is not simulated");
    let learned = simulate(&planned, body(&planned)?, Controller::new(&planned), &mut |_, _| true).agent;

    let arm = planned.scenario.plant.arm.clone().unwrap_or_default();
    let test = TestSet::new(&linear, FixedArm::at(&arm, linear.scenario.period_ms / 1000.0, 0));
    println!("seed {seed}; loss a tick in the test, and error at a target's end");
    let score = test.score_agent(&learned);
    println!("the planner after {LEARNED} ticks: {:.4}, {:.3} m", score.loss, score.miss_m);

    let mut fit = Fit::new(&linear);
    let ShippedAgent::Linear(agent) = linear.agent() else { return Err("the paper's rule has a linear policy".into()) };
    let mut policy = agent.linear_policy().clone();
    let mut mean = MeanPolicy::new(&linear);
    for round in 0..ROUNDS {
        let targets = plan(Rule::Paper, 1_000_000 + seed * ROUNDS + round)?;
        let mut rollout = Rollout::new(body(&targets)?, &targets);
        let mut planner = FrozenAgent::of(&learned, &planned);
        for tick in 0..ROUND {
            rollout.sense(tick);
            rollout.advance(tick, |seen| {
                let planned = planner.command(seen);
                fit.add(seen.inputs, &planned[..targets.outputs.len()]);
                if round == 0 { planned } else { mean.command(&policy, seen.inputs) }
            });
        }
        fit.solve(&mut policy);
        let score = test.drive(|seen| mean.command(&policy, seen.inputs));
        let ticks = (round + 1) * ROUND;
        println!("a policy W g, fitted to {ticks} ticks: {:.4}, {:.3} m", score.loss, score.miss_m);
    }
    Ok(())
}
