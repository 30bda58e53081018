//! Learning rules: from what was done and what came of it to new weights.
//!
//! A rule sees what the agent sees: the features, the exploration that was applied, the reward. It is told when a tick
//! is not to be learned from; why is the runtime's business.

mod paper;

pub use paper::Paper;
