//! What goes over the channels and into the log.

use super::{MAX_INPUTS, MAX_MEASURES, MAX_OUTPUTS, schema::sample};

sample! {
    /// Opens every sample: who wrote it, for which tick, and when.
    Header, "1" {
        /// Id of the run, the same in all its processes.
        run: u64,
        /// The tick that the sample belongs to.
        tick: u64,
        /// Counts the writer's samples on this channel from 0: a gap is a loss, a repeat a duplicate.
        sequence: u64,
        /// The instant for which the tick was scheduled, `t0 + tick * period`, ns.
        scheduled_ns: u64,
        /// When the plant had sensed the observation that this sample belongs to, ns.
        sensed_ns: u64,
        /// When the writer handed the sample to the channel, ns.
        published_ns: u64,
        /// The writer's start number within the run, from 0.
        incarnation: u32,
        /// Bits of [`flag`].
        flags: u32,
    }
}

sample! {
    /// What the plant tells at tick k: the inputs now, and what came of tick k-1.
    Observation, "1" {
        /// Who, which tick, when.
        header: Header,
        /// The controller's inputs, in the scenario's order and units; unused entries are 0.
        inputs: [f32; MAX_INPUTS],
        /// The command that was applied during tick k-1, after hold policy and gate; unused entries are 0.
        applied: [f32; MAX_OUTPUTS],
        /// The reward of tick k-1.
        reward: f32,
        /// Ticks passed over right before this one because the plant itself was late.
        skipped: u32,
        /// What an outside observer measured of tick k-1, named by the scenario. For logs and reports: the learner
        /// never sees it. The arm gives its error (m) and its end-effector's x and y (m).
        measures: [f32; MAX_MEASURES],
    }
}

sample! {
    /// The controller's answer to the observation of the same tick.
    Command, "1" {
        /// Who, which tick, when.
        header: Header,
        /// The policy's mean output.
        mean: [f32; MAX_OUTPUTS],
        /// The drawn output, mean plus exploration noise: what the plant is asked to apply.
        drawn: [f32; MAX_OUTPUTS],
    }
}

sample! {
    /// What the learner did at tick k, with the reward of tick k-1, and the noise that it drew for tick k.
    Learning, "1" {
        /// Who, which tick, when.
        header: Header,
        /// The exploration noise in the command of this tick.
        noise: [f32; MAX_OUTPUTS],
        /// The reward that was used; meaningless unless [`flag::LEARNED`] is set.
        reward: f32,
        /// The factor with which the trace was added to the weights.
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
    /// What a tracker sees: the target and the arm's end-effector. Of its header, `tick`, `scheduled_ns`, `incarnation` and `flags` are 0.
    Vision, "1" {
        /// Who, and when: `sensed_ns` is the instant at which the picture was taken, `sequence` counts from 0 in each tracker.
        header: Header,
        /// Where the target is, x and y in the arm's coordinates, m.
        target: [f32; 2],
        /// Where the end-effector is, x and y in the arm's coordinates, m.
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
        /// How many are missing in a row.
        count: u64,
        /// How many are missing on this channel up to and including these.
        total: u64,
    }
}

/// Bits of [`Header::flags`].
pub mod flag {
    /// Observation: the first of its writer; reward and applied command belong to no tick.
    pub const FIRST: u32 = 1 << 0;
    /// Observation: the command of tick k-1 was not there in time; the hold policy applied.
    pub const MISSED: u32 = 1 << 1;
    /// Observation: the hold policy held the last command.
    pub const HELD: u32 = 1 << 2;
    /// Observation: the hold policy let the last command decay.
    pub const DECAYED: u32 = 1 << 3;
    /// Observation: the hold policy stopped the plant (command zero).
    pub const STOPPED: u32 = 1 << 4;
    /// Observation: the gate limited the command; why it did stands beside it where it was not the command's size alone.
    pub const CLAMPED: u32 = 1 << 5;
    /// Observation: the command held a value that is not a number; it counts as missed.
    pub const NON_FINITE: u32 = 1 << 6;
    /// Observation: the plant passed over `skipped` ticks because it was late itself.
    pub const SKIPPED: u32 = 1 << 7;
    /// Observation: a new target (or trial) starts with these inputs; the reward belongs to the one before.
    pub const NEW_TARGET: u32 = 1 << 8;
    /// Observation: a command arrived after its tick and was dropped.
    pub const LATE: u32 = 1 << 9;
    /// Command: an input was not a number, so the answer is zero.
    pub const INVALID: u32 = 1 << 10;
    /// Command and learning: a number that is not finite was met in learning. The learner has stopped, and where the
    /// weights themselves are no longer numbers the answer is zero.
    pub const DIVERGED: u32 = 1 << 11;
    /// Observation: the gate limited the change of the applied command from tick to tick.
    pub const STEP_LIMITED: u32 = 1 << 12;
    /// Observation: the gate kept a joint from going over its limits.
    pub const POSITION_LIMITED: u32 = 1 << 13;
    /// Observation: commands had just begun to come, or come back, and the gate let them grow.
    pub const RAMPED: u32 = 1 << 14;
    /// Command: the controller heard nothing of this tick; the sample stands for silence, and counts as missed.
    pub const UNHEARD: u32 = 1 << 15;
    /// Observation: the body is real and torque is off, because nobody has armed it; nothing was applied.
    pub const UNARMED: u32 = 1 << 19;
    /// Observation: the body is real and its own safety has turned torque off; nothing was applied.
    pub const TRIPPED: u32 = 1 << 20;
    /// Observation: the body could not be read, or its tracker had nothing new enough to say, in tick k-1 or for this observation; what is
    /// not known anew, and the reward, are those of before.
    pub const BLIND: u32 = 1 << 21;
    /// Learning: the weights were changed with the reward of tick k-1.
    pub const LEARNED: u32 = 1 << 16;
    /// Learning: the trace was cleared, because what happened in tick k-1 is not what the policy asked for.
    pub const TRACE_CUT: u32 = 1 << 17;
    /// Learning: `weights_hash` is valid.
    pub const HASHED: u32 = 1 << 18;
}
