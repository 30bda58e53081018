//! The flags of observations, commands and learning records: what happened in a tick, as bits of a `u32`.
//!
//! [`FLAGS`] is the one table of names and bits. Logs, CSV files, the C header and the pages of the manual are made
//! from it.

/// A flag: its name, its bit and its meaning.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Flag {
    /// Name, the same in every language.
    pub name: &'static str,
    /// The flag as a number with one bit set.
    pub bit: u32,
    /// Meaning: one line that starts with a space.
    pub doc: &'static str,
}

/// Declares the constants, and the table of all of them.
macro_rules! flags {
    ($($(#[doc = $doc:literal])* $name:ident = $bit:literal;)+) => {
        $($(#[doc = $doc])* pub const $name: u32 = 1 << $bit;)+

        /// All flags, by bit.
        pub const FLAGS: &[Flag] =
            &[$(Flag { name: stringify!($name), bit: $name, doc: concat!($($doc),*) }),+];
    };
}

flags! {
    /// Observation: the first of its writer. Its reward and applied command belong to no tick.
    FIRST = 0;
    /// Observation: the command of tick k-1 had not arrived in time, so the hold policy chose the command.
    MISSED = 1;
    /// Observation: the hold policy held the last command.
    HELD = 2;
    /// Observation: the hold policy let the last command decay.
    DECAYED = 3;
    /// Observation: the hold policy stopped the plant (command zero).
    STOPPED = 4;
    /// Observation: the gate limited the command. Another flag gives the reason unless it was the command's
    /// size alone.
    CLAMPED = 5;
    /// Observation: the command contained a value that is not finite. It counts as missed.
    NON_FINITE = 6;
    /// Observation: the plant skipped `skipped` ticks because it was late itself.
    SKIPPED = 7;
    /// Observation: a new target (or trial) starts with these inputs. The reward belongs to the one before.
    NEW_TARGET = 8;
    /// Observation: a command arrived after its tick and was dropped.
    LATE = 9;
    /// Command: an input was not a number or out of range, so the command is zero.
    INVALID = 10;
    /// Command and learning: learning produced a number that is not finite, and the learner has stopped. When
    /// the policy's output is not finite either, the command is zero.
    DIVERGED = 11;
    /// Observation: the gate limited the change of the applied command from tick to tick.
    STEP_LIMITED = 12;
    /// Observation: the gate kept a joint within its position limits.
    POSITION_LIMITED = 13;
    /// Observation: commands had just started to arrive, or to arrive again, and the gate's ramp limited the
    /// command.
    RAMPED = 14;
    /// Command: the controller received no observation of this tick. The sample states this, and counts as
    /// missed.
    UNHEARD = 15;
    /// Learning: the weights were changed with the reward of tick k-1.
    LEARNED = 16;
    /// Learning: the trace was cleared, because the command applied in tick k-1 was not the policy's.
    TRACE_CUT = 17;
    /// Learning: `weights_hash` is valid.
    HASHED = 18;
    /// Observation: the plant is hardware with torque off, because it has not been armed. Nothing was applied.
    UNARMED = 19;
    /// Observation: the plant is hardware, and its own safety has turned torque off. Nothing was applied.
    TRIPPED = 20;
    /// Observation: the plant could not be read, or its tracker had no measurement new enough, in tick k-1 or
    /// for this observation. Values that could not be updated, and the reward, are the previous ones.
    BLIND = 21;
    /// Observation: the episode ended with tick k-1, in a state after which nothing more can be earned: its value is
    /// zero. The inputs are the first of the next episode.
    TERMINATED = 22;
    /// Observation: the episode was cut off after tick k-1, for a reason that is not in the inputs, such as a limit of
    /// time. The value after it is not zero, but unknown. The inputs are the first of the next episode.
    TRUNCATED = 23;
    /// Observation: without a command in time, the gate applied the one for this tick that an earlier command had
    /// brought ahead. `MISSED` is set as well.
    AHEAD = 24;
}

/// The flags with which an episode ends.
pub const EPISODE_END: u32 = TERMINATED | TRUNCATED;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_flag_has_a_bit_of_its_own() {
        let all = FLAGS.iter().fold(0, |all, flag| {
            assert_eq!((flag.bit.count_ones(), all & flag.bit), (1, 0), "{}", flag.name);
            all | flag.bit
        });
        assert_eq!(all.count_ones() as usize, FLAGS.len());
        assert!(FLAGS.is_sorted_by_key(|flag| flag.bit));
    }
}
