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

use crate::plant::Joints;
use crate::policy::Outputs;
use crate::scenario::GateTable;
use crate::state::{Ledger, Remember};
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
pub type Span = [f32; 2];

/// The commands that limits of position leave to each output.
pub type Spans = [Span; MAX_OUTPUTS];

impl Gate {
    /// The gate of a validated table, for `outputs` outputs. Before the first command it stands at zero.
    pub fn new(table: &GateTable, outputs: usize) -> Self {
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
    pub fn spans(&self, joints: impl FnOnce() -> Option<Joints>) -> Option<Spans> {
        let positions = self.positions.as_ref()?;
        let spans = |joints: Joints| std::array::from_fn(|output| joints.span(output, positions[output]));
        Some(joints().map_or([[0.0; 2]; MAX_OUTPUTS], spans))
    }

    /// One tick: the command that arrived for it, or `None`, and what the limits of position leave ([`Gate::spans`]). A command
    /// with a value that is not a number counts as none.
    pub fn pass(&mut self, command: Option<&Outputs>, spans: Option<&Spans>) -> Applied {
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
fn narrow(u: &mut f32, [low, high]: Span, reason: u32) -> u32 {
    let before = *u;
    *u = u.clamp(low, high);
    if *u == before { 0 } else { flag::CLAMPED | reason }
}

/// The numbers that are no further than `by` from `from`, whatever rounding makes of the sums.
fn reach(from: f32, by: f32) -> Span {
    let (mut low, mut high) = (from - by, from + by);
    if f64::from(from) - f64::from(low) > f64::from(by) {
        low = low.next_up();
    }
    if f64::from(high) - f64::from(from) > f64::from(by) {
        high = high.next_down();
    }
    [low, high]
}

impl Joints {
    /// The commands that do not carry joint `output` over `limits`, rad; 0 is always among them.
    ///
    /// With the position `p` and the travel `k`, the joint comes to `p + k u`. That has to lie between the limits, or, for a
    /// joint outside, between where it is and the limit beyond. A hair's breadth of margin, 1e-6 of the largest angle at
    /// hand, takes care of what single precision makes of the sum in the plant.
    fn span(&self, output: usize, [low, high]: [f64; 2]) -> Span {
        let (p, k) = (f64::from(self.position[output]), f64::from(self.travel[output]));
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

impl Remember for Gate {
    fn remember(&mut self, ledger: &mut dyn Ledger) {
        ledger.numbers("last", &mut self.last);
        ledger.number("missing", &mut self.missing);
        ledger.numbers("applied", &mut self.applied);
        ledger.number("joined", &mut self.joined);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::{Arm, Plant as _};
    use crate::scenario::{ArmTable, PerOutput};
    use proptest::prelude::*;

    fn table() -> GateTable {
        GateTable { max_command: PerOutput::All(0.5), hold_ticks: 2, decay_ticks: 3, ..GateTable::default() }
    }

    fn gate() -> Gate {
        Gate::new(&table(), 2)
    }

    /// The first output's command.
    fn first(u: f32) -> Outputs {
        let mut command = [0.0; MAX_OUTPUTS];
        command[0] = u;
        command
    }

    /// What becomes of the first output, with the flags beside `CLAMPED` and `MISSED`.
    fn passes(gate: &mut Gate, command: Option<f32>, joints: Option<&Joints>) -> (f32, u32) {
        let spans = gate.spans(|| joints.copied());
        let applied = gate.pass(command.map(first).as_ref(), spans.as_ref());
        let limited = flag::STEP_LIMITED | flag::POSITION_LIMITED | flag::RAMPED;
        assert!(applied.flags & limited == 0 || applied.flags & flag::CLAMPED != 0, "{applied:?}");
        (applied.command[0], applied.flags & !(flag::CLAMPED | flag::MISSED))
    }

    #[test]
    fn hold_then_decay_then_stop_and_back() {
        let mut gate = gate();
        let command = [0.4, -0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        assert_eq!(gate.pass(Some(&command), None), Applied { command, flags: 0 });
        let seen: Vec<(f32, u32)> = (0..7)
            .map(|_| {
                let applied = gate.pass(None, None);
                (applied.command[0] / 0.4, applied.flags & !flag::MISSED)
            })
            .collect();
        let expected = [1.0, 1.0, 0.75, 0.5, 0.25, 0.0, 0.0];
        for ((share, _), expected) in seen.iter().zip(expected) {
            assert!((share - expected).abs() < 1e-6, "{seen:?}");
        }
        let flags: Vec<u32> = seen.iter().map(|s| s.1).collect();
        let (h, d, s) = (flag::HELD, flag::DECAYED, flag::STOPPED);
        assert_eq!(flags, [h, h, d, d, d, s, s]);
        assert_eq!(gate.pass(Some(&command), None).flags, 0);
        assert_eq!(gate.pass(None, None).command, command, "held anew after a command came");
    }

    #[test]
    fn not_a_number_is_no_command() {
        let mut gate = gate();
        gate.pass(Some(&[0.1; 8]), None);
        let applied = gate.pass(Some(&[0.2, f32::NAN, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]), None);
        assert_eq!(applied.flags, flag::MISSED | flag::HELD | flag::NON_FINITE);
        assert_eq!(applied.command[0], 0.1);
    }

    #[test]
    fn every_output_has_its_own_limit() {
        let mut gate = Gate::new(&GateTable { max_command: PerOutput::Each(vec![0.5, 0.1]), ..table() }, 2);
        let applied = gate.pass(Some(&[9.0; 8]), None);
        assert_eq!((applied.command[..3].to_vec(), applied.flags), (vec![0.5, 0.1, 0.0], flag::CLAMPED));
    }

    #[test]
    fn steps_are_limited_on_the_way_to_a_stop_as_well() {
        let mut gate = Gate::new(
            &GateTable { max_step: Some(PerOutput::All(0.125)), hold_ticks: 1, decay_ticks: 0, ..table() },
            2,
        );
        let s = flag::STEP_LIMITED;
        let steps: Vec<_> = [Some(0.3), Some(0.3), Some(0.3)].into_iter().map(|u| passes(&mut gate, u, None)).collect();
        assert_eq!(steps, [(0.125, s), (0.25, s), (0.3, 0)]);
        let down: Vec<_> = (0..5).map(|_| passes(&mut gate, None, None)).collect();
        let (h, stop) = (flag::HELD, flag::STOPPED);
        assert_eq!(down.iter().map(|d| d.1).collect::<Vec<_>>(), [h, stop | s, stop | s, stop, stop]);
        for ((u, _), expected) in down.iter().zip([0.3, 0.175, 0.05, 0.0, 0.0]) {
            assert!((u - expected).abs() < 1e-6, "{down:?}");
        }
        // What was limited is what is held: a command that had not been reached is not gone on to.
        assert_eq!(passes(&mut gate, Some(0.5), None).0, 0.125);
        assert_eq!(passes(&mut gate, None, None), (0.125, h));
    }

    #[test]
    fn commands_that_begin_or_come_back_grow() {
        let mut gate = Gate::new(&GateTable { ramp_ticks: 3, ..table() }, 2);
        let r = flag::RAMPED;
        let ramp = [(0.125, r), (0.25, r), (0.375, r), (0.5, 0), (0.5, 0)];
        let go = |gate: &mut Gate| [0.5; 5].map(|u| passes(gate, Some(u), None));
        assert_eq!(go(&mut gate), ramp);
        // Held is not gone: the ramp is over.
        passes(&mut gate, None, None);
        assert_eq!(passes(&mut gate, Some(0.5), None), (0.5, 0));
        for _ in 0..3 {
            passes(&mut gate, None, None);
        }
        assert_eq!(go(&mut gate), ramp, "after it had begun to decay");
        for _ in 0..99 {
            passes(&mut gate, None, None);
        }
        assert_eq!(passes(&mut gate, Some(-0.1), None), (-0.1, 0), "small enough");
        assert_eq!(passes(&mut gate, Some(-0.5), None), (-0.25, r));
    }

    #[test]
    fn joints_stay_within_their_limits_and_come_back_from_outside() {
        let table = GateTable { positions: vec![[-1.0, 0.5], [-1.0, 1.0]], ..table() };
        let p = flag::POSITION_LIMITED;
        for (position, travel, wanted, low, high, flags) in [
            (0.0, 1.0, 0.4, 0.4, 0.4, 0),
            (0.3, 1.0, 0.4, 0.199_99, 0.2, p),
            (0.3, -1.0, -0.4, -0.2, -0.199_99, p),
            (0.3, -1.0, 0.4, 0.4, 0.4, 0),
            // Outside: no further out; back, but not through.
            (0.6, 1.0, 0.4, 0.0, 0.0, p),
            (0.6, 1.0, -0.4, -0.4, -0.4, 0),
            (0.6, 10.0, -0.4, -0.16, -0.159_99, p),
            (-7.0, 1.0, -0.4, 0.0, 0.0, p),
            // Not known: it does not move. Not moved by this output: no limit.
            (f32::NAN, 1.0, 0.4, 0.0, 0.0, p),
            (0.0, f32::INFINITY, 0.4, 0.0, 0.0, p),
            (0.0, 0.0, 0.4, 0.4, 0.4, 0),
        ] {
            let joints = Joints { position: [position; 8], travel: [travel; 8] };
            let (u, said) = passes(&mut Gate::new(&table, 2), Some(wanted), Some(&joints));
            assert!(low <= u && u <= high && said == flags, "{position} {travel} {wanted}: {u} {said:x}");
        }
        assert_eq!(passes(&mut Gate::new(&table, 2), Some(0.1), None), (0.0, p), "a plant that does not tell");
        // Position goes before step.
        let table = GateTable { max_step: Some(PerOutput::All(0.125)), ..table };
        let mut gate = Gate::new(&table, 2);
        let joints = |position| Joints { position: [position; 8], travel: [1.0; 8] };
        for _ in 0..3 {
            passes(&mut gate, Some(0.3), Some(&joints(-0.5)));
        }
        assert_eq!(passes(&mut gate, Some(0.3), Some(&joints(0.5))), (0.0, p));
    }

    /// A tick of a hostile world: the command, if one comes, as any bits, and the position that is measured, as any bits or,
    /// more often, where the joint is.
    fn hostile() -> impl Strategy<Value = (Option<[u32; 2]>, Option<u32>)> {
        let ordinary = (-1.0_f32..1.0).prop_map(f32::to_bits);
        let bits = prop_oneof![any::<u32>(), ordinary];
        (prop::option::of(prop::array::uniform2(bits)), prop::option::weighted(0.1, any::<u32>()))
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

        /// I7, over any bits: finite, within rate, step and ramp, and no joint goes over its limits.
        #[test]
        fn applied_commands_stay_within_limits(
            ticks in prop::collection::vec(hostile(), 1..150),
            step in prop::option::of(0.01..0.6_f64),
            limits in prop::option::of((-3.0..1.0_f64, 0.01..3.0_f64)),
            travel in prop_oneof![Just(1.0_f32), -40.0_f32..40.0],
            start in -4.0_f32..4.0,
            ramp_ticks in 0..5_u32,
        ) {
            let positions = limits.map_or(Vec::new(), |(low, width)| vec![[low, low + width]; 2]);
            let table = GateTable { max_step: step.map(PerOutput::All), positions, ramp_ticks, ..table() };
            let mut gate = Gate::new(&table, 2);
            let (mut theta, mut before) = ([start, -start], [0.0_f32; 2]);
            for (bits, measured) in ticks {
                let mut command = [f32::NAN; MAX_OUTPUTS];
                if let Some(bits) = bits {
                    command[..2].copy_from_slice(&bits.map(f32::from_bits));
                }
                let mut joints = Joints { position: [0.0; MAX_OUTPUTS], travel: [travel; MAX_OUTPUTS] };
                joints.position[..2].copy_from_slice(&theta);
                if let Some(measured) = measured {
                    joints.position[0] = f32::from_bits(measured);
                }
                let spans = gate.spans(|| Some(joints));
                let applied = gate.pass(bits.map(|_| command).as_ref(), spans.as_ref());
                prop_assert!(applied.command[2..].iter().all(|&u| u == 0.0));
                for i in 0..2 {
                    let u = applied.command[i];
                    prop_assert!(u.abs() <= 0.5, "{applied:?}");
                    if let (Some(step), true) = (step, applied.flags & flag::POSITION_LIMITED == 0) {
                        let by = (f64::from(u) - f64::from(before[i])).abs();
                        prop_assert!(by <= f64::from(step as f32), "{by}: {applied:?}");
                    }
                    before[i] = u;
                    let there = theta[i] + travel * u;
                    // A limit is kept as far as positions are measured rightly.
                    if let (Some(&[low, high]), true) = (table.positions.get(i), measured.is_none() || i == 1) {
                        let (from, to) = (f64::from(theta[i]), f64::from(there));
                        prop_assert!(to >= low.min(from) && to <= high.max(from), "{from} to {to}: {applied:?}");
                    }
                    theta[i] = there;
                }
            }
        }

        /// The same with an arm whose joints come round: no wall is crossed, from neither side, to the last bit.
        #[test]
        fn an_arm_stays_within_its_walls(
            ticks in prop::collection::vec(prop::option::of(prop::array::uniform2(-1.0_f32..1.0)), 1..150),
            low in -3.1..-0.1_f64,
            high in 0.1..3.1_f64,
            open_loop in any::<bool>(),
        ) {
            let arm = ArmTable { lengths: vec![0.5; 2], open_loop, ..ArmTable::default() };
            let mut arm = Arm::new(&arm, 0.05, 1);
            let mut gate = Gate::new(&GateTable { positions: vec![[low, high]; 2], ..table() }, 2);
            for (tick, drawn) in (0..).zip(ticks) {
                let mut command = [0.0; MAX_OUTPUTS];
                drawn.iter().for_each(|drawn| command[..2].copy_from_slice(drawn));
                let spans = gate.spans(|| arm.joints());
                let applied = gate.pass(drawn.map(|_| command).as_ref(), spans.as_ref());
                arm.advance(tick, &applied.command[..2]);
                prop_assert!(arm.angles().iter().all(|&x| low <= f64::from(x) && f64::from(x) <= high), "{:?}", arm.angles());
            }
        }
    }
}
