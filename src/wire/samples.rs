//! The samples on the channels and in the log, and the flags in their headers.

use super::{MAX_INPUTS, MAX_MEASURES, MAX_OUTPUTS, schema::sample};

sample! {
    /// The start of every sample: its writer, its tick and its instants.
    Header, "1" {
        /// Id of the run, the same in all its processes.
        run: u64,
        /// The tick that the sample belongs to.
        tick: u64,
        /// Counts the samples of this channel from 0. A gap is a loss, and a repeated number is a duplicate.
        sequence: u64,
        /// The instant for which the tick was scheduled, `t0 + tick * period`, ns.
        scheduled_ns: u64,
        /// The instant at which the plant had sensed the observation of this tick, ns.
        sensed_ns: u64,
        /// The instant at which the writer sent the sample, ns.
        published_ns: u64,
        /// The writer's start number within the run, from 0.
        incarnation: u32,
        /// Bits of [`flag`].
        flags: u32,
    }
}

sample! {
    /// The plant's sample at tick k: the current inputs, and the result of tick k-1.
    Observation, "1" {
        /// Writer, tick and instants.
        header: Header,
        /// The controller's inputs, in the scenario's order and units; unused entries are 0.
        inputs: [f32; MAX_INPUTS],
        /// The command that was applied during tick k-1, after hold policy and gate; unused entries are 0.
        applied: [f32; MAX_OUTPUTS],
        /// The reward of tick k-1.
        reward: f32,
        /// Ticks skipped right before this one because the plant itself was late.
        skipped: u32,
        /// Measures of tick k-1, named by the scenario. They are for logs and reports; the learner never
        /// receives them. The arm gives its error (m) and its end-effector's x and y (m).
        measures: [f32; MAX_MEASURES],
    }
}

sample! {
    /// The controller's answer to the observation of the same tick.
    Command, "1" {
        /// Writer, tick and instants.
        header: Header,
        /// The policy's mean output.
        mean: [f32; MAX_OUTPUTS],
        /// The drawn output: mean plus exploration noise. This is the command for the plant.
        drawn: [f32; MAX_OUTPUTS],
    }
}

sample! {
    /// The learner's record of tick k: its step with the reward of tick k-1, and the exploration noise for tick
    /// k.
    Learning, "1" {
        /// Writer, tick and instants.
        header: Header,
        /// The exploration noise in the command of this tick.
        noise: [f32; MAX_OUTPUTS],
        /// The reward that was used; valid only if [`flag::LEARNED`] is set.
        reward: f32,
        /// The factor by which the trace was multiplied before it was added to the weights.
        step: f32,
        /// Euclidean norm of the weights after the step.
        weights_norm: f32,
        /// Euclidean norm of the eligibility trace after the step.
        trace_norm: f32,
        /// 64-bit hash of the weights after the step; 0 unless [`flag::HASHED`] is set.
        weights_hash: u64,
    }
}

sample! {
    /// A tracker's measurement: the target and the arm's end-effector. In its header, `tick`, `scheduled_ns`,
    /// `incarnation` and `flags` are 0.
    Vision, "1" {
        /// Writer and instants. `sensed_ns` is the instant at which the picture was taken. `sequence` counts
        /// from 0 in each tracker.
        header: Header,
        /// Position of the target, x and y in the arm's coordinates, m.
        target: [f32; 2],
        /// Position of the end-effector, x and y in the arm's coordinates, m.
        end: [f32; 2],
    }
}

sample! {
    /// The log's own statement that samples of a channel are missing from it.
    Gap, "1" {
        /// The channel: 0 observation, 1 command, 2 learning.
        channel: u64,
        /// Sequence number of the first missing sample.
        first: u64,
        /// Number of consecutive missing samples.
        count: u64,
        /// Number of missing samples on this channel up to and including these.
        total: u64,
    }
}

/// Bits of [`Header::flags`].
pub mod flag {
    /// Observation: the first of its writer. Its reward and applied command belong to no tick.
    pub const FIRST: u32 = 1 << 0;
    /// Observation: the command of tick k-1 had not arrived in time, so the hold policy chose the command.
    pub const MISSED: u32 = 1 << 1;
    /// Observation: the hold policy held the last command.
    pub const HELD: u32 = 1 << 2;
    /// Observation: the hold policy let the last command decay.
    pub const DECAYED: u32 = 1 << 3;
    /// Observation: the hold policy stopped the plant (command zero).
    pub const STOPPED: u32 = 1 << 4;
    /// Observation: the gate limited the command. Another flag gives the reason unless it was the command's
    /// size alone.
    pub const CLAMPED: u32 = 1 << 5;
    /// Observation: the command contained a value that is not finite. It counts as missed.
    pub const NON_FINITE: u32 = 1 << 6;
    /// Observation: the plant skipped `skipped` ticks because it was late itself.
    pub const SKIPPED: u32 = 1 << 7;
    /// Observation: a new target (or trial) starts with these inputs. The reward belongs to the one before.
    pub const NEW_TARGET: u32 = 1 << 8;
    /// Observation: a command arrived after its tick and was dropped.
    pub const LATE: u32 = 1 << 9;
    /// Command: an input was not a number or out of range, so the command is zero.
    pub const INVALID: u32 = 1 << 10;
    /// Command and learning: learning produced a number that is not finite, and the learner has stopped. When
    /// the policy's output is not finite either, the command is zero.
    pub const DIVERGED: u32 = 1 << 11;
    /// Observation: the gate limited the change of the applied command from tick to tick.
    pub const STEP_LIMITED: u32 = 1 << 12;
    /// Observation: the gate kept a joint within its position limits.
    pub const POSITION_LIMITED: u32 = 1 << 13;
    /// Observation: commands had just started to arrive, or to arrive again, and the gate's ramp limited the
    /// command.
    pub const RAMPED: u32 = 1 << 14;
    /// Command: the controller received no observation of this tick. The sample states this, and counts as
    /// missed.
    pub const UNHEARD: u32 = 1 << 15;
    /// Observation: the plant is hardware with torque off, because it has not been armed. Nothing was applied.
    pub const UNARMED: u32 = 1 << 19;
    /// Observation: the plant is hardware, and its own safety has turned torque off. Nothing was applied.
    pub const TRIPPED: u32 = 1 << 20;
    /// Observation: the plant could not be read, or its tracker had no measurement new enough, in tick k-1 or
    /// for this observation. Values that could not be updated, and the reward, are the previous ones.
    pub const BLIND: u32 = 1 << 21;
    /// Learning: the weights were changed with the reward of tick k-1.
    pub const LEARNED: u32 = 1 << 16;
    /// Learning: the trace was cleared, because the command applied in tick k-1 was not the policy's.
    pub const TRACE_CUT: u32 = 1 << 17;
    /// Learning: `weights_hash` is valid.
    pub const HASHED: u32 = 1 << 18;
}
