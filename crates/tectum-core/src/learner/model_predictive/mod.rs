//! The model-predictive learner: learns how commands move the inputs and what the reward depends on, and plans through
//! both.
//!
//! It sees inputs with their ranges, what was applied, the reward, and flags; not which inputs are targets, nor what
//! moves them. Dynamics and reward are Bayesian linear models on explicit features, whose scales follow from the
//! marginal likelihood, on line. A control-limited iLQR plans through them. The plan for the next tick is made after
//! the command of this tick has gone out ([`ModelPredictive::improve`]), so that an observation is answered within
//! microseconds ([`ModelPredictive::act`]): `u = u* + K (x - x*)`, and exploration noise. The first observation of an
//! episode, which no plan foresees, is answered from a plan of its own.
//!
//! | file | content | source |
//! |---|---|---|
//! | `layout.rs`, `layouts.rs` | what a model looks at, its kernel, and the first scales | Rasmussen & Williams 2006 |
//! | `features.rs` | explicit features of that kernel | Rahimi & Recht 2007; Yu et al. 2016 |
//! | `regression.rs` | posterior of the weights, by recursion | Bishop 2006; MacKay 1992 |
//! | `evidence.rs` | marginal likelihood of the scales | Rasmussen & Williams 2006, chapter 5 |
//! | `alignment.rs` | how late rewards come, how angles are read | |
//! | `spread.rs` | points far from each other | Gonzalez 1985 |
//! | `dynamics.rs` | the models of movement | |
//! | `ends.rs` | stops that nobody declared | |
//! | `dependents.rs` | inputs that follow from others | |
//! | `refit.rs`, `model.rs`, `memory.rs` | fitting anew in slices, the models, the ticks that were seen | |
//! | `weighted.rs`, `world.rs` | predictions with their derivatives | Griewank & Walther 2008 |
//! | `planner.rs`, `box_qp.rs`, `command_limits.rs` | control-limited iLQR | Tassa, Mansard & Todorov 2014 |
//! | `rivals.rs` | where other plans begin | |
//! | `belief.rs`, `exploration.rs` | outliers and alarms; noise | |
//! | `operations.rs` | what a tick's work takes | |
//! | `agent.rs` | what happens in a tick | |
//! | `linalg.rs`, `functions.rs` | sums in a fixed order; exponential, sine, cosine | Golub & Van Loan |
//!
//! Everything is in double precision, with a fixed order of summation and its own functions, so that the bits are the
//! same on every machine. Nothing is allocated once a learner is built. Work is counted in operations, never in time.
//!
//! ```
//! use tectum_core::learner::model_predictive::{
//!     InputRange, ModelPredictive, ModelPredictiveConfig, ModelPredictiveSpec, Observed, TickFlags,
//! };
//!
//! // A position that follows its command; the reward is largest at 0.5.
//! let mut agent = ModelPredictive::new(&ModelPredictiveSpec {
//!     inputs: vec![InputRange { min: -1.0, max: 1.0, wraps: false, radians: None }],
//!     limits: vec![1.0],
//!     steps: vec![f64::INFINITY],
//!     sigma: vec![0.1],
//!     seed: 1,
//!     config: ModelPredictiveConfig { reward_features: 60, dynamics_features: 60, ..Default::default() },
//! });
//! let (mut position, mut reward, mut command) = (0.0_f64, 0.0, [0.0]);
//! for _ in 0..40 {
//!     let applied = command;
//!     let flags = TickFlags::default();
//!     agent.act(&Observed { inputs: &[position], reward, applied: &applied, flags }, &mut command);
//!     agent.improve();
//!     position = (position + 0.3 * command[0]).clamp(-1.0, 1.0);
//!     reward = -(position - 0.5).powi(2);
//! }
//! assert!(command[0].abs() <= 1.0);
//! ```

// Loops over several arrays at once, with an index, are what the compiler makes vectors of.
#![allow(clippy::needless_range_loop)]

mod agent;
mod alignment;
mod belief;
mod box_qp;
mod command_limits;
mod config;
mod dependents;
mod dynamics;
mod ends;
mod evidence;
mod exploration;
mod features;
mod functions;
mod layout;
mod layouts;
mod linalg;
mod memory;
mod model;
mod operations;
mod planner;
mod refit;
mod regression;
mod rivals;
mod spread;
mod weighted;
mod world;

#[cfg(test)]
mod agent_tests;
#[cfg(test)]
mod plan_tests;
#[cfg(test)]
mod tests;

pub use agent::{GuardCounts, ModelPredictive, Observed, TickFlags};
pub use config::{InputRange, ModelPredictiveConfig, ModelPredictiveSpec};
pub use operations::OPERATIONS_PER_MS;
