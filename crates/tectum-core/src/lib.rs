//! Tectum's numerical core: policies, learning rules, simulated plants and random streams.
//!
//! Everything here is pure computation. It knows no clock, no transport and no files, and allocates nothing once built:
//! time is a tick's number, randomness comes from a named [stream](seed::stream), and the state of every part can be
//! saved and restored through one list ([`state::Persist`]).
//!
//! | module | what it holds |
//! |---|---|
//! | [`policy`] | the linear-Gaussian policy over encoded features, and exploration noise |
//! | [`learner`] | one file a learning rule, behind [`learner::LearningRule`] |
//! | [`plant`] | [`plant::Plant`], and the simulated arm and eye |
//! | [`seed`] | random streams from (seed, name) |
//! | [`state`] | the list of what a part must remember |
//!
//! The features come from [`tectum_encoder`]. One tick after the other, the paper's rule learns like this:
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
//! // The plant answers: a reward, and where it is now.
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
//!     },
//! );
//! assert!(policy.norm() > 0.0);
//! ```

#![warn(missing_docs)]

pub mod learner;
pub mod plant;
pub mod policy;
pub mod seed;
pub mod serde_pairs;
mod signal;
pub mod state;

pub use signal::SignalConfig;

/// Most inputs that a learner sees, and that an observation carries.
pub const MAX_INPUTS: usize = 16;
/// Most outputs that a policy has, and that a command carries.
pub const MAX_OUTPUTS: usize = 8;
/// Most measures that a plant gives beside its inputs.
pub const MAX_MEASURES: usize = 6;
