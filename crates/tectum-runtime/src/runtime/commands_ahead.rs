//! Commands ahead, as the plant keeps them: what the gate may apply in a tick whose command has not arrived.
//!
//! A controller that plans sends, with each command, those that it would give in the ticks after it ([`Ahead`]). The
//! newest ones that were heard count. A command that arrives after its tick is of no use any more, but those that came
//! with it are: they were made for later ticks, from a newer observation.
//!
//! With faults on the command channel, commands ahead are lost, late or frozen together with the command that they came
//! with. So they are kept until that command is heard.

use crate::state::{Persist, StateVisitor};
use crate::wire::{Ahead, MAX_AHEAD, OutputValues};

/// A command for a tick without one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CommandAhead {
    /// The command, without exploration noise.
    pub command: OutputValues,
    /// So many ticks lie between the observation that it was made from and this one; at least 1.
    pub age: u32,
}

/// The commands ahead that came with the last commands.
#[derive(Debug, Clone)]
pub(super) struct CommandsAhead {
    /// Largest age of a command that counts; 0 where the scenario has no commands ahead.
    most: u32,
    /// Those that came with the command of tick k are at k modulo the length.
    kept: [Ahead; MAX_AHEAD],
    /// The newest tick whose command was heard, plus 1; 0 before the first.
    heard: u64,
}

impl CommandsAhead {
    pub fn new(most: u32) -> Self {
        Self { most, kept: [Ahead::default(); MAX_AHEAD], heard: 0 }
    }

    /// Whether the scenario has commands ahead.
    pub fn is_used(&self) -> bool {
        self.most > 0
    }

    /// Keeps what came with a command, until the command is [heard](Self::hear).
    pub fn keep(&mut self, ahead: &Ahead) {
        self.kept[ahead.header.tick as usize % MAX_AHEAD] = *ahead;
    }

    /// The command of tick `from` was heard by `tick`, in time or late.
    pub fn hear(&mut self, from: u64, tick: u64) {
        if from <= tick {
            self.heard = self.heard.max(from + 1);
        }
    }

    /// All that is kept was heard by `tick`: without faults nothing comes between.
    pub fn hear_all(&mut self, tick: u64) {
        for i in 0..MAX_AHEAD {
            self.hear(self.kept[i].header.tick, tick);
        }
    }

    /// The command for `tick` that came with an earlier one.
    pub fn command_for(&self, tick: u64) -> Option<CommandAhead> {
        let from = self.heard.checked_sub(1)?;
        let age = u32::try_from(tick.checked_sub(from)?).ok().filter(|age| (1..=self.most).contains(age))?;
        let ahead = &self.kept[from as usize % MAX_AHEAD];
        let known = ahead.header.tick == from && u64::from(age) <= ahead.ticks;
        let command = ahead.commands.get(age as usize - 1).filter(|_| known)?;
        Some(CommandAhead { command: *command, age })
    }
}

impl Persist for CommandsAhead {
    fn visit_state(&mut self, visitor: &mut dyn StateVisitor) {
        if self.is_used() {
            self.kept.iter_mut().for_each(|ahead| visitor.words("kept", ahead));
            visitor.number("heard", &mut self.heard);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::Header;

    fn ahead(tick: u64, ticks: u64) -> Ahead {
        let mut ahead = Ahead { ticks, ..Ahead::default() };
        ahead.header.tick = tick;
        for (i, command) in ahead.commands.iter_mut().enumerate() {
            command[0] = (10 * tick + 1 + i as u64) as f32;
        }
        ahead
    }

    fn first(all: &CommandsAhead, tick: u64) -> Option<(f32, u32)> {
        all.command_for(tick).map(|found| (found.command[0], found.age))
    }

    #[test]
    fn the_newest_that_was_heard_counts() {
        let mut all = CommandsAhead::new(3);
        assert_eq!(first(&all, 0), None);
        all.keep(&ahead(4, 3));
        assert_eq!(first(&all, 5), None, "its command was not heard");
        all.hear(4, 4);
        assert_eq!([4, 5, 7, 8].map(|tick| first(&all, tick)), [None, Some((41.0, 1)), Some((43.0, 3)), None]);
        // Command 6 comes after its tick. Command 5 comes even later, and is older.
        all.keep(&ahead(6, 2));
        all.hear(6, 7);
        all.keep(&ahead(5, 3));
        all.hear(5, 7);
        assert_eq!([7, 8, 9].map(|tick| first(&all, tick)), [Some((61.0, 1)), Some((62.0, 2)), None]);
        // A command without any takes the older ones' place: the controller knows why it has none.
        all.hear(7, 7);
        assert_eq!(first(&all, 8), None);
    }

    #[test]
    fn numbers_from_outside_do_no_harm() {
        let mut all = CommandsAhead::new(8);
        all.keep(&ahead(1, u64::MAX));
        for forged in [u64::MAX, 1 << 40] {
            all.keep(&Ahead { header: Header { tick: forged, ..Header::default() }, ..ahead(0, u64::MAX) });
        }
        all.hear_all(2);
        assert_eq!(first(&all, 9), Some((18.0, 8)));
        assert_eq!([0, 10, u64::MAX].map(|tick| first(&all, tick)), [None; 3]);
    }
}
