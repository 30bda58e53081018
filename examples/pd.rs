//! A controller of your own instead of `tectum-controller`: proportional-derivative control of the plant in `point.rs`,
//! which tunes its gain while it controls.
//!
//! ```text
//! cargo build --release --bins --examples
//! target/release/tectum run examples/pd.toml
//! ```
//!
//! A controller program is a type that implements `Agent`, and one call. The library provides channels, handshake,
//! time, crash recovery, checkpoints and replay. Plant and logger are the same as with any other controller.

use std::process::ExitCode;

use rand::RngExt as _;
use serde::Deserialize;
use tectum::agent::{Agent, AgentRecord, Answer, Experience, Percept};
use tectum::process::controller_main;
use tectum::scenario::{Plan, ScenarioError};
use tectum::seed::{Rng, stream};
use tectum::state::{Persist, StateVisitor};

/// The keys of `[learner]` beside `rule`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Settings {
    /// The inputs that are compared.
    #[serde(default = "position")]
    position: String,
    #[serde(default = "target")]
    target: String,
    /// Command for an error of 1.
    gain: f32,
    /// Command against a movement of 1 in a tick.
    #[serde(default)]
    damping: f32,
    /// Ticks for which a gain is tried.
    #[serde(default = "usual_trial")]
    trial: u64,
}

fn position() -> String {
    "position".to_owned()
}

fn target() -> String {
    "target".to_owned()
}

fn usual_trial() -> u64 {
    400
}

/// `u = gain (target - position) - damping (position - position before)`. Now and then another gain is tried, and kept
/// if the mean reward is better with it.
struct Pd {
    settings: Settings,
    /// Numbers of the inputs.
    position: usize,
    target: usize,
    /// The best gain so far with its mean reward, and the gain that is tried.
    best: f32,
    best_reward: f32,
    gain: f32,
    /// Sum of the rewards of this trial, and their number.
    sum: f32,
    ticks: u64,
    /// The position one tick ago.
    before: f32,
    rng: Rng,
}

impl Pd {
    fn new(plan: &Plan) -> Result<Self, ScenarioError> {
        let table = plan.learner_table();
        let settings: Settings = table.read()?;
        if !(settings.gain > 0.0 && settings.gain.is_finite()) {
            return Err(table.invalid("gain", format_args!("is {}; give more than 0", settings.gain)));
        }
        let input = |key: &str, name: &str| {
            let found = plan.inputs.iter().position(|input| input.name == name);
            found.ok_or_else(|| {
                table.invalid(key, format_args!("is {name:?}; give the name of one of the plant's inputs"))
            })
        };
        let (position, target) = (input("position", &settings.position)?, input("target", &settings.target)?);
        let rng = stream(plan.scenario.seed, "gains");
        let (gain, best_reward) = (settings.gain, f32::NEG_INFINITY);
        Ok(Self { settings, position, target, best: gain, best_reward, gain, sum: 0.0, ticks: 0, before: 0.0, rng })
    }
}

/// What the agent needs to continue after its process was killed and restarted.
impl Persist for Pd {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.number("best", &mut self.best);
        visitor.number("best_reward", &mut self.best_reward);
        visitor.number("gain", &mut self.gain);
        visitor.number("sum", &mut self.sum);
        visitor.number("ticks", &mut self.ticks);
        visitor.number("before", &mut self.before);
        visitor.nested("rng", &mut self.rng);
    }
}

impl Agent for Pd {
    fn act(&mut self, percept: &Percept, answer: &mut Answer) {
        let (position, target) = (percept.inputs[self.position], percept.inputs[self.target]);
        let command = self.gain * (target - position) - self.settings.damping * (position - self.before);
        answer.command.fill(command);
        answer.mean.fill(command);
        self.before = position;
    }

    fn learn(&mut self, experience: &Experience) -> bool {
        if experience.withheld.is_some() {
            // The trial was disturbed, and begins anew.
            (self.sum, self.ticks) = (0.0, 0);
            return false;
        }
        self.sum += experience.reward;
        self.ticks += 1;
        if self.ticks == self.settings.trial {
            let reward = self.sum / self.ticks as f32;
            if reward > self.best_reward {
                (self.best, self.best_reward) = (self.gain, reward);
            }
            self.gain = self.best * self.rng.random_range(0.7..1.4);
            (self.sum, self.ticks) = (0.0, 0);
        }
        true
    }

    fn columns(&self) -> &'static [&'static str] {
        &["gain", "best gain"]
    }

    fn record(&self, record: &mut AgentRecord) {
        record.columns[..2].copy_from_slice(&[self.gain, self.best]);
    }
}

fn main() -> ExitCode {
    controller_main(&[("pd", |plan| Ok(Box::new(Pd::new(plan)?)))])
}
