//! wip
#![allow(missing_docs, dead_code, clippy::too_many_arguments, clippy::needless_range_loop)]
mod agent;
mod belief;
mod box_qp;
mod config;
mod evidence;
mod exploration;
mod features;
mod functions;
mod layout;
mod layouts;
mod linalg;
mod memory;
mod model;
mod planner;
mod refit;
mod regression;
mod rivals;
mod weighted;
mod world;

pub use agent::{Counts, ModelPredictive, Observed, TickFlags};
pub use config::{InputRange, ModelPredictiveConfig, ModelPredictiveSpec};

#[cfg(test)]
mod agent_tests;
#[cfg(test)]
mod plan_tests;
#[cfg(test)]
mod tests;
