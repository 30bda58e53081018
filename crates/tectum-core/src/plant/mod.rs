//! Plants: the controlled systems and their tasks, as pure computation.
//!
//! A plant uses no clock and no transport, and does not limit commands. It receives the command after the gate has
//! limited it, advances by one period, and returns the outcome. Time is the number of the tick.

mod arm;
mod cart_pole;
mod eye;
mod eye_config;
mod furuta;
mod pendulum;
mod point_mass;
mod reacher;
mod signals;
mod simulated;
mod so101;
mod soft_limit;
mod state_space;
pub mod task;
mod timing;

pub use arm::{
    Angles, Arm, ArmConfig, ArmModel, ArmRewardConfig, BlockConfig, MirrorAxis, MirrorConfig, PayloadConfig,
    ShortenConfig, noise_share, posture,
};
pub use cart_pole::{CartPole, CartPoleConfig, CartPoleModel};
pub use eye::{Eye, Stimulus, log_polar};
pub use eye_config::{EyeConfig, Retina};
pub use furuta::{Furuta, FurutaConfig, FurutaModel};
pub use pendulum::{Pendulum, PendulumConfig, PendulumModel, Start};
pub use point_mass::{PointMass, PointMassConfig, PointMassModel};
pub use reacher::{Reacher, ReacherConfig, ReacherModel};
pub use signals::BodySignals;
pub use simulated::{BodyConfig, SimulatedPlant};
pub use so101::{So101, So101Config, So101Model};
pub use state_space::{MAX_STATES, SimulatedModel, StateSpace, StateSpacePlant};
pub use timing::{MAX_DELAY, TimingConfig};

use crate::MAX_MEASURES;
use crate::flag;
use crate::state::Persist;

/// The outcome of one tick: reward and measures.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Outcome {
    /// The reward of the tick.
    pub reward: f32,
    /// Quantities for log and report that the learner does not see, in the scenario's order.
    pub measures: [f32; MAX_MEASURES],
}

/// Most joints of a plant: as many as a command has outputs.
pub const MAX_JOINTS: usize = 16;

/// A plant's joints at the beginning of a tick, for the gate's position limits: one joint per output, in their
/// order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointState {
    /// Measured angle of each joint, rad.
    pub position: [f32; MAX_JOINTS],
    /// How far a command of 1 moves each joint in one tick, rad; negative where it turns in the other direction.
    pub travel: [f32; MAX_JOINTS],
}

/// How an episode ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EpisodeEnd {
    /// In a state after which nothing more can be earned: its value is zero.
    Terminated,
    /// It was cut off, for a reason that is not in the inputs, such as a limit of time. The value after it is unknown.
    Truncated,
}

impl EpisodeEnd {
    /// The flag of an observation that states this end.
    pub fn flag(self) -> u32 {
        match self {
            Self::Terminated => flag::TERMINATED,
            Self::Truncated => flag::TRUNCATED,
        }
    }
}

/// A system that can be controlled.
///
/// A plant lists ([`Persist`]) the state that it needs to continue after its process was killed. A simulated
/// plant lists all of its state. A plant on hardware lists almost nothing, since the hardware keeps its own
/// state.
pub trait Plant: Persist {
    /// Senses at the beginning of `tick`: writes all `inputs`, in the scenario's order and units. Returns whether
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

    /// Whether an episode ended with the last call of [`Plant::advance`], and how. The inputs that the plant senses
    /// next are then the first of another episode.
    fn episode_end(&self) -> Option<EpisodeEnd> {
        None
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
