//! Tectum's numerical core: policies, learning rules, simulated plants and random streams.
//!
//! Everything here is pure computation, without clock, transport or files, and without allocation once built.
//! Time is the number of a tick. Randomness comes from named [streams](seed::stream). The state of every
//! component can be saved and restored through one trait ([`state::Persist`]).
//!
//! | module | content |
//! |---|---|
//! | [`policy`] | the linear-Gaussian policy over encoded features, and exploration noise |
//! | [`learner`] | the learning rules, behind the trait [`learner::LearningRule`] |
//! | [`agent`] | the trait [`agent::Agent`]: what decides on commands and learns; the learning rules as an agent |
//! | [`flag`] | the flags of a tick |
//! | [`plant`] | the trait [`plant::Plant`], and the simulated arm and eye |
//! | [`seed`] | random streams from (seed, name) |
//! | [`state`] | saving and restoring the state of a component |
//! | [`angle`] | angles brought into [-pi, pi) |
//!
//! The features come from [`tectum_encoder`]. One tick of learning with the paper's rule:
//!
//! ```
//! use tectum_core::learner::{LearningRule, PaperRule, Transition};
//! use tectum_core::policy::{Exploration, LinearPolicy};
//! use tectum_encoder::{Axis, Encoder, Map};
//!
//! // One input between -1 and 1 on eight units, one output.
//! let axis = Axis { input: 0, units: 8, min: -1.0, max: 1.0, radius: 0.3 };
//! let mut encoder = Encoder::new(&[Map::Line(axis)], true);
//! let mut policy = LinearPolicy::new(encoder.len(), encoder.positions().collect(), 1);
//! let mut rule = PaperRule::new(encoder.len(), 1, 0.9, 0.01);
//! let mut exploration = Exploration::new(1, 0.1, 1);
//!
//! let (mut features, mut next) = (encoder.features(), encoder.features());
//! encoder.encode(&[0.3], &mut features);
//! let noise = exploration.draw();
//! let mut command = policy.mean(features.as_slice());
//! command[0] += noise[0];
//! // The plant applies the command and returns a reward and the next input.
//! let reward = -(command[0] - 0.5).powi(2);
//! encoder.encode(&[0.2], &mut next);
//! rule.learn(
//!     &mut policy,
//!     &Transition {
//!         features: features.as_slice(),
//!         inputs: &[0.3],
//!         noise: &noise,
//!         applied: &command,
//!         reward,
//!         next_features: next.as_slice(),
//!         next_inputs: &[0.2],
//!         new_target: false,
//!     },
//! );
//! assert!(policy.norm() > 0.0);
//! ```

#![warn(missing_docs)]

pub mod agent;
pub mod angle;
pub mod flag;
pub mod learner;
pub mod plant;
pub mod policy;
pub mod seed;
#[doc(hidden)]
pub mod serde_pairs;
mod signal;
pub mod state;

pub use signal::SignalConfig;

/// Most inputs of a learning rule of this crate. An observation has room for more, for other agents.
pub const MAX_INPUTS: usize = 16;
/// Most outputs of a linear policy. A command has room for more, for other agents.
pub const MAX_OUTPUTS: usize = 8;
/// Maximum number of measures that a plant reports besides its inputs.
pub const MAX_MEASURES: usize = 6;
