//! Samples as a watcher hands them over, and what is kept of them.

/// An observation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeenObservation<'a> {
    /// Its tick.
    pub tick: u64,
    /// Its number on the channel, from 0.
    pub sequence: u64,
    /// Its flags, as bits.
    pub flags: u32,
    /// Whether its reward and applied command belong to no tick.
    pub first: bool,
    /// Whether a new target starts with it.
    pub new_target: bool,
    /// When the tick was scheduled, ns.
    pub scheduled_ns: u64,
    /// When the inputs were sensed, ns.
    pub sensed_ns: u64,
    /// When it was sent, ns.
    pub published_ns: u64,
    /// The inputs.
    pub inputs: &'a [f32],
    /// The command that was applied in the tick before.
    pub applied: &'a [f32],
    /// The reward of the tick before.
    pub reward: f32,
    /// The measures of the tick before.
    pub measures: &'a [f32],
    /// The arm's base, joints and end-effector, m; empty if there is no arm to draw.
    pub posture: &'a [[f32; 2]],
    /// The arm's target, m.
    pub target: Option<[f32; 2]>,
}

/// A command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SeenCommand {
    /// Its tick.
    pub tick: u64,
    /// Its flags, as bits.
    pub flags: u32,
    /// When it was sent, ns.
    pub published_ns: u64,
}

/// A learning record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeenLearning {
    /// Its tick.
    pub tick: u64,
    /// Its flags, as bits.
    pub flags: u32,
    /// When it was sent, ns: after the learner was done.
    pub published_ns: u64,
    /// Euclidean norm of the weights.
    pub weights_norm: f32,
}

/// A tick that is kept for drawing and for looking back.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TickRecord {
    /// Number of the record, from 0.
    pub number: u64,
    /// The tick.
    pub tick: u64,
    /// Its flags.
    pub flags: u32,
    /// The inputs.
    pub inputs: Vec<f32>,
    /// What was applied in the tick before.
    pub applied: Vec<f32>,
    /// The loss of the tick before: the reward with its sign turned.
    pub loss: f32,
    /// The error in the tick before, if it is measured.
    pub error: Option<f32>,
    /// The arm's base, joints and end-effector, m.
    pub posture: Vec<[f32; 2]>,
    /// The arm's target, m.
    pub target: Option<[f32; 2]>,
}

/// How a target went.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TargetOutcome {
    /// First tick with the target.
    pub from: u64,
    /// Ticks that were seen of it.
    pub ticks: u64,
    /// Mean loss of these ticks.
    pub loss: f64,
    /// The error in its last tick, if it is measured.
    pub end_error: Option<f64>,
}
