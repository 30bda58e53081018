//! The samples on the channels and in the log, and the flags in their headers.

use super::{MAX_AHEAD, MAX_COLUMNS, MAX_INPUTS, MAX_MEASURES, MAX_OUTPUTS, schema::sample};

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
        /// Bits of `flag`.
        flags: u32,
    }
}

sample! {
    /// The plant's sample at tick k: the current inputs, and the result of tick k-1.
    Observation, "2" {
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
    Command, "2" {
        /// Writer, tick and instants.
        header: Header,
        /// The policy's mean output.
        mean: [f32; MAX_OUTPUTS],
        /// The drawn output: mean plus exploration noise. This is the command for the plant.
        drawn: [f32; MAX_OUTPUTS],
    }
}

sample! {
    /// What goes with a command where the scenario has `[link] ahead`: commands without exploration noise for the
    /// ticks after it. It is sent just before the command.
    Ahead, "1" {
        /// As that of the command; `flags` is 0.
        header: Header,
        /// Number of ticks that there is a command for: those after the header's.
        ticks: u64,
        /// Their commands, one tick after the other, each as `drawn` of a command; unused entries are 0.
        commands: [[f32; MAX_OUTPUTS]; MAX_AHEAD],
    }
}

sample! {
    /// The learner's record of tick k: its step with the reward of tick k-1, and the exploration noise for tick
    /// k.
    Learning, "2" {
        /// Writer, tick and instants.
        header: Header,
        /// The exploration noise in the command of this tick.
        noise: [f32; MAX_OUTPUTS],
        /// The reward that was used; valid only if the flag `LEARNED` is set.
        reward: f32,
        /// The factor by which the trace was multiplied before it was added to the weights.
        step: f32,
        /// Euclidean norm of the weights after the step.
        weights_norm: f32,
        /// Euclidean norm of the eligibility trace after the step.
        trace_norm: f32,
        /// Numbers of the agent's own; the log's description of the run has their names (`columns`). Unused entries
        /// are 0.
        columns: [f32; MAX_COLUMNS],
        /// 64-bit hash of the weights after the step; 0 unless the flag `HASHED` is set.
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
