//! The gate between commands and actuators: hold policy and limits, independent of who sends the commands.
//!
//! Invariant I7: for any command (none, late, not a number, huge), the applied command is finite and within
//! limits. In each tick the gate starts from the *wanted* command: the one that arrived, or, without one, one that
//! an earlier command brought ahead for this tick, or else the hold policy's (hold the last command, then decay it to
//! zero, then zero). Commands ahead only take the place of held ones: they are no older than the hold policy holds,
//! so the plant stops as soon as without them. The gate then limits each output by itself:
//!
//! 1. *Rate.* A command is limited to `max_command` in magnitude. In a *ramp* it is limited to a share of that,
//!    which grows from `1 / (ramp_ticks + 1)` to 1 by one step per command. A ramp starts when commands start
//!    to arrive, or arrive again after the gate has begun to let the last one decay.
//! 2. *Step.* The applied command differs by at most `max_step` from the one applied in the previous tick, also
//!    in hold, decay and stop.
//! 3. *Position.* Only the part of the command that does not carry the joint beyond its limits is applied. A
//!    joint that is already outside (pushed, or started there) may stay or return, and goes no further out. A
//!    joint whose position is not known does not move.
//!
//! Where two limits conflict, position goes before step, and step before ramp. The rate limit always holds,
//! because zero and the previous tick's command are within it. Zero never carries a joint anywhere, so there is
//! always a command to apply.
//!
//! [`Controller`](super::Controller#credit-for-a-limited-command) documents what is learned from a limited
//! command.

use super::commands_ahead::CommandAhead;
use crate::plant::JointState;
use crate::scenario::GateConfig;
use crate::state::{Persist, StateVisitor};
use crate::wire::{MAX_OUTPUTS, OutputValues, flag};

/// The gate's output in one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Applied {
    /// The command for the actuators. OutputValues beyond the plant's are 0.
    pub command: OutputValues,
    /// The gate's actions as bits of [`flag`]: [`flag::MISSED`] with one of `AHEAD`, `HELD`, `DECAYED` and `STOPPED`;
    /// [`flag::NON_FINITE`]; and [`flag::CLAMPED`], with `RAMPED`, `STEP_LIMITED` and `POSITION_LIMITED` where
    /// one of these limits applied.
    pub flags: u32,
}

/// The gate of one plant.
#[derive(Debug, Clone)]
pub struct Gate {
    /// Largest magnitude of a command.
    limit: OutputValues,
    /// Largest change from tick to tick.
    step: Option<OutputValues>,
    /// Lower and upper position limit of each joint, rad.
    positions: Option<[[f64; 2]; MAX_OUTPUTS]>,
    /// Durations of hold, decay and ramp, ticks.
    hold: u32,
    decay: u32,
    ramp: u32,
    outputs: usize,
    /// The applied command of the last tick with a command, in time or ahead. The hold policy holds it.
    last: OutputValues,
    /// Ticks without a command since then, or the age of a command ahead.
    missing: u32,
    /// The command applied in the last tick.
    applied: OutputValues,
    /// Commands since the start of the ramp, up to `ramp + 1`.
    ramp_commands: u32,
}

/// The range of commands that a limit leaves to an output, from the first to the second. It contains 0.
pub type CommandRange = [f32; 2];

/// The ranges of commands that the position limits leave to the outputs.
pub type CommandRanges = [CommandRange; MAX_OUTPUTS];

impl Gate {
    /// The gate of a validated configuration, for `outputs` outputs. Before the first command it applies zero.
    pub fn new(config: &GateConfig, outputs: usize) -> Self {
        let mut positions = [[0.0; 2]; MAX_OUTPUTS];
        for (to, from) in positions.iter_mut().zip(&config.positions) {
            *to = *from;
        }
        Self {
            limit: config.max_command.outputs(),
            step: config.max_step.as_ref().map(|step| step.outputs()),
            positions: (!config.positions.is_empty()).then_some(positions),
            hold: config.hold_ticks,
            decay: config.decay_ticks,
            ramp: config.ramp_ticks,
            outputs,
            last: [0.0; MAX_OUTPUTS],
            missing: 0,
            applied: [0.0; MAX_OUTPUTS],
            ramp_commands: 0,
        }
    }

    /// The ranges of commands that the position limits leave in the current state of the joints; `None` without
    /// position limits, and then `joints` is not called. When `joints` returns `None`, no joint may move.
    pub fn command_ranges(&self, joints: impl FnOnce() -> Option<JointState>) -> Option<CommandRanges> {
        let positions = self.positions.as_ref()?;
        let ranges =
            |joints: JointState| std::array::from_fn(|output| command_range(&joints, output, positions[output]));
        Some(joints().map_or([[0.0; 2]; MAX_OUTPUTS], ranges))
    }

    /// One tick: takes the command that arrived for it, or `None`, and the ranges that the position limits
    /// leave ([`Gate::command_ranges`]). A command with a value that is not finite counts as none.
    pub fn pass(&mut self, command: Option<&OutputValues>, ranges: Option<&CommandRanges>) -> Applied {
        self.pass_or(command, None, ranges)
    }

    /// [`pass`](Self::pass), with a command ahead for a tick in which none arrives.
    pub fn pass_or(
        &mut self,
        command: Option<&OutputValues>,
        ahead: Option<CommandAhead>,
        ranges: Option<&CommandRanges>,
    ) -> Applied {
        let arrived = command.map(|command| self.used(command)).filter(all_finite);
        let ahead = if arrived.is_some() { None } else { self.used_ahead(ahead) };
        let (wanted, mut flags) = match (&arrived, &ahead) {
            (Some(command), _) => self.limit_rate(command, 0),
            (None, Some(CommandAhead { command, age })) => {
                let (wanted, flags) = self.limit_rate(command, *age);
                (wanted, flags | flag::MISSED | flag::AHEAD)
            }
            (None, None) => self.hold_policy(),
        };
        if arrived.is_none() && command.is_some() {
            flags |= flag::NON_FINITE;
        }
        let mut applied = wanted;
        if let Some(step) = &self.step {
            let ranges = std::array::from_fn(|output| step_range(self.applied[output], step[output]));
            flags |= self.limit(&mut applied, &ranges, flag::STEP_LIMITED);
        }
        if let Some(ranges) = ranges {
            flags |= self.limit(&mut applied, ranges, flag::POSITION_LIMITED);
        }
        self.applied = applied;
        if arrived.is_some() || ahead.is_some() {
            self.last = applied;
        }
        Applied { command: applied, flags }
    }

    /// A command with zeros for the outputs that the plant does not have. Here and below the loops run over all
    /// outputs, a fixed number, because they then compile to a few vector operations.
    fn used(&self, command: &OutputValues) -> OutputValues {
        let mut used = *command;
        for (output, u) in used.iter_mut().enumerate() {
            *u = if output < self.outputs { *u } else { 0.0 };
        }
        used
    }

    /// A command ahead, if it takes the place of one that would be held.
    fn used_ahead(&self, ahead: Option<CommandAhead>) -> Option<CommandAhead> {
        let CommandAhead { command, age } = ahead?;
        let command = self.used(&command);
        (age <= self.hold && all_finite(&command)).then_some(CommandAhead { command, age })
    }

    /// Clamps each output to its range. Returns [`flag::CLAMPED`] and `reason` where that changes one.
    fn limit(&self, applied: &mut OutputValues, ranges: &CommandRanges, reason: u32) -> u32 {
        let mut flags = 0;
        for (u, range) in applied[..self.outputs].iter_mut().zip(ranges) {
            flags |= clamp_to(u, *range, reason);
        }
        flags
    }

    /// Replaces the gate's output of the last tick by the command that was really applied.
    pub(super) fn set_applied(&mut self, applied: OutputValues) {
        self.applied = applied;
    }

    /// The wanted command for one that arrived, or came ahead `age` ticks ago: within the rate limit and the ramp.
    fn limit_rate(&mut self, command: &OutputValues, age: u32) -> (OutputValues, u32) {
        let starts = self.ramp_commands == 0 || self.missing > self.hold;
        self.ramp_commands =
            if starts { 1 } else { self.ramp_commands.saturating_add(1).min(self.ramp.saturating_add(1)) };
        self.missing = age;
        let share = self.ramp_commands as f32 / self.ramp.saturating_add(1) as f32;
        let (mut wanted, mut changed) = (*command, 0);
        for (u, limit) in wanted.iter_mut().zip(self.limit) {
            let before = *u;
            // Not `clamp`: it checks its arguments for each number, and the loop would have a branch for each.
            *u = if before > limit { limit } else { before };
            *u = if *u < -limit { -limit } else { *u };
            changed |= u32::from(*u != before);
        }
        let mut flags = if changed > 0 { flag::CLAMPED } else { 0 };
        if share < 1.0 {
            let ranges = self.limit.map(|limit| [-limit * share, limit * share]);
            flags |= self.limit(&mut wanted, &ranges, flag::RAMPED);
        }
        (wanted, flags)
    }

    /// The wanted command for a tick without one: the last command for `hold` ticks, then decaying to zero over
    /// `decay` ticks, then zero.
    fn hold_policy(&mut self) -> (OutputValues, u32) {
        self.missing = self.missing.saturating_add(1);
        let (share, flags) = if self.missing <= self.hold {
            (1.0, flag::HELD)
        } else if self.missing - self.hold <= self.decay {
            (1.0 - (self.missing - self.hold) as f32 / (self.decay + 1) as f32, flag::DECAYED)
        } else {
            (0.0, flag::STOPPED)
        };
        (self.last.map(|u| u * share), flags | flag::MISSED)
    }
}

/// Whether all values are finite. There is no branch per value, because they nearly always are.
fn all_finite(values: &OutputValues) -> bool {
    values.iter().fold(true, |all, u| all & u.is_finite())
}

/// Clamps `u` to a range. Returns [`flag::CLAMPED`] and `reason` where that changes it.
fn clamp_to(u: &mut f32, [low, high]: CommandRange, reason: u32) -> u32 {
    let before = *u;
    *u = u.clamp(low, high);
    if *u == before { 0 } else { flag::CLAMPED | reason }
}

/// The numbers whose exact distance from `from` is at most `by`, in spite of rounding.
fn step_range(from: f32, by: f32) -> CommandRange {
    let (mut low, mut high) = (from - by, from + by);
    if f64::from(from) - f64::from(low) > f64::from(by) {
        low = low.next_up();
    }
    if f64::from(high) - f64::from(from) > f64::from(by) {
        high = high.next_down();
    }
    [low, high]
}

/// The range of commands that do not carry joint `output` beyond its limits, rad. It always contains 0.
///
/// With the position `p` and the travel `k`, the joint moves to `p + k u`. That must lie between the
/// limits, or, for a joint outside them, between its position and the far limit. A margin of 1e-6 of the
/// largest angle covers the rounding of the sum to single precision in the plant.
fn command_range(joints: &JointState, output: usize, [low, high]: [f64; 2]) -> CommandRange {
    let (p, k) = (f64::from(joints.position[output]), f64::from(joints.travel[output]));
    if !(p.is_finite() && k.is_finite()) {
        return [0.0; 2];
    }
    if k == 0.0 {
        return [f32::MIN, f32::MAX];
    }
    let margin = 1e-6 * p.abs().max(low.abs()).max(high.abs()).max(1.0);
    let (low, high) = ((low + margin).min(p), (high - margin).max(p));
    let (a, b) = ((low - p) / k, (high - p) / k);
    [toward_zero(a.min(b)), toward_zero(a.max(b))]
}

/// The nearest single-precision number that is not larger in magnitude.
fn toward_zero(x: f64) -> f32 {
    let near = x as f32;
    if f64::from(near).abs() <= x.abs() {
        near
    } else if near > 0.0 {
        near.next_down()
    } else {
        near.next_up()
    }
}

impl Persist for Gate {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        visitor.numbers("last", &mut self.last);
        visitor.number("missing", &mut self.missing);
        visitor.numbers("applied", &mut self.applied);
        visitor.number("joined", &mut self.ramp_commands);
    }
}

#[cfg(test)]
mod tests;
