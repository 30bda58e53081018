//! The gate, the last thing between a command and the actuators: hold policy and limits, whoever sends commands.
//!
//! Invariant I7: whatever comes (nothing, late, not a number, huge), what is applied is finite and within limits.

use crate::policy::Outputs;
use crate::scenario::GateTable;
use crate::state::{Ledger, Remember};
use crate::wire::{MAX_OUTPUTS, flag};

/// What the gate lets through in one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Applied {
    /// The command for the actuators; outputs beyond the plant's are 0.
    pub command: Outputs,
    /// What the gate did, as bits of [`flag`]: [`flag::MISSED`] with one of `HELD`, `DECAYED`, `STOPPED`, and
    /// [`flag::NON_FINITE`], [`flag::CLAMPED`].
    pub flags: u32,
}

/// The gate of one plant.
#[derive(Debug, Clone)]
pub struct Gate {
    limit: f32,
    hold: u32,
    decay: u32,
    outputs: usize,
    /// The last command that came and was let through.
    last: Outputs,
    /// Ticks without a command since then.
    missing: u32,
}

impl Gate {
    /// The gate of a validated table, for `outputs` outputs. Before the first command it stands at zero.
    pub fn new(table: &GateTable, outputs: usize) -> Self {
        Self {
            limit: table.max_command as f32,
            hold: table.hold_ticks,
            decay: table.decay_ticks,
            outputs,
            last: [0.0; MAX_OUTPUTS],
            missing: 0,
        }
    }

    /// One tick: the command that arrived for it, or `None`. A command with a value that is not a number counts as none.
    pub fn pass(&mut self, command: Option<&Outputs>) -> Applied {
        match command {
            Some(command) if command[..self.outputs].iter().all(|u| u.is_finite()) => self.limited(command),
            Some(_) => {
                let Applied { command, flags } = self.without();
                Applied { command, flags: flags | flag::NON_FINITE }
            }
            None => self.without(),
        }
    }

    fn limited(&mut self, command: &Outputs) -> Applied {
        let mut flags = 0;
        self.missing = 0;
        for (last, &u) in self.last[..self.outputs].iter_mut().zip(command) {
            *last = u.clamp(-self.limit, self.limit);
            if *last != u {
                flags |= flag::CLAMPED;
            }
        }
        Applied { command: self.last, flags }
    }

    /// Hold the last command for `hold` ticks, let it decay to zero over `decay` more, then stop.
    fn without(&mut self) -> Applied {
        self.missing = self.missing.saturating_add(1);
        let (share, flags) = if self.missing <= self.hold {
            (1.0, flag::HELD)
        } else if self.missing - self.hold <= self.decay {
            (1.0 - (self.missing - self.hold) as f32 / (self.decay + 1) as f32, flag::DECAYED)
        } else {
            (0.0, flag::STOPPED)
        };
        Applied { command: self.last.map(|u| u * share), flags: flags | flag::MISSED }
    }
}

impl Remember for Gate {
    fn remember(&mut self, ledger: &mut dyn Ledger) {
        ledger.numbers("last", &mut self.last);
        ledger.number("missing", &mut self.missing);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn gate() -> Gate {
        Gate::new(&GateTable { max_command: 0.5, hold_ticks: 2, decay_ticks: 3 }, 2)
    }

    #[test]
    fn hold_then_decay_then_stop_and_back() {
        let mut gate = gate();
        let command = [0.4, -0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        assert_eq!(gate.pass(Some(&command)), Applied { command, flags: 0 });
        let seen: Vec<(f32, u32)> = (0..7)
            .map(|_| {
                let applied = gate.pass(None);
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
        assert_eq!(gate.pass(Some(&command)).flags, 0);
        assert_eq!(gate.pass(None).command, command, "held anew after a command came");
    }

    #[test]
    fn not_a_number_is_no_command() {
        let mut gate = gate();
        gate.pass(Some(&[0.1; 8]));
        let applied = gate.pass(Some(&[0.2, f32::NAN, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
        assert_eq!(applied.flags, flag::MISSED | flag::HELD | flag::NON_FINITE);
        assert_eq!(applied.command[0], 0.1);
    }

    proptest! {
        /// I7, over any bits.
        #[test]
        fn applied_commands_stay_within_limits(stream in proptest::collection::vec(proptest::option::of(any::<[u32; 8]>()), 1..200)) {
            let mut gate = gate();
            for bits in stream {
                let applied = gate.pass(bits.map(|b| b.map(f32::from_bits)).as_ref());
                prop_assert!(applied.command.iter().all(|u| u.abs() <= 0.5), "{applied:?}");
                prop_assert!(applied.command[2..].iter().all(|&u| u == 0.0));
            }
        }
    }
}
