//! The gate, the last thing between a command and the actuators: hold policy and limits, whoever sends commands.
//!
//! Invariant I7: whatever comes (nothing, late, not a number, huge), what is applied is finite and within limits. In each
//! tick the gate starts from what is *wanted*: the command that came, or without one what the hold policy makes of the last
//! (held, then decaying to zero, then zero). Then, for each output by itself:
//!
//! 1. *Rate.* A command is limited to `max_command` in magnitude, and in a *ramp* to a share of it that grows from
//!    `1 / (ramp_ticks + 1)` to 1, one step with each command, when commands begin to come or come back after the gate had
//!    begun to let the last one decay.
//! 2. *Step.* What is applied differs by at most `max_step` from what was applied in the tick before, in hold, decay and
//!    stop as well.
//! 3. *Position.* Of that, only what does not carry the joint over its limits is let through. A joint that is outside already
//!    (pushed, or started there) may stay or come back, and goes no further; one whose position is not known does not move.
//!
//! Where two of them disagree, position goes before step and step before ramp. The rate limit always holds: zero and the
//! command of the tick before are within it. Standing still never carries a joint anywhere, so that there always is something
//! to let through.
//!
//! *What is learned from a limited command* is [documented](super::Controller#credit-for-a-limited-command) where it is
//! learned.

use crate::plant::JointState;
use crate::policy::Outputs;
use crate::scenario::GateConfig;
use crate::state::{Persist, StateVisitor};
use crate::wire::{MAX_OUTPUTS, flag};

/// What the gate lets through in one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Applied {
    /// The command for the actuators; outputs beyond the plant's are 0.
    pub command: Outputs,
    /// What the gate did, as bits of [`flag`]: [`flag::MISSED`] with one of `HELD`, `DECAYED`, `STOPPED`;
    /// [`flag::NON_FINITE`]; and [`flag::CLAMPED`], with `RAMPED`, `STEP_LIMITED` and `POSITION_LIMITED` where one of these
    /// was the reason.
    pub flags: u32,
}

/// The gate of one plant.
#[derive(Debug, Clone)]
pub struct Gate {
    limit: Outputs,
    step: Option<Outputs>,
    positions: Option<[[f64; 2]; MAX_OUTPUTS]>,
    hold: u32,
    decay: u32,
    ramp: u32,
    outputs: usize,
    /// What was let through of the last command that came: what is held.
    last: Outputs,
    /// Ticks without a command since then.
    missing: u32,
    /// What was applied in the last tick.
    applied: Outputs,
    /// Commands since they began to come, or came back, as far as the ramp counts.
    joined: u32,
}

/// The commands, from the first to the second, that a limit leaves to an output; 0 is among them.
pub type CommandRange = [f32; 2];

/// The commands that limits of position leave to each output.
pub type CommandRanges = [CommandRange; MAX_OUTPUTS];

impl Gate {
    /// The gate of a validated table, for `outputs` outputs. Before the first command it stands at zero.
    pub fn new(table: &GateConfig, outputs: usize) -> Self {
        let mut positions = [[0.0; 2]; MAX_OUTPUTS];
        for (to, from) in positions.iter_mut().zip(&table.positions) {
            *to = *from;
        }
        Self {
            limit: table.max_command.outputs(),
            step: table.max_step.as_ref().map(|step| step.outputs()),
            positions: (!table.positions.is_empty()).then_some(positions),
            hold: table.hold_ticks,
            decay: table.decay_ticks,
            ramp: table.ramp_ticks,
            outputs,
            last: [0.0; MAX_OUTPUTS],
            missing: 0,
            applied: [0.0; MAX_OUTPUTS],
            joined: 0,
        }
    }

    /// What the limits of position leave with the joints as they are, which `joints` tells; `None` without such limits, for
    /// which nobody is asked. Of a plant that does not tell, nothing moves.
    pub fn spans(&self, joints: impl FnOnce() -> Option<JointState>) -> Option<CommandRanges> {
        let positions = self.positions.as_ref()?;
        let spans =
            |joints: JointState| std::array::from_fn(|output| command_range(&joints, output, positions[output]));
        Some(joints().map_or([[0.0; 2]; MAX_OUTPUTS], spans))
    }

    /// One tick: the command that arrived for it, or `None`, and what the limits of position leave ([`Gate::spans`]). A command
    /// with a value that is not a number counts as none.
    pub fn pass(&mut self, command: Option<&Outputs>, spans: Option<&CommandRanges>) -> Applied {
        let numbers = |command: &&Outputs| command[..self.outputs].iter().all(|u| u.is_finite());
        let came = command.filter(numbers);
        let (wanted, mut flags) = match came {
            Some(command) => self.limited(command),
            None => self.without(),
        };
        if came.is_none() && command.is_some() {
            flags |= flag::NON_FINITE;
        }
        for output in 0..self.outputs {
            let mut u = wanted[output];
            if let Some(step) = &self.step {
                let [low, high] = reach(self.applied[output], step[output]);
                flags |= narrow(&mut u, [low, high], flag::STEP_LIMITED);
            }
            if let Some(spans) = spans {
                flags |= narrow(&mut u, spans[output], flag::POSITION_LIMITED);
            }
            self.applied[output] = u;
        }
        if came.is_some() {
            self.last = self.applied;
        }
        Applied { command: self.applied, flags }
    }

    /// In place of what the gate let through, takes what somebody else knows that it did.
    pub(super) fn take_over(&mut self, applied: Outputs) {
        self.applied = applied;
    }

    /// What is wanted of a command that came: within the rate limit, and the ramp.
    fn limited(&mut self, command: &Outputs) -> (Outputs, u32) {
        let back = self.joined == 0 || self.missing > self.hold;
        self.joined = if back { 1 } else { self.joined.saturating_add(1).min(self.ramp.saturating_add(1)) };
        self.missing = 0;
        let share = self.joined as f32 / self.ramp.saturating_add(1) as f32;
        let (mut wanted, mut flags) = ([0.0; MAX_OUTPUTS], 0);
        for ((to, &u), limit) in wanted[..self.outputs].iter_mut().zip(command).zip(self.limit) {
            *to = u.clamp(-limit, limit);
            if *to != u {
                flags |= flag::CLAMPED;
            }
            if share < 1.0 {
                flags |= narrow(to, [-limit * share, limit * share], flag::RAMPED);
            }
        }
        (wanted, flags)
    }

    /// Hold the last command for `hold` ticks, let it decay to zero over `decay` more, then stop.
    fn without(&mut self) -> (Outputs, u32) {
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

/// Brings `u` into `span`; says `reason` where that changes it.
fn narrow(u: &mut f32, [low, high]: CommandRange, reason: u32) -> u32 {
    let before = *u;
    *u = u.clamp(low, high);
    if *u == before { 0 } else { flag::CLAMPED | reason }
}

/// The numbers that are no further than `by` from `from`, whatever rounding makes of the sums.
fn reach(from: f32, by: f32) -> CommandRange {
    let (mut low, mut high) = (from - by, from + by);
    if f64::from(from) - f64::from(low) > f64::from(by) {
        low = low.next_up();
    }
    if f64::from(high) - f64::from(from) > f64::from(by) {
        high = high.next_down();
    }
    [low, high]
}

/// The commands that do not carry joint `output` over `limits`, rad; 0 is always among them.
///
/// With the position `p` and the travel `k`, the joint comes to `p + k u`. That has to lie between the limits, or, for a
/// joint outside, between where it is and the limit beyond. A hair's breadth of margin, 1e-6 of the largest angle at
/// hand, takes care of what single precision makes of the sum in the plant.
fn command_range(joints: &JointState, output: usize, [low, high]: [f64; 2]) -> CommandRange {
    let (p, k) = (f64::from(joints.position[output]), f64::from(joints.travel[output]));
    if !(p.is_finite() && k.is_finite()) {
        return [0.0; 2];
    }
    if k == 0.0 {
        return [f32::MIN, f32::MAX];
    }
    let hair = 1e-6 * p.abs().max(low.abs()).max(high.abs()).max(1.0);
    let (low, high) = ((low + hair).min(p), (high - hair).max(p));
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
        visitor.number("joined", &mut self.joined);
    }
}

#[cfg(test)]
mod tests;
