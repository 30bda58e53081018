//! Plants: the controlled systems and their tasks, as pure computation.
//!
//! A plant uses no clock and no transport, and does not limit commands. It receives the command after the gate has
//! limited it, advances by one period, and returns the outcome. Time is the number of the tick.

mod arm;
mod eye;
mod eye_config;

pub use arm::{
    Angles, Arm, ArmConfig, ArmRewardConfig, BlockConfig, MirrorAxis, MirrorConfig, ShortenConfig, noise_share, posture,
};
pub use eye::{Eye, Stimulus, log_polar};
pub use eye_config::{EyeConfig, Retina};

use crate::MAX_MEASURES;
use crate::policy::Outputs;
use crate::state::{Persist, StateVisitor};

/// The outcome of one tick: reward and measures.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Outcome {
    /// The reward of the tick.
    pub reward: f32,
    /// Quantities for log and report that the learner does not see, in the scenario's order.
    pub measures: [f32; MAX_MEASURES],
}

/// A plant's joints at the beginning of a tick, for the gate's position limits: one joint per output, in their
/// order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointState {
    /// Measured angle of each joint, rad.
    pub position: Outputs,
    /// How far a command of 1 moves each joint in one tick, rad; negative where it turns in the other direction.
    pub travel: Outputs,
}

/// A system that can be controlled.
///
/// A plant lists ([`Persist`]) the state that it needs to continue after its process was killed. A simulated
/// plant lists all of its state. A plant on hardware lists almost nothing, since the hardware keeps its own
/// state.
pub trait Plant: Persist {
    /// Senses at the beginning of `tick`: writes the inputs in the scenario's order and units. Returns whether
    /// a new target (or trial) begins. Ticks increase, and may skip numbers when the plant was late.
    fn sense(&mut self, tick: u64, inputs: &mut [f32]) -> bool;

    /// Advances through `tick` with the command as the gate limited it, and returns the outcome.
    fn advance(&mut self, tick: u64, applied: &[f32]) -> Outcome;

    /// For a plant on hardware, where the command of a tick acts during that tick: how long the plant's loop
    /// waits for the command, ns after the beginning of the tick. `None` for a simulated plant, which advances
    /// when the tick is over.
    fn command_deadline_ns(&self) -> Option<u64> {
        None
    }

    /// For a plant that acts during the tick: applies the command of `tick`, as the gate limited it. If the
    /// plant limits the command further, it changes `applied` and returns the flags of an observation that say
    /// so. [`Plant::advance`] follows when the tick is over.
    fn act(&mut self, _tick: u64, _applied: &mut [f32], _flags: u32) -> u32 {
        0
    }

    /// Flags about the latest sensing, in addition to those of the gate.
    fn sensing_flags(&self) -> u32 {
        0
    }

    /// The joints, if the outputs move joints; called before [`Plant::advance`]. The gate's position limits
    /// (`positions` under `[gate]`) need them.
    fn joints(&self) -> Option<JointState> {
        None
    }

    /// The run is over: called once after the last tick, before checkpoint and reports are written. A plant that is
    /// hardware stops here.
    fn stop(&mut self) {}
}

/// The simulated plants.
#[derive(Debug, Clone)]
pub enum SimulatedPlant {
    /// The planar arm.
    Arm(Box<Arm>),
    /// The saccading eye.
    Eye(Eye),
}

impl SimulatedPlant {
    /// The plant that a scenario configures, for ticks of `period_s` seconds and the run's `seed`. `None` if
    /// neither is configured, because another program is the plant.
    pub fn new(arm: Option<&ArmConfig>, eye: Option<&EyeConfig>, period_s: f64, seed: u64) -> Option<Self> {
        match (arm, eye) {
            (Some(config), _) => Some(Self::Arm(Box::new(Arm::new(config, period_s, seed)))),
            (None, Some(config)) => Some(Self::Eye(Eye::new(config, seed))),
            (None, None) => None,
        }
    }
}

impl Plant for SimulatedPlant {
    fn sense(&mut self, tick: u64, inputs: &mut [f32]) -> bool {
        match self {
            Self::Arm(arm) => arm.sense(tick, inputs),
            Self::Eye(eye) => eye.sense(tick, inputs),
        }
    }

    fn advance(&mut self, tick: u64, applied: &[f32]) -> Outcome {
        match self {
            Self::Arm(arm) => arm.advance(tick, applied),
            Self::Eye(eye) => eye.advance(tick, applied),
        }
    }

    fn joints(&self) -> Option<JointState> {
        match self {
            Self::Arm(arm) => arm.joints(),
            Self::Eye(eye) => eye.joints(),
        }
    }
}

impl Persist for SimulatedPlant {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        match self {
            Self::Arm(arm) => arm.visit_state(visitor),
            Self::Eye(eye) => eye.visit_state(visitor),
        }
    }
}
