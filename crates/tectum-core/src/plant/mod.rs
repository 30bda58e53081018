//! Plants: the bodies and tasks that a controller learns on, as pure computation.
//!
//! A plant knows no clock, no transport and no limits: it is told the command that the gate let through, moves by one
//! period, and says what came of it. Time is the tick's number.

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

/// What came of one tick.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Outcome {
    /// The reward of the tick.
    pub reward: f32,
    /// What an outside observer measured, in the scenario's order.
    pub measures: [f32; MAX_MEASURES],
}

/// A plant's joints at the beginning of a tick, for the gate's limits of position: one for each output, in their order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointState {
    /// Where they are, rad, as measured.
    pub position: Outputs,
    /// How far a command of 1 moves each in one tick, rad; negative where it turns the other way.
    pub travel: Outputs,
}

/// Anything that can be controlled.
///
/// A plant lists to its ledger ([`Persist`]) what it must know to go on after its process was killed: a simulated body all
/// of its state, one of hardware next to nothing, since the body itself remembers.
pub trait Plant: Persist {
    /// Senses at the beginning of `tick`: writes the inputs in the scenario's order and units, and says whether a new
    /// target (or trial) begins. Ticks only grow, but may jump when the plant was late.
    fn sense(&mut self, tick: u64, inputs: &mut [f32]) -> bool;

    /// Lives through `tick` with the command that the gate let through, and says what came of it.
    fn advance(&mut self, tick: u64, applied: &[f32]) -> Outcome;

    /// For a body of hardware, where the command of a tick acts during that tick: until when, ns after the tick's beginning, a
    /// command is waited for. `None`, as for all that is simulated: the tick is lived through when it is over.
    fn command_deadline_ns(&self) -> Option<u64> {
        None
    }

    /// For a body that acts at once: passes the command of `tick` on, as the gate let it through. What the body itself limits is
    /// changed in `applied`, and said with bits of the flag words of an observation. [`Plant::advance`] follows when the tick is over.
    fn act(&mut self, _tick: u64, _applied: &mut [f32], _flags: u32) -> u32 {
        0
    }

    /// Flags of what was sensed last, beside those of the gate.
    fn sensing_flags(&self) -> u32 {
        0
    }

    /// The joints as they are, if the outputs move joints; asked before a tick is lived through. Without them there can be no
    /// limits of position (`positions` under `[gate]`).
    fn joints(&self) -> Option<JointState> {
        None
    }
}

/// The bodies of the simulator.
#[derive(Debug, Clone)]
pub enum SimulatedPlant {
    /// The planar arm.
    Arm(Box<Arm>),
    /// The saccading eye.
    Eye(Eye),
}

impl SimulatedPlant {
    /// The plant that a scenario configures, for a tick of `period_s` seconds and the run's `seed`; `None` without
    /// either, when the plant is another program's.
    pub fn new(arm: Option<&ArmConfig>, eye: Option<&EyeConfig>, period_s: f64, seed: u64) -> Option<Self> {
        match (arm, eye) {
            (Some(table), _) => Some(Self::Arm(Box::new(Arm::new(table, period_s, seed)))),
            (None, Some(table)) => Some(Self::Eye(Eye::new(table, seed))),
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
